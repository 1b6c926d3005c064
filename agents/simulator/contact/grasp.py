"""One grasp by contact: what is noted while it lasts, and what is found once the fingers have lifted.

Nothing here decides the outcome: it is read from what the fingers touch, in the order in which things come. Whether the
thread was ever between the fingers tells a thread that was lost from one that was missed, as for geometry.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from agents.simulator.contact.world import Pose, Touch
from agents.simulator.field import MM, Field, s_of
from agents.simulator.fingers import FINGERTIP_TOOL, Offset, between, offset_from_wedge
from agents.simulator.judgement import BEGUN_RAD, CLOSED_RAD, OPEN_RAD, Outcome, where_code
from schemas.messages import Verdict
from shared.rigid_transforms import apply, inverse

LIFT_MM, LIFT_GIVE_MM = 5.0, 0.1
"""How far closed fingers rise before it is seen what they hold, and how much less will do, for rounding."""


@dataclass(frozen=True)
class Attempt:
    """A grasp so far.

    Fields:
        widest_rad: the widest opening of the fingers.
        sample: where the thread last ran between them, None where it does not.
        captured: where it did when they had begun to close; `lost_at`: where it was last when it left them.
        offset: how far off it was when they began to close and it did not run between them.
        closed_tip: where the tips were when the fingers were shut first, in millimetres.
        gripped: where both fingers touched it then, and `grip`: where they touch it now.
        force_n: the most force on the tissue.
    """

    widest_rad: float
    sample: int | None = None
    captured: int | None = None
    lost_at: int | None = None
    offset: Offset | None = None
    closed_tip: Float64[np.ndarray, "3"] | None = None
    gripped: float | None = None
    grip: float | None = None
    force_n: float = 0.0
    lifted: bool = False


def noted(attempt: Attempt, pose: Pose, touch: Touch, force_n: float, field: Field) -> Attempt:
    """The grasp at the next measured pose; the pose is in millimetres."""
    if attempt.lifted:
        return attempt
    attempt = replace(attempt, widest_rad=max(attempt.widest_rad, pose.jaw_rad), force_n=max(attempt.force_n, force_n))
    tip = apply(pose.T_camera_tool, FINGERTIP_TOOL[None] / MM)[0]
    attempt = replace(attempt, grip=touch.between)
    if attempt.closed_tip is None:
        attempt = _between(attempt, pose, field)
        if _was_open(attempt) and pose.jaw_rad <= CLOSED_RAD:
            attempt = replace(attempt, closed_tip=tip)
    if attempt.closed_tip is None:
        return attempt
    risen = float(np.linalg.norm(tip - attempt.closed_tip))
    gripped = attempt.gripped
    if gripped is None and risen < 1.0:
        gripped = attempt.grip
    return replace(attempt, gripped=gripped, lifted=risen >= LIFT_MM - LIFT_GIVE_MM)


def outcome(attempt: Attempt, field: Field, limit_n: float) -> Outcome:
    """What has become of a grasp, if it ends now."""
    verdict, code, said = _found(attempt, field)
    force = f"{attempt.force_n:.2f} N on the tissue"
    if attempt.force_n > limit_n:
        had = {Verdict.HELD: "the thread was held", Verdict.LOST: "the thread was lost"}.get(verdict, "it missed")
        said = f"grasp failed: {force}, where {limit_n:g} N are allowed; {had}"
        verdict, code = Verdict.FORCE_EXCEEDED, "FORCE_EXCEEDED"
    elif attempt.force_n >= 0.005:
        said += f", {force}"
    held = verdict is Verdict.HELD and attempt.grip is not None
    return Outcome(
        settled=attempt.lifted,
        verdict=verdict,
        code=code,
        sentence=said,
        s_caught=s_of(round(attempt.grip)) if held and attempt.grip is not None else None,
        slid_m=_slid_m(attempt, field),
        peak_tissue_force_n=attempt.force_n,
        slipped_m=_slipped_m(attempt, field),
    )


def _between(attempt: Attempt, pose: Pose, field: Field) -> Attempt:
    T_camera_tool = pose.T_camera_tool.copy()
    T_camera_tool[:3, 3] *= MM
    points_tool = apply(inverse(T_camera_tool), field.points)
    sample = between(points_tool, pose.jaw_rad, field.radius_m, attempt.sample)
    begun = pose.jaw_rad < attempt.widest_rad - BEGUN_RAD
    if sample is None and begun and attempt.captured is None and attempt.offset is None:
        attempt = replace(attempt, offset=offset_from_wedge(points_tool, pose.jaw_rad))
    if begun and sample is not None and attempt.captured is None:
        attempt = replace(attempt, captured=sample)
    if sample is None and attempt.captured is not None and attempt.sample is not None:
        attempt = replace(attempt, lost_at=attempt.sample)
    return replace(attempt, sample=sample)


def _found(attempt: Attempt, field: Field) -> tuple[Verdict, str, str]:
    slid = 1e3 * _slid_m(attempt, field)
    slipped = _slipped_m(attempt, field)
    if attempt.closed_tip is not None and attempt.grip is not None:
        how = f", slid {slid:.0f} mm" if slid >= 0.5 else ""
        how += f", slipped {1e3 * slipped:.1f} mm" if slipped is not None and slipped >= 5e-4 else ""
        return Verdict.HELD, "HELD", f"grasp held: caught at {100 * s_of(round(attempt.grip)):.0f} %{how}"
    if attempt.captured is not None:
        if attempt.gripped is not None:
            return Verdict.LOST, "SLIPPED_ON_LIFT", "grasp lost: the thread slipped out as the fingers lifted it"
        if attempt.closed_tip is None:
            return Verdict.MISSED, "NEVER_CLOSED", "grasp missed: the fingers never closed"
        last = attempt.lost_at if attempt.lost_at is not None else attempt.captured
        at = f"at {100 * s_of(last):.0f} %"
        kind = "SLIPPED_ON_SLIDE" if slid >= 1.0 else "SLIPPED_ON_CLOSING"
        return Verdict.LOST, kind, f"grasp lost: the thread slipped out {at} after sliding {slid:.0f} mm"
    if not _was_open(attempt):
        return Verdict.MISSED, "NEVER_OPENED", "grasp missed: the fingers never opened"
    if attempt.closed_tip is None or attempt.offset is None:
        return Verdict.MISSED, "NEVER_CLOSED", "grasp missed: the fingers never closed"
    offset = attempt.offset
    distance = f"{1e3 * offset.distance_m:.1f} mm " if offset.distance_m else ""
    return Verdict.MISSED, where_code(offset.where), f"grasp missed: the thread lay {distance}{offset.where}"


def _slid_m(attempt: Attempt, field: Field) -> float:
    """Along the thread from where it was captured to where it is or last was."""
    last = next((at for at in (attempt.gripped, attempt.sample, attempt.lost_at) if at is not None), None)
    if attempt.captured is None or last is None:
        return 0.0
    return abs(s_of(1) * (last - attempt.captured)) * field.length_m


def _slipped_m(attempt: Attempt, field: Field) -> float | None:
    if attempt.gripped is None or attempt.grip is None:
        return None
    return abs(s_of(1) * (attempt.grip - attempt.gripped)) * field.length_m


def _was_open(attempt: Attempt) -> bool:
    return attempt.widest_rad >= OPEN_RAD
