"""How soon an emulated arm stands still when something is lost in mid-motion, and how evenly set points come.

The rig's router, robot bridge, operator's command, guard and emulated console are processes; the bridge reaches the
console through a relay, a process that can be stopped, as a cable can be pulled.
"""

import contextlib
import tempfile
import threading
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robot_lab import STANDS_S, Lab, NotMovingError
from shared.clock import now_ns

PAST_GUARD = "link, past the guard"
"""What executes later where the bridge itself speaks to the console over a link that is cut, as no rig's file may."""
FIGURES = (
    *("moved for ms", "hold after ms", "set points", "unsafe", "rules", "later", "moved later"),
    *("interval ms p50", "interval ms p99", "interval ms max", "waited"),
)
ATTEMPTS = 3
"""A motion may not come about where the console, a process in Python like the others, hardly gets a processor."""
Waits = dict[tuple[str, str], float]
LOSSES = ("operator", "router", "link", PAST_GUARD, "bridge")


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
        dvrk = {"codec": codec, "through_guard": loss != PAST_GUARD}
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
