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

from benchmarks.robot_lab import STANDS_S, Lab
from shared.clock import now_ns

PAST_GUARD = "link, past the guard"
"""What executes later where the bridge itself speaks to the console over a link that is cut, as no rig's file may."""
LOSSES = ("operator", "router", "link", PAST_GUARD, "bridge")


def stopped_after(loss: str, codec: str) -> dict[str, Any]:
    """One motion with one loss: what the emulated console says of it (ms after the loss), its oracle's verdict."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        dvrk = {"codec": codec, "through_guard": loss != PAST_GUARD}
        lab = stack.enter_context(contextlib.closing(Lab(Path(folder), dvrk, stack)))
        lab.move()
        before = lab.verdict()
        lost_ns = now_ns()
        lab.lose(loss)
        after = lab.still(lost_ns)
        if loss.startswith("link"):
            lab.mend()
            threading.Event().wait(STANDS_S)
        final = lab.verdict()
        came = np.diff(before["arrivals_s"][20:]) * 1e3
        return {
            "lost": loss,
            "codec": codec,
            "moved for ms": max(0.0, (after["moved_ns"] - lost_ns) * 1e-6),
            "hold after ms": min(
                ((at_ns - lost_ns) * 1e-6 for at_ns in final["holds_ns"] if at_ns > lost_ns), default=None
            ),
            "set points": final["set_points"],
            "unsafe": final["unsafe"],
            "rules": " ".join(final["rules"]) or "-",
            "later": final["set_points"] - after["set_points"],
            "moved later": final["moved_ns"] > after["moved_ns"],
            "interval ms p50": float(np.median(came)),
            "interval ms p99": float(np.percentile(came, 99)),
            "interval ms max": float(came.max()),
        }
