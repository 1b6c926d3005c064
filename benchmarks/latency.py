"""Latency: of one hop from process to process, and of the live dataflow of the demo, left running.

    python -m benchmarks.latency [--only hops|stages|parts] [--seconds 20] [--json out/latency.json]

Hops are those of benchmarks/hops.py, beside dora-rs in the same run where it can be had. Parts are those that
benchmarks/parts.py leaves out of a hop one at a time, measured only where they are asked for. Stages are latency and
rate per stage, drops, frames that nobody accounts for, and what each process takes. The processes are those of
`suturegrasp demo`, recorder and viewer included, on a router of their own; no goal is named. Latency is from capture
until publication, both by this machine's clock, and read from the recording afterwards, so that measuring takes
nothing. What happens in the first seconds, while processes start, is left out.
"""

import bisect
import json
import os
import tempfile
import threading
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import psutil
import tyro
from rich.console import Console
from rich.table import Table

from agents.cli.demo.command import demo_rig
from agents.cli.live.options import Demo
from agents.cli.live.up import start_all, write_config
from agents.configuration.rig import RigConfig
from agents.launch.session_folder import SessionFolder, new_session_folder
from agents.launch.supervisor import Supervisor, supervised
from benchmarks.hops import measure_hops, print_hops
from benchmarks.parts import measure_parts, print_parts
from schemas.codec import decode
from schemas.messages import AgentHealth
from schemas.topics import FRAMES, HEALTH, OBSERVATIONS, THREAD, Topic, topic_of
from shared.clock import now_ns
from shared.recording.mcap_file import read_recording

STAGES = (FRAMES, OBSERVATIONS, THREAD)
COUNTS = 8
"""Of a consumer, at either end of a time; the one with the least on its way is taken."""


@dataclass(frozen=True)
class Options:
    """What to measure, how long, and of which field.

    Fields:
        only: hops, stages or parts; hops and stages where none is named.
        settle: seconds that are left out at the beginning.
        rounds: of hops, whose medians count.
        messages: of each kind of hop in each round.
    """

    only: Literal["hops", "stages", "parts"] | None = None
    rounds: int = 3
    messages: int = 200

    seconds: float = 20.0
    settle: float = 12.0
    seed: int = 1
    json: Path | None = None


def main() -> None:
    """Measure, print a table, and write JSON where asked to."""
    options = tyro.cli(Options)
    measured: dict[str, Any] = {}
    if options.only == "parts":
        measured["parts"] = measure_parts(options.rounds, options.messages)
        print_parts(Console(width=130), measured["parts"])
    if options.only in (None, "hops"):
        measured["hops"] = measure_hops(options.rounds, options.messages)
        print_hops(Console(width=130), measured["hops"])
    if options.only in (None, "stages"):
        measured |= measure(demo_rig(Demo(seed=options.seed)), options)
        print_tables(measured)
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(measured, indent=1) + "\n")


def measure(rig: RigConfig, options: Options) -> dict[str, Any]:
    """Run every process of a rig and stop it again; what was measured in between."""
    with tempfile.TemporaryDirectory() as sessions:
        folder = new_session_folder(Path(sessions))
        write_config(folder.path / "rig.json", rig)
        load_before = os.getloadavg()[0]
        with supervised(restart=False) as supervisor:
            start_all(supervisor, rig, folder.path / "rig.json", folder, "file")
            _wait(options.settle, supervisor)
            begin_ns, before = now_ns(), _cpu_seconds(supervisor)
            _wait(options.seconds, supervisor)
            end_ns, after = now_ns(), _cpu_seconds(supervisor)
        seconds = 1e-9 * (end_ns - begin_ns)
        share = {name: (after[name] - before[name]) / seconds for name in after if name in before}
        stages, drops, lost = _of_recording(folder, begin_ns, end_ns)
    return {
        "seconds": seconds,
        "cores": os.cpu_count(),
        "opencv threads": cv2.getNumThreads(),
        "load before": load_before,
        "stages": {str(topic): _summary(ms, seconds, share[topic.agent]) for topic, ms in stages.items()},
        "drops": drops,
        "frames unaccounted for": lost,
        "cpu share": share,
    }


def _wait(seconds: float, supervisor: Supervisor) -> None:
    threading.Event().wait(seconds)
    for change in supervisor.watch():
        raise SystemExit(f"nothing was measured: {change.sentence}")


def _cpu_seconds(supervisor: Supervisor) -> dict[str, float]:
    """Of each process since it began, in user and system mode."""
    times = {c.name: psutil.Process(c.process.pid).cpu_times() for c in supervisor.children if c.process is not None}
    return {name: spent.user + spent.system for name, spent in times.items()}


def _of_recording(
    folder: SessionFolder, begin_ns: int, end_ns: int
) -> tuple[dict[Topic, list[float]], dict[str, dict[str, int]], int]:
    """Within a time: milliseconds from capture by stage, what each agent counts of its inputs, and frames unaccounted
    for by perception."""
    stages: defaultdict[Topic, list[float]] = defaultdict(list)
    counts: defaultdict[str, list[dict[str, int]]] = defaultdict(list)
    published_ns: list[int] = []
    told_at: list[tuple[int, int]] = []
    for entry in read_recording(folder.recording):
        topic = topic_of(entry.key)
        if not begin_ns <= entry.published_ns <= end_ns or topic not in (*STAGES, HEALTH):
            continue
        message = decode(topic.message, entry.payload)
        if isinstance(message, AgentHealth):
            for account in message.inputs:
                found = {name: getattr(account, name) for name in ("received", "dropped", "missed", "refused")}
                counts[f"{message.agent} {message.instance} of {account.topic}"].append(found)
                if (message.agent, account.topic) == (OBSERVATIONS.agent, str(FRAMES)):
                    told_at.append((message.at_ns, sum(found.values())))
        else:
            if topic is FRAMES:
                published_ns.append(entry.published_ns)
            seen_ns = max(message.stamp.capture_left_ns, message.stamp.capture_right_ns)
            stages[topic].append(1e-6 * (entry.published_ns - seen_ns))
    drops = {who: {name: told[-1][name] - told[0][name] for name in told[0]} for who, told in sorted(counts.items())}
    found_stages = {topic: stages[topic] for topic in STAGES if stages[topic]}
    return found_stages, drops, unaccounted(sorted(published_ns), told_at)


def unaccounted(published_ns: list[int], told: list[tuple[int, int]]) -> int:
    """Frames that were published in a time and that their consumer neither looked at nor counts as lost in some way.

    `told` are the consumer's counts of both, with the time of each. What is on its way when the consumer counts is in
    one count and not yet in the other: of several counts at the beginning and at the end, those with the least on its
    way are compared. A frame that is lost is missing in all that follow.
    """
    ahead = [bisect.bisect_right(published_ns, at_ns) - count for at_ns, count in told]
    some = min(COUNTS, len(ahead) // 2)
    return min(ahead[-some:]) - min(ahead[:some]) if some else 0


def _summary(ms: list[float], seconds: float, share: float) -> dict[str, float]:
    p50, p99 = np.percentile(ms, (50, 99))
    rate_hz = len(ms) / seconds
    return {
        "p50 ms": float(p50),
        "p99 ms": float(p99),
        "rate hz": rate_hz,
        "messages": len(ms),
        "cpu ms of its agent per message": 1e3 * share / rate_hz,
    }


def print_tables(measured: dict[str, Any]) -> None:
    """Stages, drops and processes."""
    console = Console(width=110)
    console.print(
        f"{measured['seconds']:.0f} s on {measured['cores']} cores, load {measured['load before']:.1f} before the start"
    )
    _print(console, "from capture until published", measured["stages"])
    _print(console, "inputs", measured["drops"])
    console.print(f"frames unaccounted for: {measured['frames unaccounted for']}")
    shares = {name: {"cpu %": 100.0 * share} for name, share in measured["cpu share"].items()}
    _print(console, "share of one core; of agents that wait for a goal, planner and bridge, 1 % is the goal", shares)


def _print(console: Console, title: str, rows: dict[str, dict[str, float]]) -> None:
    table = Table("", *next(iter(rows.values()), {}), title=title, title_justify="left")
    for name, row in rows.items():
        table.add_row(name, *(f"{v}" if isinstance(v, int) else f"{v:.2f}" for v in row.values()))
    console.print(table)


if __name__ == "__main__":
    main()
