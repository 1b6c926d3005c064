"""Whether a grasp holds the thread: after the jaws have closed and lifted, the thread has moved with them or has not.

With m how far the thread at the goal moved across itself, along the viewing ray and beside it (`moved.py`), and d how
far the tool did, a thread that is held moved by d and one that was missed by 0, each give or take what reconstruction
and the fingers add,

    p(m | held) = p(m − d; C + a² I + S),   p(m | missed) = p(m; C + a² I),

where S is what the fingers are off by, the way they open, since closing they take what they hold to their middle. A
reconstruction that is wrong beyond what it tells is so in depth: both images show where the thread is beside the ray.
So with x = (x_r, x_q)

    p(x; V) = (1 − ε − η) N(x; V) + ε N(x_q; V_qq) / R + η / A.

The thread as a whole may have moved by t besides (`moved`): tissue breathes, and a reconstruction may be wrong as a
whole, whether the thread is held or not; or the tool drags limp thread along by a part of its own way D, in the camera
frame. Then it is m + t that is d,

    p(m, t | held) = ½ p(m | held) p₀(t) + ½ p(m + (r, q)ᵀ t | held) p₁(t),      p(m, t | missed) = p(m | missed) p₀(t),
    p₀(t) = (1 − ω) N(t; σ₀² I + Σ_t) + ω N(t; σ₁² I + Σ_t),                    p₁(t) = ∫₀¹ N(t − λ D; σ_d² I + Σ_t) dλ.

Both alike before, the probability of being held is p(m, t | held) / (p(m, t | held) + p(m, t | missed)). It is held
above `sure`, missed below 1 − `sure`, and unknown in between: what m is far from both says nothing, and nothing is
guessed.
A lift goes back along the viewing ray; so a plan goes on sideways (`retreat.py`).

On a robot that measures its jaws' angle well enough the angle at which they stop tells as well: around thread of
0.4 mm, 8 mm from the pin, they stop 3° open. Backlash of driven cables is as much, so it is not used.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, curve_of
from agents.planner.moved import BESIDE_M, DEEP_M, Elsewhere, Motion, motion
from agents.planner.wedge import UNIFORM_BALL, thread_covariance
from schemas.messages import Checked, GraspPlan, Phase, Status, ThreadAround, ThreadReconstruction
from shared.kinematics.psm import FINGER_M

SAMPLES_BEFORE, SAMPLES_AFTER = 81, 401
LEAST_DENSITY = 1e-300
LEAST_LIFT_M, EVEN = 0.002, 0.5
WRONG_DEPTH, DEPTHS_M = 0.02, 2.0 * DEEP_M
"""ε and R."""
WRONG, AREA_M2 = 0.001, 4.0 * DEEP_M * BESIDE_M
"""η and A: what no passage is taken to be the goal's beyond."""
CALM_M, WRONG_M, WRONG_AS_WHOLE = 0.002, 0.01, 0.1
"""σ₀, σ₁ and ω."""
DRAGGED, DRAG_M = (np.arange(100) + 0.5) / 100, 0.002
"""λ, and σ_d: not all of the thread is dragged alike."""
MM_PER_M = 1e3


@dataclass(frozen=True)
class Seen:
    """What a check saw.

    Fields:
        motion: None where nothing was compared.
        held_probability: None likewise.
        doubtful: it cannot be told of what could be compared, and missed is likelier than held.
    """

    verdict: Checked
    sentence: str
    motion: Motion | None = None
    held_probability: float | None = None
    doubtful: bool = False


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
    found = motion(plan.around, goal, now, tool_moved, _is_seen(after, now))
    if found is None:
        return _unknown("no thread is seen near the jaws after the lift")
    if isinstance(found, Elsewhere):
        return _unknown(
            f"the thread at the goal is seen {MM_PER_M * found.off_m:.0f} mm from the way of the tool", doubtful=True
        )
    if found.tool_m < LEAST_LIFT_M:
        return _unknown("the tool moved along the thread, which tells nothing")
    likely = held_probability(found, grasped[:3, 1], config)
    beside = f"{MM_PER_M * found.beside_m:.0f} mm from the goal, where nothing of it is seen,"
    where = beside if found.beside_m else "at the goal"
    told = (
        f"the thread {where} moved {MM_PER_M * found.thread_m:.1f} mm (± {MM_PER_M * found.deviation_m:.1f}) the "
        f"way of the tool, which moved {MM_PER_M * found.tool_m:.1f} mm; all of it moved "
        f"{MM_PER_M * float(np.linalg.norm(found.common)):.1f} mm besides"
    )
    if likely >= config.sure:
        return Seen(Checked.HELD, f"held: {told}", found, likely)
    if likely <= 1.0 - config.sure:
        return Seen(Checked.MISSED, f"missed: {told}", found, likely)
    return Seen(Checked.UNKNOWN, f"cannot be told: {told}", found, likely, doubtful=likely < EVEN)


def held_probability(found: Motion, opens: Float64[np.ndarray, "3"], config: PlannerConfig) -> float:
    """That thread which moved so far is held, were both alike before.

    Args:
        opens: the way that the fingers open, a unit vector.
    """
    spread = found.covariance + config.settle_m**2 * np.eye(2)
    opened = found.axes @ opens
    taken = spread + (config.tool_error_m**2 + config.hand_eye_error_m**2 / UNIFORM_BALL) * np.outer(opened, opened)
    taken = taken + found.follows_covariance
    held, missed = _density(found.thread - found.follows, taken), _density(found.thread, spread)
    dragged = _density(found.thread + found.axes @ found.common - found.follows, taken)
    held = 0.5 * held + 0.5 * dragged * _dragged_rather(found)
    return held / (held + missed)


def _dragged_rather(found: Motion) -> float:
    """How much likelier the tool has moved the thread as a whole than something else: p₁(t) / p₀(t)."""
    along = found.common - DRAGGED[:, None] * found.tool_moved
    by_tool = float(_gaussian(along, found.common_covariance + DRAG_M**2 * np.eye(3)).mean())
    calm, wrong = (
        float(_gaussian(found.common[None], found.common_covariance + deviation**2 * np.eye(3))[0])
        for deviation in (CALM_M, WRONG_M)
    )
    return by_tool / max((1.0 - WRONG_AS_WHOLE) * calm + WRONG_AS_WHOLE * wrong, LEAST_DENSITY)


def _gaussian(off: Float64[np.ndarray, "n 3"], covariance: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "n"]:
    """Densities of being off by so much."""
    square = np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off.T).T)
    return np.exp(-0.5 * square) / math.sqrt((2.0 * math.pi) ** 3 * float(np.linalg.det(covariance)))


def _is_seen(thread: ThreadReconstruction, samples: ThreadAround) -> Bool[np.ndarray, "n"]:
    """Which samples of a thread both images show."""
    stretches = [thread.unseen, *([thread.hidden] if thread.hidden is not None else [])]
    start, end = np.concatenate(stretches).reshape(-1, 2).T[:, :, None]
    return ~((samples.s >= start) & (samples.s <= end)).any(axis=0)


def _density(off: Float64[np.ndarray, "2"], covariance: Float64[np.ndarray, "2 2"]) -> float:
    """Of being off by so much."""
    root = math.sqrt(float(np.linalg.det(covariance)))
    both = math.exp(-0.5 * float(off @ np.linalg.solve(covariance, off))) / (2.0 * math.pi * root)
    variance = float(covariance[1, 1])
    beside = math.exp(-0.5 * float(off[1]) ** 2 / variance) / math.sqrt(2.0 * math.pi * variance)
    return (1.0 - WRONG_DEPTH - WRONG) * both + WRONG_DEPTH * beside / DEPTHS_M + WRONG / AREA_M2


def _unknown(why: str, doubtful: bool = False) -> Seen:
    return Seen(Checked.UNKNOWN, f"cannot be told: {why}", doubtful=doubtful)
