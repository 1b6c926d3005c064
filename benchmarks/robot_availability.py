"""How often an arm holds though nobody wanted it to: one motion after another, with a person who never lets go.

Bridge, guard, console, person, camera and links are processes (robot_lab.py). A motion that ends otherwise than by
itself is a spurious hold, and its reason is told.
"""

import contextlib
import os
import queue
import tempfile
from pathlib import Path
from typing import Any

from schemas.codec import decode
from schemas.messages import ExecutionEvent, ExecutionKind
from schemas.topics import EXECUTION
from shared.clock import monotonic_s
from shared.runtime.session import SessionSettings, open_session
from shared.runtime.taps import Tapped, tap
from tests.rigs.robot.lab import RIG, Lab

LONGEST_S = 60.0
"""A motion takes some 15 s; one of which nothing was heard for so long is told as such."""
ENDS = (ExecutionKind.FINISHED, ExecutionKind.HELD, ExecutionKind.REFUSED)


def availability(minutes: float) -> dict[str, Any]:
    """Motions for so long; a row of a table."""
    told = queue.SimpleQueue[ExecutionEvent]()
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        lab = stack.enter_context(contextlib.closing(Lab(Path(folder), {"codec": "ros2dds"}, stack)))
        session = stack.enter_context(open_session(SessionSettings(RIG, lab.endpoint)))
        tap(session, RIG, (EXECUTION,), lambda tapped: _take(tapped, told), lambda _topic, _count: None)
        lab.move()
        begun_s, reasons, loads, finished, moving_s = monotonic_s(), list[str](), list[float](), 0, 0.0
        while monotonic_s() - begun_s < 60 * minutes:
            pressed_s = monotonic_s()
            end = _end_of(lab.press(), told)
            loads.append(os.getloadavg()[0])
            if end is not None and end.kind is ExecutionKind.FINISHED:
                finished += 1
                moving_s += monotonic_s() - pressed_s
            else:
                reasons.append("nothing was heard" if end is None else f"{end.code}: {end.reason}")
                print(f"  {reasons[-1]}", flush=True)
        return {
            "minutes": minutes,
            "motions": finished + len(reasons),
            "finished": finished,
            "minutes in motion": moving_s / 60,
            "spurious holds": len(reasons),
            "unsafe": lab.verdict()["unsafe"],
            "load": max(loads),
            "met": not reasons,
        }


def _take(tapped: Tapped, told: "queue.SimpleQueue[ExecutionEvent]") -> None:
    event = decode(ExecutionEvent, tapped.payload)
    if event.kind in ENDS:
        told.put(event)


def _end_of(plan_id: str, told: "queue.SimpleQueue[ExecutionEvent]") -> ExecutionEvent | None:
    deadline_s = monotonic_s() + LONGEST_S
    while (left_s := deadline_s - monotonic_s()) > 0:
        with contextlib.suppress(queue.Empty):
            event = told.get(timeout=left_s)
            if event.plan_id == plan_id:
                return event
    return None
