"""What can be set about planning; every figure that the paper gives is its default."""

import math
from dataclasses import dataclass
from typing import Literal

from schemas.checks import require
from schemas.topics import ROBOT_STATE
from shared.kinematics.psm import FINGER_M
from shared.runtime.parameters import Between, OneOf, settable


@dataclass(frozen=True)
class PlannerConfig:
    """How grasps are planned.

    Fields:
        samples: candidates for the capture, evenly spaced along the thread.
        keep_probability: that the thread stays between the fingers from one sample to the next.
        least_probability: below which a plan is rejected, and below which nothing is slid along or grasped on the way.
        goal_within_px, goal_within_m: how far off the thread a goal may lie.
        depth_m: how far the fingertips reach beyond the thread.
        standoff_m, retreat_m: where the approach starts, and how far the tool lifts at the end.
        open_deg, slide_deg, closed_deg: jaw angles before, during and after the slide.
        clear_deg: least angle between the viewing ray and the thread for the ray to be approached along.
        base_clear_deg: the same for the ray from the instrument's base, which stands in for it.
        turn_deg: how far the tool may turn from one sample to the next.
        least_dexterity: how far from a singular pose the arm must stand where it grasps, before, and after. The bridge
            refuses plans that come nearer than its own limit, 0.3 unless set, anywhere on their way; so this is more.
        alternatives: how many other captures a plan tells of.
        press_m: how deep the jaws may press into the tissue. It must be more than `depth_m`, by what the tissue slopes
            over the width of the jaws: a thread on tissue is not reached otherwise.
        tool_near_m: how far from the axis of an arm's tool, as measured, what perception takes for tissue is that tool.
        sigmas: with how many deviations of the surface that depth counts.
        tissue_required: whether nothing is grasped where tissue is not known, rather than said not to be checked.
        finger_width_m, finger_thickness_m: of each finger, along the pin and away from the other one.
        tilts_deg: by how much the approach may be turned about the thread, either way, where tissue is in its way.
        policy_model: what success is judged by, `geometric` or `paper` (chances.py).
        tool_error_m: deviation of each axis of the error of the tool's tip, new with each attempt.
        hand_eye_error_m: the most that registration is wrong by about the working point, the same for all attempts.
        give_m: how far a thread that is loose gives way to a finger before it slips out over the tip.
        correlation_m: how far along the thread errors of its reconstruction go together.
        depths_m, opens_deg, slides_deg: what is chosen from in place of depth_m, open_deg and slide_deg by the
            geometric model.
        thread_clear_m: how near the instrument may come to thread outside of the grasp.
        thread_radius_m: of the thread; grasp_arc_m: how far along it from the jaws it counts as being grasped.
        attempts: how often a goal is planned for, the first plan included, where a check tells of a miss.
        aside_m: how far the jaws go sideways after the lift, which tells whether they hold the thread; 0 for never.
        aside_clear_m: how far their tips are before the thread by then.
        settle_m: how far thread shifts in the jaws as they close, or beside them, without being held or missed for it.
        sure: how likely a grasp must be held, or missed, for a check to say so.
        check_after_ms, check_within_ms: after the end of a grasp, how old frames must be at least to be taken of what
            lies still again, clocks of other hosts included, and until when a check is waited for.
        pull_segment_m: how much thread may run through tissue in one segment of a pull, planned from one image.
        pull_reach_m: how far from the entry jaws pull before they grasp anew.
        least_tail_m: the free end comes no nearer to the tissue, along the thread, than jaws need to take it again.
        arm_age_ms: how old the state of an arm may be: as long as five states of one that rests take. A plan needs it
            for the place of the base alone, which seldom moves, so this is more than the age that the bridge allows.
    """

    samples: int = 100
    keep_probability: float = 0.99
    least_probability: float = settable(0.5, Between(0.0, 1.0))
    goal_within_px: float = 20.0
    goal_within_m: float = 0.005
    depth_m: float = 0.002
    standoff_m: float = 0.015
    retreat_m: float = 0.005
    open_deg: float = 60.0
    slide_deg: float = 20.0
    closed_deg: float = 0.0
    clear_deg: float = 30.0
    base_clear_deg: float = 10.0
    turn_deg: float = 45.0
    least_dexterity: float = 0.32
    alternatives: int = 5
    press_m: float = settable(0.004, Between(0.0, 0.01))
    sigmas: float = 2.0
    tissue_required: bool = settable(False, OneOf((False, True)))
    tool_near_m: float = 0.01
    finger_width_m: float = 0.002
    finger_thickness_m: float = 0.001
    tilts_deg: tuple[float, ...] = (15.0, 30.0, 45.0)
    policy_model: Literal["geometric", "paper"] = "geometric"
    tool_error_m: float = 0.0007
    hand_eye_error_m: float = 0.0015
    give_m: float = 0.001
    correlation_m: float = 0.006
    depths_m: tuple[float, ...] = (0.002, 0.003, 0.004, 0.0051)
    opens_deg: tuple[float, ...] = (60.0, 45.0, 75.0)
    slides_deg: tuple[float, ...] = (20.0, 30.0, 40.0)
    thread_clear_m: float = 0.0005
    thread_radius_m: float = 0.0002
    grasp_arc_m: float = 0.005
    attempts: int = 3
    aside_m: float = 0.005
    aside_clear_m: float = 0.002
    settle_m: float = 0.0007
    sure: float = 0.99
    check_after_ms: float = 150.0
    check_within_ms: float = 2000.0
    pull_segment_m: float = 0.005
    pull_reach_m: float = 0.05
    least_tail_m: float = 0.005
    arm_age_ms: float = 5e3 / (ROBOT_STATE.resting_hz or 10.0)

    def __post_init__(self) -> None:
        require(self.samples >= 2, f"samples must be at least 2, not {self.samples}")
        require(0 < self.keep_probability <= 1, f"keep_probability must lie in (0, 1], not {self.keep_probability}")
        require(0 <= self.least_probability <= 1, f"least_probability must lie in [0, 1], not {self.least_probability}")
        require(0 <= self.depth_m < FINGER_M, f"depth_m must lie in [0, {FINGER_M}), the finger, not {self.depth_m}")
        require(self.standoff_m > 0 and self.retreat_m >= 0, "standoff_m must be positive and retreat_m not negative")
        require(self.closed_deg <= self.slide_deg <= self.open_deg, "closed_deg <= slide_deg <= open_deg must hold")
        require(self.press_m >= 0 and self.sigmas >= 0, "press_m and sigmas must not be negative")
        require(min(self.finger_width_m, self.finger_thickness_m) > 0, "a finger must have a width and a thickness")
        require(all(0 < tilt < 90 for tilt in self.tilts_deg), f"tilts_deg must lie in (0, 90): {self.tilts_deg}")
        require(min(self.tool_error_m, self.hand_eye_error_m, self.give_m) >= 0, "errors must not be negative")
        require(self.correlation_m > 0, "correlation_m must be positive")
        require(bool(self.depths_m and self.opens_deg and self.slides_deg), "there must be something to choose from")
        require(0.5 < self.sure < 1, f"sure must lie in (0.5, 1), not {self.sure}")
        require(0 <= self.check_after_ms <= self.check_within_ms, "a check ends after it begins")
        require(min(self.aside_m, self.aside_clear_m) >= 0, "aside_m and aside_clear_m must not be negative")
        require(0 <= self.least_dexterity < 1, f"least_dexterity must lie in [0, 1), not {self.least_dexterity}")
        require(0 < self.pull_segment_m <= self.pull_reach_m, "0 < pull_segment_m <= pull_reach_m must hold")
        require(self.attempts >= 1, f"attempts must be at least 1, not {self.attempts}")
        require(0 < self.base_clear_deg <= self.clear_deg < 90, "0 < base_clear_deg <= clear_deg < 90 must hold")

    @property
    def setback_m(self) -> float:
        """How far before the thread the jaw pin, the origin of the tool frame, comes to lie."""
        return FINGER_M - self.depth_m

    def half_opening_m(self, jaw_deg: float) -> float:
        """How far each finger is from the thread when the jaws stand around it at that angle."""
        return self.setback_m * math.tan(math.radians(0.5 * jaw_deg))
