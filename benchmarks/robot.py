"""The way to a real robot, measured without one: hostile plans, set points, and how soon an arm stands still.

    .venv/bin/python -m benchmarks.robot [--repeats 3] [--hostile 10000] [--json FILE]

- hostile: random and hostile plans, commands, clocks and owners, with the guard and without;
- stops: how soon an emulated arm stands still when something is lost in mid-motion. Bridge and person reach console and
  rig through relays, which can be stopped, as a cable can be pulled, or queue;
- jitter: how evenly set points go out at 200 Hz while the whole pipeline runs beside the bridge, by the times that the
  bridge writes into them. One is missed where there was none within a period and a half;
- availability: one motion after another with a person who never lets go. One that ends otherwise than by itself is a
  spurious hold, and its reason is told.

All that runs are processes of this machine; what it does meanwhile shows in the times.
"""

import contextlib
import logging
import os
import queue
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from agents.cli.lab.rehearsal.network import CannotError
from agents.cli.lab.rehearsal.processes import faketime
from benchmarks.tables import CONSOLE, Row, print_rows, write_json
from schemas.codec import decode
from schemas.messages import ExecutionEvent, ExecutionKind
from schemas.topics import EXECUTION
from shared.clock import monotonic_s, now_ns
from shared.runtime.session import SessionSettings, open_session
from shared.runtime.taps import Tapped, tap
from tests.rigs.robot.hostile import hostile
from tests.rigs.robot.lab import RIG, STANDS_S, Lab, NotMovingError

GOAL_JITTER_MS, GOAL_MISSED_PERCENT = 2.0, 0.1
GOAL_STANDS_MS = 250.0


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
    only: Literal["all", "hostile", "stops", "jitter", "availability"] = "all"
    """One part alone."""
    json: Path | None = None
    """Write everything there."""


def main() -> None:
    """Measure and print."""
    options = tyro.cli(Options, description=__doc__)
    found: Row = {"load": os.getloadavg()[0], "processors": os.cpu_count()}
    parts = {"hostile": _hostile, "stops": _stops, "jitter": _jitter, "availability": _availability}
    for name, part in parts.items():
        if options.only in ("all", name):
            found |= part(options)
    write_json(options.json, found)


def _hostile(options: Options) -> Row:
    logging.disable(logging.WARNING)
    found = [
        {"guard": "on" if guarded else "off"} | hostile(options.hostile, guarded=guarded) for guarded in (True, False)
    ]
    logging.disable(logging.NOTSET)
    shown = [{name: each[name] for name in each if name != "sentences"} for each in found]
    print_rows("Hostile plans and commands; goal: nothing unsafe, nothing wrongly accepted, no step failed", shown)
    return {"hostile": found}


def _stops(options: Options) -> Row:
    turns = [(loss, codec) for _ in range(options.repeats) for codec in CODECS for loss in LOSSES]
    stops: list[Row] = []
    for turn in turns:
        CONSOLE.print(f"  {' '.join(turn)}: motion {len(stops) + 1} of {len(turns)}")
        stops.append(stopped_after(*turn))
    print_rows(f"Lost in mid-motion; goal: it stands within {GOAL_STANDS_MS:.0f} ms", stops)
    bad = QUEUES + (CLOCKS if can_set_clocks() else ())
    if len(bad) == len(QUEUES):
        CONSOLE.print("  no clock is set: libfaketime is not installed")
    queues: list[Row] = []
    for link, mode, seconds in bad:
        CONSOLE.print(f"  {link}: {mode} {seconds:g} s: {len(queues) + 1} of {len(bad)}")
        queues.append(released_through(link, mode, seconds))
    goal = f"goal: none later than {BOUND_MS:.0f} ms after the button was released"
    print_rows(f"Last set point at the console while a link is bad, or a clock was set; {goal}", queues)
    if missing := sum(row["set points"] is None for row in stops):
        CONSOLE.print(f"  {missing} of {len(turns)} motions did not come about; `waited` names what had no processor")
    return {"stops": stops, "queues": queues}


def _jitter(options: Options) -> Row:
    found = [jitter(options.seconds, realtime) for realtime in (True, False)]
    goal = f"goal with it: p99 within {GOAL_JITTER_MS:g} ms, {GOAL_MISSED_PERCENT:g} % missed"
    print_rows(f"Set points at 200 Hz under the whole pipeline, with real-time priority and without; {goal}", found)
    return {"jitter": found}


def _availability(options: Options) -> Row:
    found = [availability(options.minutes)]
    print_rows("One motion after another; goal: no hold that nobody wanted", found)
    return {"availability": found}


LONGEST_S = 60.0
"""A motion takes some 15 s; one of which nothing was heard for so long is told as such."""
ENDS = (ExecutionKind.FINISHED, ExecutionKind.HELD, ExecutionKind.REFUSED)


def availability(minutes: float) -> Row:
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


HZ = 200.0
PRIORITY = 50
MOST_TURNS = 40
PIPELINE: Row = {
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


def jitter(seconds: float, realtime: bool) -> Row:
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


FIGURES = (
    *("moved for ms", "hold after ms", "set points", "unsafe", "rules", "later", "moved later"),
    *("interval ms p50", "interval ms p99", "interval ms max", "waited"),
)
ATTEMPTS = 3
"""A motion may not come about where the console, a process in Python like the others, hardly gets a processor."""
Waits = dict[tuple[str, str], float]
CODECS = "ros2dds", "rmw_zenoh"
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


def stopped_after(loss: str, codec: str) -> Row:
    """One motion with one loss: what the emulated console says of it (ms after the loss), its oracle's verdict.

    `waited` names the process of which a thread waited longest for a processor from the loss to the arm's standing
    still: on a busy machine what took long may be that. Where no motion came about in ATTEMPTS, all else is None.
    """
    found = Row()
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


def _attempt(loss: str, codec: str) -> Row:
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        dvrk = {"codec": codec}
        lab = stack.enter_context(contextlib.closing(Lab(Path(folder), dvrk, stack)))
        named = {"lost": loss, "codec": codec}
        try:
            lab.move()
            return named | _stopped(lab, loss)
        except NotMovingError:
            return named | dict.fromkeys(FIGURES) | {"waited": longest_wait({}, lab.waited_ms())}


def _stopped(lab: Lab, loss: str) -> Row:
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


def released_through(link: str, mode: str, seconds: float) -> Row:
    """One motion in which a link turns bad, or a clock is set, and the person lets go: when the last set point came.

    Times are in ms after the person let go; a motion that was held before has its last set point before.
    """
    named: Row = {"link": link, "queues": mode, "s": seconds}
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


if __name__ == "__main__":
    main()
