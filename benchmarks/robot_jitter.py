"""How evenly set points go out at 200 Hz while the whole pipeline runs beside the bridge on the same machine.

Bridge, console, camera, simulator, perception, reconstruction and planner are processes. What is measured are the
times that the bridge writes into its set points, which do not depend on how soon the console, a process in Python like
the others, gets to reading them; when they came there is told beside. Jitter is how far from 5 ms after the one before
a set point came; one is missed where there was none within a period and a half.
"""

import contextlib
import os
import tempfile
import threading
from pathlib import Path
from typing import Any

import numpy as np

from shared.clock import monotonic_s
from tests.rigs.robot.lab import Lab

HZ = 200.0
PRIORITY = 50
MOST_TURNS = 40
PIPELINE: dict[str, Any] = {
    "camera": {},
    "perception": {},
    "reconstruction": {},
    "planner": {},
    "simulator": {"config": "easy", "background": "plain"},
}
TURNS_A_SECOND = 0.4
LOOK_S = 0.5
GAP_MS = 200.0
"""As long as that no motion lasts without a set point: the bridge holds, and is armed again."""


def jitter(seconds: float, realtime: bool) -> dict[str, Any]:
    """Set points for so long, with real-time priority for the bridge or without; a row of a table."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        turns = max(6, min(round(seconds * TURNS_A_SECOND), MOST_TURNS))
        dvrk = {"codec": "ros2dds"}
        lab = stack.enter_context(contextlib.closing(Lab(Path(folder), dvrk, stack, turns, PIPELINE)))
        lab.move()
        scheduled = schedule(lab.pid("bridge"), realtime)
        begun_s, begun, held, loads = monotonic_s(), len(lab.verdict()["sent_ns"]), 0, list[float]()
        while monotonic_s() - begun_s < seconds:
            threading.Event().wait(LOOK_S)
            loads.append(os.getloadavg()[0])
            if not lab.operated():
                held += 1
                lab.move()
        verdict = lab.verdict()
        sent = np.diff(np.array(verdict["sent_ns"][begun:], np.int64)).astype(np.float64) * 1e-6
        came = np.diff(np.array(verdict["arrivals_s"][begun:], np.float64)) * 1e3
        return {
            "real time": scheduled,
            "set points": len(sent) + 1,
            **_figures("sent", sent),
            **_figures("came", came),
            "unsafe": verdict["unsafe"],
            "held": held,
            "load": max(loads),
        }


def schedule(pid: int, realtime: bool) -> str:
    """Give all threads of a process real-time priority, or take it from them; what they have then, or why not."""
    policy, priority = (os.SCHED_FIFO, PRIORITY) if realtime else (os.SCHED_OTHER, 0)
    try:
        for thread in Path(f"/proc/{pid}/task").iterdir():
            os.sched_setscheduler(int(thread.name), policy, os.sched_param(priority))
    except OSError as error:
        return f"not granted: {error.strerror}"
    return f"SCHED_FIFO {PRIORITY}" if realtime else "none"


def _figures(name: str, intervals_ms: np.ndarray) -> dict[str, float]:
    within = intervals_ms[intervals_ms < GAP_MS]
    period_ms = 1e3 / HZ
    missed = np.maximum(np.round(within / period_ms) - 1, 0).sum()
    return {
        f"{name} jitter ms p50": float(np.percentile(np.abs(within - period_ms), 50)),
        f"{name} p99": float(np.percentile(np.abs(within - period_ms), 99)),
        f"{name} max": float(np.abs(within - period_ms).max()),
        f"{name} missed %": float(100 * missed / (missed + len(within))),
    }
