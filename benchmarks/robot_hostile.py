"""Random and hostile plans and commands against the robot bridge, judged by the emulated console's oracle.

    .venv/bin/python -m benchmarks.robot --only hostile [--hostile 10000]

In each case a plan, good or bad, is published and armed while operator, clock, console or somebody else may misbehave,
or a motion is met in its midst by what should end it. Beside what the oracle calls unsafe it is counted what was
accepted that had to be refused, and how often a step of the bridge failed.
"""

from collections import Counter
from typing import Any

import numpy as np

from agents.robot_bridge.limits import MotionLimits
from benchmarks.robot_hostile_cases import CASES, Found
from benchmarks.robot_world import NAME, RIG_ARM, SECOND_NS, TOOL, World
from schemas.messages import CommandHeader, Hold
from schemas.topics import HOLD
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.ros import crtk
from shared.ros.types import STRING
from shared.ros.types import encode as ros_bytes
from shared.ros.types import message as ros_message

CASES_PER_WORLD = 50
BRISK = MotionLimits(
    speed=0.1,
    acceleration=4.0,
    jerk=400.0,
    angular_speed=3.0,
    angular_acceleration=60.0,
    angular_jerk=6000.0,
    jaw_speed=6.0,
    jaw_acceleration=240.0,
    jaw_jerk=24000.0,
    rounding_s=0.02,
)
LIMITS = (MotionLimits(), MotionLimits().slowed(0.3), BRISK)
LAGS_S = (0.0, 0.0, 0.02)


def hostile(count: int, seed: int = 0) -> dict[str, Any]:
    """So many cases; what the oracle, and the rules of what must be refused, found."""
    rng = np.random.default_rng(seed)
    found, unsafe, sentences = list[Found](), Counter[str](), list[str]()
    set_points = faults = moving = 0
    while len(found) < count:
        world = World(LIMITS[rng.integers(len(LIMITS))], LAGS_S[rng.integers(len(LAGS_S))])
        for _ in range(min(CASES_PER_WORLD, count - len(found))):
            case = CASES[rng.integers(len(CASES))]
            found.append(case(world, rng))
            moving += world.moves
            _put_right(world, rng)
        verdict = world.oracle.verdict()
        set_points, faults = set_points + verdict["set_points"], faults + world.faults
        unsafe.update(verdict["rules"])
        sentences += verdict["sentences"]
    wrongly = Counter(one.kind for one in found if one.accepted and not one.allowed)
    return {
        "cases": len(found),
        "accepted": sum(one.accepted for one in found),
        "still moving at the end": moving,
        "set points": set_points,
        "unsafe": sum(unsafe.values()),
        "rules": " ".join(unsafe) or "-",
        "wrongly accepted": sum(wrongly.values()),
        "of": " ".join(wrongly) or "-",
        "failed steps": faults,
        "sentences": sentences[:10],
    }


def _put_right(world: World, rng: np.random.Generator) -> None:
    """Have console and operator be well again, the arm where it is or somewhere else."""
    world.stands_by = False
    for word in ("loose", "speak"):
        world.console.request(word)
    _hold(world)
    said = world.console.verdict()
    for word in {"DISABLED": ("enable",), "FAULT": ("enable",), "PAUSED": ("resume",)}.get(said["state"], ()):
        world.topics.tell_console(f"{NAME}/state_command", crtk.state_command(word, world.now_ns))
    world.topics.tell_bridge(f"{NAME}/tool_type", ros_bytes(STRING, ros_message(STRING, TOOL)))
    world.topics.owner_changed("somebody", False)
    if rng.random() < 0.3:
        world.put(_any_joints(rng))
    # errors and other owners are forgotten after a while
    world.tick(2)
    world.now_ns += 3 * SECOND_NS
    world.tick(2 if said["is_homed"] else 105)


def _hold(world: World) -> None:
    header = CommandHeader(f"hold-{world.now_ns}", world.now_ns + SECOND_NS, "ann")
    world.command(HOLD, Hold(header, RIG_ARM))


def _any_joints(rng: np.random.Generator) -> np.ndarray:
    """Joints before the camera, mostly; sometimes anywhere within their limits."""
    if rng.random() < 0.2:
        limits = LARGE_NEEDLE_DRIVER.limits
        return limits[:, 0] + rng.random(6) * np.diff(limits, axis=1)[:, 0]
    start = np.array((0.1, 0.0, 0.16, 0.0, 0.0, 0.0))
    return start + rng.normal(size=6) * np.array((0.1, 0.08, 0.01, 1.5, 0.3, 0.3))
