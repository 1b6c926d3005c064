"""What becomes of a thread between the fingers of one arm, from one measured pose to the next.

Nothing is taken from the plan: the fingers have captured the thread once it runs between them and they have begun to
close; they hold it once they touch it from both sides. Fingers that close where they are sweep the thread along, so
what counts is the opening they closed from; fingers that travel must keep the thread within the opening they have, give
or take what a thread gives way. A thread that slipped out is not caught again in the same grasp.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from jaxtyping import Float64

from agents.simulator.field import Field, s_of
from agents.simulator.fingers import (
    FINGERTIP_TOOL,
    Offset,
    between,
    contact_rad,
    offset_from_wedge,
    within_reach,
)
from schemas.messages import Verdict
from shared.rigid_transforms import apply, inverse

CLOSED_RAD = 0.03
"""The fingers' tips are then 0.3 mm apart, which is as thick as a thread."""

OPEN_RAD = 0.1
"""Fingers that were never as far apart have not been opened for a grasp."""

BEGUN_RAD = 0.05
"""So far below their widest opening, the fingers have begun to close."""

IN_PLACE_M = 1e-3
"""Fingertips that have travelled farther have not closed in place."""

GIVE_M = 3e-3
"""How far a thread on tissue gives way to a finger that pushes it, as contact physics has it (docs/simulator.md)."""


class Lying(Protocol):
    """A thread, or a strand of one, by dense samples along it."""

    @property
    def points(self) -> Float64[np.ndarray, "n 3"]:
        """In the camera's frame."""
        ...

    @property
    def radius_m(self) -> float:
        """Of the thread."""
        ...


@dataclass(frozen=True)
class Grip:
    """One arm's fingers and the thread, so far in one grasp.

    Fields:
        swept_rad: the opening that the fingers closed from where they are, with their tips at `swept_tip`.
        widest_rad: their widest opening in this grasp.
        sample: where the thread runs between the fingers, as a sample of the field; None where it does not.
        captured: where it did when they began to close around it.
        verdict: what became of it, once that is settled.
        offset: how far off the thread was when the fingers closed on nothing.
    """

    swept_rad: float
    swept_tip: Float64[np.ndarray, "3"]
    widest_rad: float
    sample: int | None = None
    captured: int | None = None
    verdict: Verdict | None = None
    offset: Offset | None = None


def first_grip(T_camera_tool: Float64[np.ndarray, "4 4"], jaw_rad: float) -> Grip:
    """The fingers at the start of a grasp, with nothing between them."""
    return Grip(jaw_rad, fingertip(T_camera_tool), jaw_rad)


def followed(grip: Grip, T_camera_tool: Float64[np.ndarray, "4 4"], jaw_rad: float, field: Lying) -> Grip:
    """The grip at the next measured pose; it stays as it is once there is a verdict."""
    if grip.verdict is not None:
        return grip
    grip = _swept(grip, fingertip(T_camera_tool), jaw_rad)
    if grip.captured is None and jaw_rad > CLOSED_RAD and not within_reach(field.points, T_camera_tool[:3, 3]):
        return grip if grip.sample is None else replace(grip, sample=None)
    points_tool = apply(inverse(T_camera_tool), field.points)
    give = 0.0 if grip.captured is None else GIVE_M
    sample = between(points_tool, grip.swept_rad, give, grip.sample)
    if sample is None:
        return _without_thread(grip, points_tool, jaw_rad)
    begun = jaw_rad < grip.widest_rad - BEGUN_RAD
    captured = sample if begun and grip.captured is None else grip.captured
    held = begun and _was_open(grip) and jaw_rad <= touching_rad(float(np.hypot(*points_tool[sample, 1:])), field)
    return replace(grip, sample=sample, captured=captured, verdict=Verdict.HELD if held else None)


def touching_rad(from_pin_m: float, field: Lying) -> float:
    """The opening at which the fingers hold a thread that far from their pin."""
    return max(contact_rad(from_pin_m, field.radius_m), CLOSED_RAD)


def never_closed(grip: Grip) -> Grip:
    """The grip of a grasp that is over without a verdict."""
    return replace(grip, verdict=Verdict.MISSED)


def slid_m(grip: Grip, field: Field) -> float:
    """How far along the thread the fingers have come since they captured it."""
    if grip.sample is None or grip.captured is None:
        return 0.0
    return abs(s_of(grip.sample) - s_of(grip.captured)) * field.length_m


def code(grip: Grip) -> str:
    """The reason in one word."""
    if grip.verdict is Verdict.HELD:
        return "HELD"
    if grip.verdict is Verdict.LOST:
        return "SLIPPED_ON_SLIDE"
    if grip.offset is None:
        return "NEVER_CLOSED" if _was_open(grip) else "NEVER_OPENED"
    return where_code(grip.offset.where)


def where_code(where: str) -> str:
    """In one word, where a thread lay that was missed."""
    return where.removesuffix(" of the fingers").removesuffix(" the fingers").upper().replace(" ", "_")


def sentence(grip: Grip, field: Field) -> str:
    """What became of the grasp, in plain words."""
    at = "" if grip.sample is None else f"at {100 * s_of(grip.sample):.0f} %"
    slid = 1e3 * slid_m(grip, field)
    if grip.verdict is Verdict.HELD:
        return f"grasp held: caught {at}{f', slid {slid:.0f} mm' if slid >= 0.5 else ''}"
    if grip.verdict is Verdict.LOST:
        return f"grasp lost: the thread slipped out {at} after sliding {slid:.0f} mm"
    if grip.offset is None:
        return f"grasp missed: the fingers never {'closed' if _was_open(grip) else 'opened'}"
    if grip.offset.distance_m == 0:
        return f"grasp missed: the thread lay {grip.offset.where}"
    return f"grasp missed: the thread lay {1e3 * grip.offset.distance_m:.1f} mm {grip.offset.where}"


def fingertip(T_camera_tool: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "3"]:
    """Where the tips of the closed fingers are."""
    return apply(T_camera_tool, FINGERTIP_TOOL[None])[0]


def _swept(grip: Grip, tip: Float64[np.ndarray, "3"], jaw_rad: float) -> Grip:
    travelled = float(np.linalg.norm(tip - grip.swept_tip)) > IN_PLACE_M
    if travelled or jaw_rad >= grip.swept_rad:
        grip = replace(grip, swept_rad=jaw_rad, swept_tip=tip)
    return replace(grip, widest_rad=max(grip.widest_rad, jaw_rad))


def _without_thread(grip: Grip, points_tool: Float64[np.ndarray, "n 3"], jaw_rad: float) -> Grip:
    """The grip when no thread runs between the fingers: lost if one did, missed if they are closed."""
    if grip.captured is not None:
        return replace(grip, verdict=Verdict.LOST)
    if _was_open(grip) and jaw_rad <= CLOSED_RAD:
        offset = offset_from_wedge(points_tool, grip.swept_rad)
        return replace(grip, sample=None, verdict=Verdict.MISSED, offset=offset)
    return replace(grip, sample=None)


def _was_open(grip: Grip) -> bool:
    return grip.widest_rad >= OPEN_RAD


@dataclass(frozen=True)
class Outcome:
    """What became of a grasp so far; where it is not settled, what is to be said if it ends like that.

    Fields:
        s_caught, slid_m, peak_tissue_force_n, slipped_m, code: as of GraspJudgement.
        sentence: without the error of the goal.
    """

    settled: bool
    verdict: Verdict
    code: str
    sentence: str
    s_caught: float | None = None
    slid_m: float = 0.0
    peak_tissue_force_n: float | None = None
    slipped_m: float | None = None


@dataclass(frozen=True)
class MeasuredArm:
    """Where an arm's tool truly is, and since when."""

    name: str
    plan_id: str
    T_camera_tool: Float64[np.ndarray, "4 4"]
    jaw_rad: float
    measured_ns: int


class Physics(Protocol):
    """A thread on tissue among the fingers of arms."""

    @property
    def field(self) -> Field:
        """The field as it is."""
        ...

    @property
    def held_sample(self) -> int | None:
        """Which sample of the thread a jaw holds, None where none does."""
        ...

    def lay(self) -> None:
        """Lay the thread as it was at first, out of any jaw."""
        ...

    def follow(self, arm: MeasuredArm) -> Outcome:
        """What becomes of the field and of the arm's grasp when it has been measured there."""
        ...

    def carry(self) -> None:
        """Bring the thread up to date."""
        ...
