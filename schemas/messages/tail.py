"""The tail of a thread: how long it is to be, and how long it is in each frame while it is pulled. SI units."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from schemas.checks import UInt32, check_message, require
from schemas.messages.grasping import Phase, check_arm
from schemas.messages.imaging import FrameStamp
from schemas.messages.pulling import PullStop, StrandEnd, TailLength
from schemas.messages.running import CommandHeader, Consumed
from schemas.messages.thread import Status


@dataclass(frozen=True)
class PullGoal:
    """Pull the standing strand until the tail is so long, or let go of what the jaws hold.

    Fields:
        tail_m: how long the tail is to be; None to open the jaws where they are, and go back.
        exit_pixel: a rectified left-image pixel (u, v) at the tail's exit, where several places may be that.
    """

    header: CommandHeader
    arm: str
    tail_m: float | None
    exit_pixel: Float64[np.ndarray, "2"] | None = None

    def __post_init__(self) -> None:
        check_message(self)
        check_arm(self.arm)
        require(self.tail_m is None or self.tail_m > 0, "the tail that is asked for must have a length")


@dataclass(frozen=True)
class Tail:
    """The tail in one frame while a pull is carried out; a failed one says why it could not be measured.

    Fields:
        plan_id, segment: which plan was carried out.
        tail_m: asked for.
        tail, free_end, exit, entry: as seen; None in a failed one.
        ran_m, travelled_m: how much shorter the tail is than before the grasp, and by how much it should be by how far
            the jaws are from the entry; None where that is not known.
        phase: that was reached last; None before the first.
        stop: why the jaws should not go on from here; None where they may.
        sentence: all of it in plain words.
    """

    plan_id: str
    arm: str
    stamp: FrameStamp
    status: Status
    reason: str
    segment: UInt32
    tail_m: float
    tail: TailLength | None
    free_end: StrandEnd | None
    exit: StrandEnd | None
    entry: StrandEnd | None
    ran_m: float | None
    travelled_m: float | None
    phase: Phase | None
    stop: PullStop | None
    sentence: str
    consumed: tuple[Consumed, ...] = ()

    def __post_init__(self) -> None:
        check_message(self)
        check_arm(self.arm)
        require((self.status is Status.OK) == (self.reason == ""), "a failure needs a reason, and a success has none")
        require((self.status is Status.OK) == (self.tail is not None), "a tail that is measured has a length")
