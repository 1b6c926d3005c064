"""How soon an emulated arm stands still when something is lost in mid-motion, and how evenly set points come.

The rig's router, robot bridge, guard, emulated console, a person who presses and a camera are processes. The bridge
reaches the console, and the person the rig, through relays, which can be stopped, as a cable can be pulled, or queue.
"""

import contextlib
import tempfile
import threading
from pathlib import Path
from typing import Any

import numpy as np

from agents.cli.lab.rehearsal.network import CannotError
from agents.cli.lab.rehearsal.processes import faketime
from shared.clock import now_ns
from tests.rigs.robot.lab import STANDS_S, Lab, NotMovingError

FIGURES = (
    *("moved for ms", "hold after ms", "set points", "unsafe", "rules", "later", "moved later"),
    *("interval ms p50", "interval ms p99", "interval ms max", "waited"),
)
ATTEMPTS = 3
"""A motion may not come about where the console, a process in Python like the others, hardly gets a processor."""
Waits = dict[tuple[str, str], float]
LOSSES = ("operator", "camera", "router", "link", "bridge")
"""The operator lets go, the camera freezes, all else is killed or stopped."""
QUEUES = tuple(
    (link, mode, seconds)
    for link in ("robot", "rig")
    for mode, seconds in (
        *(("constant", seconds) for seconds in (0.05, 0.2, 1.0, 5.0)),
        ("growing", 5.0),
        *(("bursts", seconds) for seconds in (0.15, 0.5, 2.0)),
        ("loss", 0.0),
        *(("reordered", seconds) for seconds in (0.05, 0.5)),
    )
)
CLOCKS = tuple(
    (f"clock of the {name}", "set", ahead_s) for name in ("operator", "bridge", "guard") for ahead_s in (10.0, -10.0)
)
"""Set in mid-motion, where libfaketime is installed."""
RELEASED_AFTER_S, DRAINED_S = 0.3, 6.0
BOUND_MS = 250.0


def can_set_clocks() -> bool:
    """Whether a process can have a clock of its own here."""
    with contextlib.suppress(CannotError):
        return bool(faketime())
    return False


def stopped_after(loss: str, codec: str) -> dict[str, Any]:
    """One motion with one loss: what the emulated console says of it (ms after the loss), its oracle's verdict.

    `waited` names the process of which a thread waited longest for a processor from the loss to the arm's standing
    still: on a busy machine what took long may be that. Where no motion came about in ATTEMPTS, all else is None.
    """
    found = dict[str, Any]()
    for _ in range(ATTEMPTS):
        found = _attempt(loss, codec)
        if found["set points"] is not None:
            break
    return found


def longest_wait(before: Waits, after: Waits) -> str:
    """Which process waited longest for a processor in between, and how long."""
    waited = [(ms - before.get(thread, 0.0), thread[0]) for thread, ms in after.items()]
    ms, name = max(waited, default=(0.0, "none"))
    return f"{name} {ms:.0f} ms"


def _attempt(loss: str, codec: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        dvrk = {"codec": codec}
        lab = stack.enter_context(contextlib.closing(Lab(Path(folder), dvrk, stack)))
        named = {"lost": loss, "codec": codec}
        try:
            lab.move()
            return named | _stopped(lab, loss)
        except NotMovingError:
            return named | dict.fromkeys(FIGURES) | {"waited": longest_wait({}, lab.waited_ms())}


def _stopped(lab: Lab, loss: str) -> dict[str, Any]:
    before, waited = lab.verdict(), lab.waited_ms()
    lost_ns = now_ns()
    lab.lose(loss)
    after = lab.still(lost_ns)
    longest = longest_wait(waited, lab.waited_ms())
    if loss.startswith("link"):
        lab.mend()
        threading.Event().wait(STANDS_S)
    final = lab.verdict()
    came = np.diff(before["arrivals_s"][20:]) * 1e3
    holds_ms = ((at_ns - lost_ns) * 1e-6 for at_ns in final["holds_ns"] if at_ns > lost_ns)
    told = (
        max(0.0, (after["moved_ns"] - lost_ns) * 1e-6),
        min(holds_ms, default=None),
        final["set_points"],
        final["unsafe"],
        " ".join(final["rules"]) or "-",
        final["set_points"] - after["set_points"],
        final["moved_ns"] > after["moved_ns"],
        *(float(figure) for figure in (*np.percentile(came, (50, 99)), came.max())),
        longest,
    )
    return dict(zip(FIGURES, told, strict=True))


def released_through(link: str, mode: str, seconds: float) -> dict[str, Any]:
    """One motion in which a link turns bad, or a clock is set, and the person lets go: when the last set point came.

    Times are in ms after the person let go; a motion that was held before has its last set point before.
    """
    named: dict[str, Any] = {"link": link, "queues": mode, "s": seconds}
    figures = ("last set point ms", "hold ms", "unsafe", "armed again", "met")
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        lab = stack.enter_context(
            contextlib.closing(Lab(Path(folder), {"codec": "ros2dds"}, stack, queue=(link, mode, seconds)))
        )
        clock = link.removeprefix("clock of the ") if mode == "set" else ""
        try:
            lab.move()
        except NotMovingError:
            return named | dict.fromkeys(figures)
        if clock:
            lab.set_clock(clock, seconds)
        else:
            lab.signal(f"link of the {link}")
        threading.Event().wait(RELEASED_AFTER_S)
        lab.signal("operator")
        threading.Event().wait(DRAINED_S)
        released_ns = lab.said("operator")[-1]["released_ns"] - round(1e9 * seconds) * (clock == "operator")
        verdict, again = lab.verdict(), lab.answer()
        last_ms = 1e-6 * (verdict["set_point_ns"] - released_ns)
        holds_ms = [1e-6 * (at_ns - released_ns) for at_ns in verdict["holds_ns"]]
        hold_ms = min((ms for ms in holds_ms if ms > last_ms), default=None)
        told = (last_ms, hold_ms, verdict["unsafe"], again, last_ms <= BOUND_MS and verdict["unsafe"] == 0)
        return named | dict(zip(figures, told, strict=True))
