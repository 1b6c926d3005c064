"""The way to a real robot, measured without one: messages, kinematics, set points, and how soon an arm stands still.

    .venv/bin/python -m benchmarks.robot [--repeats 3] [--hostile 10000] [--json FILE]

Messages are compared with cyclonedds's own library too where that is installed. Everything runs on this machine; what
it does meanwhile shows in the times.
"""

import json
import logging
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from rich.table import Table

from benchmarks.robot_availability import availability
from benchmarks.robot_jitter import jitter
from benchmarks.robot_stops import BOUND_MS, CLOCKS, LOSSES, QUEUES, can_set_clocks, released_through, stopped_after
from benchmarks.tables import CONSOLE
from shared.clock import processor_s
from shared.kinematics.psm import INSERTION, LARGE_NEEDLE_DRIVER, forward, inverse
from tests.rigs.robot.hostile import hostile
from tests.rigs.robot.messages import CYCLONE, PYCDR2, compared, others

POSES, ROUNDS = 20_000, 3
GOAL_JITTER_MS, GOAL_MISSED_PERCENT = 2.0, 0.1
GOAL_ERROR, GOAL_MICROSECONDS, GOAL_STANDS_MS = 1e-12, 50.0, 250.0


@dataclass(frozen=True)
class Options:
    """What is measured."""

    repeats: int = 1
    """Motions for each loss and codec."""
    hostile: int = 1000
    """Random and hostile plans and commands."""
    seconds: float = 60.0
    """For which set points are sent while the whole pipeline runs, with real-time priority and without."""
    minutes: float = 30.0
    """For which one motion follows another, to see whether the arm holds though nobody wants it to."""
    only: Literal["all", "messages", "kinematics", "hostile", "stops", "jitter", "availability"] = "all"
    """One part alone."""
    json: Path | None = None
    """Write everything there."""


def main() -> None:
    """Measure and print."""
    options = tyro.cli(Options)
    found: dict[str, Any] = {"load": os.getloadavg()[0], "processors": os.cpu_count()}
    if options.only in ("all", "messages"):
        found["messages"] = compared()
        _print("CDR, byte for byte", found["messages"])
        if CYCLONE not in others():
            CONSOLE.print(f"  {CYCLONE} is not installed here; compared with {PYCDR2} alone")
    if options.only in ("all", "kinematics"):
        found["kinematics"] = kinematics()
        _print("Kinematics of the PSM", [found["kinematics"]])
    if options.only in ("all", "hostile"):
        logging.disable(logging.WARNING)
        found["hostile"] = [
            {"guard": "on" if guarded else "off"} | hostile(options.hostile, guarded=guarded)
            for guarded in (True, False)
        ]
        shown = [{name: each[name] for name in each if name != "sentences"} for each in found["hostile"]]
        _print("Hostile plans and commands; goal: nothing unsafe, nothing wrongly accepted, no step failed", shown)
        logging.disable(logging.NOTSET)
    if options.only in ("all", "stops"):
        codecs = ("ros2dds", "rmw_zenoh")
        turns = [(loss, codec) for _ in range(options.repeats) for codec in codecs for loss in LOSSES]
        found["stops"] = list[dict[str, Any]]()
        for turn in turns:
            CONSOLE.print(f"  {' '.join(turn)}: motion {len(found['stops']) + 1} of {len(turns)}")
            found["stops"].append(stopped_after(*turn))
        _print(f"Lost in mid-motion; goal: it stands within {GOAL_STANDS_MS:.0f} ms", found["stops"])
        found["queues"] = []
        bad = QUEUES + (CLOCKS if can_set_clocks() else ())
        if len(bad) == len(QUEUES):
            CONSOLE.print("  no clock is set: libfaketime is not installed")
        for number, queue in enumerate(bad):
            CONSOLE.print(f"  {queue[0]}: {queue[1]} {queue[2]:g} s: {number + 1} of {len(bad)}")
            found["queues"].append(released_through(*queue))
        goal = f"goal: none later than {BOUND_MS:.0f} ms after the button was released"
        _print(f"Last set point at the console while a link is bad, or a clock was set; {goal}", found["queues"])
        if missing := sum(row["set points"] is None for row in found["stops"]):
            CONSOLE.print(
                f"  {missing} of {len(turns)} motions did not come about; `waited` names what had no processor"
            )
    if options.only in ("all", "jitter"):
        found["jitter"] = [jitter(options.seconds, realtime) for realtime in (True, False)]
        goal = f"goal with it: p99 within {GOAL_JITTER_MS:g} ms, {GOAL_MISSED_PERCENT:g} % missed"
        _print(
            f"Set points at 200 Hz under the whole pipeline, with real-time priority and without; {goal}",
            found["jitter"],
        )
    if options.only in ("all", "availability"):
        found["availability"] = [availability(options.minutes)]
        _print("One motion after another; goal: no hold that nobody wanted", found["availability"])
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=1) + "\n")


def kinematics() -> dict[str, Any]:
    """How well the inverse undoes the forward kinematics over the joints' whole range, and how long each takes."""
    limits = LARGE_NEEDLE_DRIVER.limits.copy()
    limits[INSERTION, 0] = LARGE_NEEDLE_DRIVER.shaft_clearance - LARGE_NEEDLE_DRIVER.shaft_offset
    joints = limits[:, 0] + np.random.default_rng(3).random((POSES, 6)) * np.diff(limits, axis=1)[:, 0]
    T = forward(joints)
    solved = inverse(T)
    # beyond half a turn the roll comes back by whole turns, which lead to the same pose
    error = float(np.abs(forward(solved.joints) - T).max())
    taken = {"forward µs": _microseconds(lambda: forward(joints)), "inverse µs": _microseconds(lambda: inverse(T))}
    return {
        "poses": POSES,
        "unsolved": int(np.isnan(solved.joints).any(axis=1).sum()),
        "error": error,
        **taken,
        "met": error <= GOAL_ERROR and max(taken.values()) <= GOAL_MICROSECONDS,
    }


def _microseconds(work: Any) -> float:
    taken: list[float] = []
    for _ in range(ROUNDS):
        begun_s = processor_s()
        work()
        taken.append((processor_s() - begun_s) / POSES * 1e6)
    return min(taken)


def _print(title: str, rows: list[dict[str, Any]]) -> None:
    table = Table(title=title, title_justify="left")
    for column in rows[0]:
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(*(_shown(value) for value in row.values()))
    CONSOLE.print(table)


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.1e}" if 0 < abs(value) < 1e-3 else f"{value:.1f}"
    return "-" if value is None else str(value)


if __name__ == "__main__":
    main()
