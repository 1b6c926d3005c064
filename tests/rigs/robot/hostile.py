"""Random and hostile plans and commands against the robot bridge, judged by the emulated console's oracle.

Beside what the oracle calls unsafe it is counted what was accepted that had to be refused, and how often a step of the
bridge failed. `python -m benchmarks.robot --only hostile --hostile 10000` has many.
"""

import contextlib
import logging
import multiprocessing
import os
import signal
import sys
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents.robot_bridge.limits import PSM_JOINT_SPEEDS, MotionLimits
from schemas.messages import CommandHeader, Hold
from schemas.topics import HOLD
from shared.clock import monotonic_s
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.ros import crtk
from shared.ros.types import STRING
from shared.ros.types import encode as ros_bytes
from shared.ros.types import message as ros_message
from tests.rigs.robot.hostile_cases import CASES
from tests.rigs.robot.world import NAME, RIG_ARM, SECOND_NS, TOOL, World

CASES_PER_WORLD = 50
TOLD_EVERY_S = 10.0
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
RIGS = MotionLimits(joint_speeds=PSM_JOINT_SPEEDS)
LIMITS = (RIGS, RIGS.slowed(0.3), BRISK)
LAGS_S = (0.0, 0.0, 0.02)


def hostile(count: int, seed: int = 0, processes: int | None = None, guarded: bool = True) -> dict[str, Any]:
    """So many cases, on all processors; what the oracle, and the rules of what must be refused, found.

    Without `guarded` the guard passes everything, so that the bridge is judged alone.
    """
    worlds = [
        (seed, k, min(CASES_PER_WORLD, count - at), guarded) for k, at in enumerate(range(0, count, CASES_PER_WORLD))
    ]
    processes = min(len(worlds), processes or os.cpu_count() or 1)
    total, said_s = _Total(), monotonic_s()
    with contextlib.ExitStack() as stack, contextlib.suppress(KeyboardInterrupt):
        # whoever does not wait for the end is told what was found until then
        run = map if processes == 1 else stack.enter_context(_pool(processes)).imap_unordered
        for one in run(_world, worlds):
            total.add(one)
            if monotonic_s() - said_s > TOLD_EVERY_S:
                said_s = monotonic_s()
                told = f"  {total.counts['cases']} of {count} cases, {total.unsafe.total()} unsafe"
                print(told, file=sys.stderr, flush=True)
    return total.told()


def _pool(processes: int) -> Any:
    return multiprocessing.get_context("spawn").Pool(processes, initializer=_begin)


def _begin() -> None:
    """Say nothing of what hostile plans make a bridge say, and leave Ctrl-C to who started this."""
    logging.disable(logging.WARNING)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@dataclass
class _Total:
    """What worlds found, added up; `counts` by the names of a row of the table."""

    counts: Counter[str] = field(default_factory=Counter[str])
    unsafe: Counter[str] = field(default_factory=Counter[str])
    wrongly: Counter[str] = field(default_factory=Counter[str])
    sentences: list[str] = field(default_factory=list[str])

    def add(self, other: "_Total") -> None:
        """Add those of another."""
        self.counts.update(other.counts)
        self.unsafe.update(other.unsafe)
        self.wrongly.update(other.wrongly)
        self.sentences += other.sentences

    def told(self) -> dict[str, Any]:
        """As a row of the table, and what the oracle said of the first."""
        counted = ("cases", "accepted", "still moving at the end", "set points")
        return {name: self.counts[name] for name in counted} | {
            "unsafe": self.unsafe.total(),
            "rules": " ".join(sorted(self.unsafe)) or "-",
            "wrongly accepted": self.wrongly.total(),
            "of": " ".join(sorted(self.wrongly)) or "-",
            "failed steps": self.counts["failed steps"],
            "sentences": self.sentences[:10],
        }


def _world(given: tuple[int, int, int, bool]) -> _Total:
    """One world's cases, of a seed, a number, how many, and whether the guard judges."""
    *seeds, count, guarded = given
    rng, total = np.random.default_rng(seeds), _Total()
    world = World(LIMITS[rng.integers(len(LIMITS))], LAGS_S[rng.integers(len(LAGS_S))], guarded=guarded)
    for _ in range(count):
        kind, accepted, allowed = CASES[rng.integers(len(CASES))](world, rng)
        total.counts.update({"cases": 1, "accepted": accepted, "still moving at the end": world.moves})
        if accepted and not allowed:
            total.wrongly[kind] += 1
        _put_right(world, rng)
    verdict = world.oracle.verdict()
    total.counts.update({"set points": verdict["set_points"], "failed steps": world.faults})
    total.unsafe.update(verdict["rules"])
    total.sentences += verdict["sentences"]
    return total


def _put_right(world: World, rng: np.random.Generator) -> None:
    """Have console and operator be well again, the arm where it is or somewhere else."""
    world.stands_by, world.sees = False, True
    for word in ("loose", "speak", "no_teleop"):
        world.console.request(word)
    header = CommandHeader(f"hold-{world.now_ns}", world.now_ns + SECOND_NS, "ann")
    world.command(HOLD, Hold(header, RIG_ARM))
    said = world.console.verdict()
    if word := {"DISABLED": "enable", "FAULT": "enable", "PAUSED": "resume"}.get(said["state"]):
        world.topics.tell_console(f"{NAME}/state_command", crtk.state_command(word, world.now_ns))
    world.topics.tell_bridge(f"{NAME}/tool_type", ros_bytes(STRING, ros_message(STRING, TOOL)))
    world.topics.owner_changed("somebody", False)
    if rng.random() < 0.3:
        world.put(_any_joints(rng))
    # errors and other owners are forgotten after a while
    world.tick(2)
    world.now_ns += 3 * SECOND_NS
    world.tick(2 if said["is_homed"] else 105)


def _any_joints(rng: np.random.Generator) -> np.ndarray:
    """Joints before the camera, mostly; sometimes anywhere within their limits."""
    if rng.random() < 0.2:
        limits = LARGE_NEEDLE_DRIVER.limits
        return limits[:, 0] + rng.random(6) * np.diff(limits, axis=1)[:, 0]
    start = np.array((0.1, 0.0, 0.16, 0.0, 0.0, 0.0))
    return start + rng.normal(size=6) * np.array((0.1, 0.08, 0.01, 1.5, 0.3, 0.3))
