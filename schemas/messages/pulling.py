"""What a plan and its arming tell of thread that is pulled through tissue until its tail is short enough. SI units.

The tail runs along the thread from its free end to its exit, where it comes out of the tissue. On the other side of the
tissue lies the entry, and from there on the standing strand, which a tool pulls.
"""

import enum
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from schemas.checks import UInt32, check_message, require

SIGMAS_95 = 1.96
"""Deviations of a normal distribution to either side of its mean, between which 95 % of it lies."""


@dataclass(frozen=True)
class PullBounds:
    """What a pull is armed for.

    Fields:
        length_m: the most that closed jaws may travel in all, and so the most thread that may come through the tissue.
        time_s: since its first motion.
        radius_m: closed jaws stay so near to the entry, as the plan that is armed has it.
    """

    length_m: float
    time_s: float
    radius_m: float

    def __post_init__(self) -> None:
        check_message(self)
        require(min(self.length_m, self.time_s, self.radius_m) > 0, "the bounds of a pull must be positive")


class EndSight(enum.Enum):
    """How an end of a strand is seen: by both eyes, hidden by something, or out of the view of one eye or both."""

    SEEN = 1
    HIDDEN = 2
    OUT_OF_VIEW = 3


@dataclass(frozen=True)
class StrandEnd:
    """Where a strand ends: at its free end, or where tissue takes it in; s on the reconstructed thread, None off it."""

    point_camera: Float64[np.ndarray, "3"]
    covariance: Float64[np.ndarray, "3 3"]
    sight: EndSight
    s: float | None = None

    def __post_init__(self) -> None:
        check_message(self)


@dataclass(frozen=True)
class TailLength:
    """The length of a strand with its standard deviation; at least that where the free end is not seen."""

    length_m: float
    deviation_m: float
    at_least: bool

    def __post_init__(self) -> None:
        check_message(self)
        require(min(self.length_m, self.deviation_m) >= 0, "a length and its deviation must not be negative")

    @property
    def interval_m(self) -> tuple[float, float | None]:
        """Between which lengths it is with a probability of 95 %; no upper one where it is at least so long."""
        off_m = SIGMAS_95 * self.deviation_m
        return max(self.length_m - off_m, 0.0), None if self.at_least else self.length_m + off_m


class PullStop(enum.Enum):
    """Why a pull, or one segment of it, ends.

    REACHED: the tail is as long as asked for. TOO_SHORT: it may be shorter than that by more than 2 mm. NOT_RUNNING:
    the tool moved and the tail did not follow, though the standing strand is slack. TENSION: it did not follow, and the
    standing strand is straight. FREE_END_NEAR: the free end comes near the tissue. END_UNSEEN: the free end is not
    seen, so nobody can tell whether thread runs. NO_WAY: no clear way to pull on was found. LET_GO: somebody asked for
    that.
    """

    REACHED = 1
    NOT_RUNNING = 2
    TENSION = 3
    FREE_END_NEAR = 4
    END_UNSEEN = 5
    NO_WAY = 6
    LET_GO = 7
    TOO_SHORT = 8


@dataclass(frozen=True)
class PullGrip:
    """The thread between the jaws as it was grasped, or as its tail was first seen to its end after that.

    Fields:
        jaw_camera, entry_camera: where it lay between the fingers, and where tissue took it in.
        strand_m, deviation_m: how much thread lay between the entry and the jaws.
        tail: as it was then.
        way_end_camera: as far as this place may lie on the clear way.
    """

    jaw_camera: Float64[np.ndarray, "3"]
    entry_camera: Float64[np.ndarray, "3"]
    strand_m: float
    deviation_m: float
    tail: TailLength
    way_end_camera: Float64[np.ndarray, "3"]

    def __post_init__(self) -> None:
        check_message(self)
        require(min(self.strand_m, self.deviation_m) >= 0, "a length and its deviation must not be negative")


@dataclass(frozen=True)
class Pull:
    """What a plan is a segment of, and all that the next segment goes on from.

    Fields:
        tail_m: asked for; None where the jaws only let go.
        segment: the how many-th, from 1 on.
        tail, free_end, exit, entry: as seen in the frame that the plan was made from; None where nothing is.
        grip: None where the jaws hold nothing once the plan is carried out.
        bounds: what an arming should state; told with the first segment.
        last: the pull is over with this plan.
        stop: why it ends with this plan, or why the jaws let go to grasp anew; None where they pull on.
        sentence: the same in plain words.
        shortest_m: as long as the tail is at least while the jaws hold nothing: until they take hold as measured,
            and after they let go less by how far they went; None where nobody has measured it to its end.
        longest_m: as long as it is at most, by all measurements to its end before; None likewise.
    """

    tail_m: float | None
    segment: UInt32
    tail: TailLength | None
    free_end: StrandEnd | None
    exit: StrandEnd | None
    entry: StrandEnd | None
    grip: PullGrip | None
    bounds: PullBounds | None
    last: bool
    stop: PullStop | None
    sentence: str
    shortest_m: float | None = None
    longest_m: float | None = None

    def __post_init__(self) -> None:
        check_message(self)
        require(self.segment >= 1, "segments are counted from 1")
