"""Whether a grasp holds the thread: after the jaws have closed and lifted, the thread has moved with them or has not.

With m how far the thread at the goal moved the way of the tool, which moved L (`moved.py`), a thread that is held moved
by L and one that was missed by 0, each give or take what reconstruction and the fingers add,

    p(m | held) = (1 − ε) N(m; L, σ² + a²) + ε / R,   p(m | missed) = (1 − ε) N(m; 0, σ² + a²) + ε / R,

where ε is how often a reconstruction is wrong beyond what it tells, by anything up to R. Both alike before, the
probability of being held is p(m | held) / (p(m | held) + p(m | missed)). It is held above `sure`, missed below
1 − `sure`, and unknown in between: what m is far from both says nothing, and nothing is guessed.

On a robot that measures its jaws' angle well enough the angle at which they stop tells as well: around thread of
0.4 mm, 8 mm from the pin, they stop 3° open. Backlash of driven cables is as much, so it is not used.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, curve_of
from agents.planner.errors import thread_covariance
from agents.planner.moved import Motion, motion
from schemas.messages import Checked, GraspPlan, Phase, Status, ThreadAround, ThreadReconstruction
from shared.kinematics.psm import FINGER_M

SAMPLES_BEFORE, SAMPLES_AFTER = 81, 401
LEAST_LIFT_M = 0.002
WRONG, RANGE_M = 0.02, 0.04
"""ε and R."""
MM_PER_M = 1e3


@dataclass(frozen=True)
class Seen:
    """What a check saw.

    Fields:
        motion: None where nothing was compared.
        held_probability: None likewise.
    """

    verdict: Checked
    sentence: str
    motion: Motion | None = None
    held_probability: float | None = None


def around(thread: ThreadReconstruction, samples: int) -> ThreadAround | None:
    """A thread as checks compare it; None where it cannot be measured, or tells no covariance."""
    try:
        curve = curve_of(thread)
    except NoGraspError:
        return None
    s = np.linspace(0.0, 1.0, samples)
    covariance = thread_covariance(thread, curve, s)
    return None if covariance is None else ThreadAround(s, curve.points(s), covariance)


def checked(
    plan: GraspPlan,
    after: ThreadReconstruction,
    T_camera_tool: Float64[np.ndarray, "4 4"],
    config: PlannerConfig,
) -> Seen:
    """Whether the thread moved with the tool, which has closed and lifted and is now there."""
    if plan.around is None or plan.s_goal is None or not plan.waypoints:
        return _unknown("the plan does not tell where the thread lay and how sure that was")
    if after.status is not Status.OK:
        return _unknown(f"the thread is not seen after the lift: {after.reason}")
    now = around(after, SAMPLES_AFTER)
    if now is None:
        return _unknown("the reconstruction does not tell how sure it is of the thread after the lift")
    grasped = [waypoint.T_camera_tool for waypoint in plan.waypoints if waypoint.phase is Phase.GRASP][-1]
    held_at = np.array([0.0, 0.0, FINGER_M - (plan.depth_m or 0.0), 1.0])
    tool_moved = ((T_camera_tool - grasped) @ held_at)[:3]
    if float(np.linalg.norm(tool_moved)) < LEAST_LIFT_M:
        return _unknown(f"the tool moved by only {MM_PER_M * float(np.linalg.norm(tool_moved)):.1f} mm")
    goal = int(np.argmin(np.abs(plan.around.s - plan.s_goal)))
    found = motion(plan.around, goal, now, tool_moved)
    if found is None:
        return _unknown("no thread is seen near the jaws after the lift")
    if found.tool_m < LEAST_LIFT_M:
        return _unknown("the tool moved along the thread, which tells nothing")
    likely = held_probability(found, config)
    told = (
        f"the thread at the goal moved {MM_PER_M * found.thread_m:.1f} mm (± {MM_PER_M * found.deviation_m:.1f}) the "
        f"way of the tool, which moved {MM_PER_M * found.tool_m:.1f} mm"
    )
    if likely >= config.sure:
        return Seen(Checked.HELD, f"held: {told}", found, likely)
    if likely <= 1.0 - config.sure:
        return Seen(Checked.MISSED, f"missed: {told}", found, likely)
    return Seen(Checked.UNKNOWN, f"cannot be told: {told}", found, likely)


def held_probability(found: Motion, config: PlannerConfig) -> float:
    """That thread which moved so far is held, were both alike before."""
    variance = found.deviation_m**2 + config.settle_m**2

    def density(moved_m: float) -> float:
        normal = math.exp(-0.5 * (found.thread_m - moved_m) ** 2 / variance) / math.sqrt(2.0 * math.pi * variance)
        return (1.0 - WRONG) * normal + WRONG / RANGE_M

    held, missed = density(found.tool_m), density(0.0)
    return held / (held + missed)


def _unknown(why: str) -> Seen:
    return Seen(Checked.UNKNOWN, f"cannot be told: {why}")
