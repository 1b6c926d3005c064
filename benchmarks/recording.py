"""Recording under load: what is lost, what the recorder takes, and what a kill costs.

    python -m benchmarks.recording [--seconds 60] [--raw-seconds 15] [--kill-seconds 10] [--json out/recording.json]

Router, recorder (`suturegrasp record`) and publishers are processes of their own, as on a rig. What the publishers say
they sent is compared with what the file holds, key by key, and with what the file says of itself. `--folder` is where
the recordings lie meanwhile.
"""

import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import psutil
import tyro

from agents.cli.live.up import write_config
from agents.configuration.rig import RigConfig, RouterSection
from benchmarks.recording_load import RIG, publish
from benchmarks.tables import CONSOLE, print_rows, write_json
from shared.clock import monotonic_s, now_ns
from shared.recording.completeness import completeness
from shared.recording.mcap_file import read_recording
from shared.runtime.session import free_local_endpoint

CLI = (sys.executable, "-m", "agents.cli")
SAMPLE_S = 0.25
ARRIVE_S, STARTS_S = 1.5, 60.0
"""After the last message was sent, before the recorder is stopped."""
CPU_GOAL, GROWTH_GOAL_MB, KILL_GOAL_S = 0.25, 20.0, 0.5


@dataclass(frozen=True)
class Options:
    """How long each load lasts; 0 leaves it out."""

    seconds: float = 60.0
    raw_seconds: float = 15.0
    kill_seconds: float = 10.0
    folder: Path | None = None
    foxglove: bool = True
    json: Path | None = None


@dataclass
class Run:
    """One load and what came of it.

    Fields:
        cpu: share of one core that the recorder took while messages came.
        growth_mb: of the recorder's memory, from the middle third of the time to the last, medians of both.
        unheard_s: from the last message in the file until the recorder was killed.
        stated: what the file says it lacks, as a number of messages; None where it says that it was cut off.
    """

    name: str
    sent: int = 0
    lost: int = 0
    stated: int | None = None
    sentence: str = ""
    megabytes: float = 0.0
    cpu: float = 0.0
    growth_mb: float = 0.0
    most_mb: float = 0.0
    unheard_s: float | None = None
    lost_by_key: dict[str, int] = field(default_factory=dict[str, int])


def main() -> None:
    """Measure, print tables, and write JSON where asked to."""
    options = tyro.cli(Options, description=__doc__)
    load_before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        runs = _all_runs(Path(folder), options)
    print_rows(f"load {load_before:.1f} before the start, on {os.cpu_count()} cores", [_row(run) for run in runs])
    for run in runs:
        if run.unheard_s is not None:
            CONSOLE.print(f"{run.name}: {run.unheard_s:.2f} s lost, goal {KILL_GOAL_S}; the file says: {run.sentence}")
        elif run.lost_by_key or run.stated != run.lost:
            CONSOLE.print(f"{run.name}: lost {run.lost_by_key}; the file says {run.stated}")
    write_json(options.json, [vars(run) for run in runs])


def _all_runs(folder: Path, options: Options) -> list[Run]:
    loads = (
        ("JPEG 60 Hz, all topics", "camera_jpeg", options.seconds, False),
        ("raw 30 Hz, all topics", "camera_raw", options.raw_seconds, False),
        ("JPEG 60 Hz, kill -9", "camera_jpeg", options.kill_seconds, True),
    )
    return [
        measure(folder, name, camera, seconds, killed, options.foxglove)
        for name, camera, seconds, killed in loads
        if seconds > 0
    ]


def measure(folder: Path, name: str, camera: str, seconds: float, killed: bool, foxglove: bool) -> Run:
    """One load on a router and a recorder of its own."""
    path, rig = folder / f"{camera}_{killed}.mcap", folder / "rig.json"
    endpoint = free_local_endpoint()
    write_config(rig, RigConfig(rig=RIG, router=RouterSection(endpoint=endpoint)))
    router = subprocess.Popen([*CLI, "router", "--config", str(rig)], stdout=subprocess.DEVNULL)
    extra = [] if foxglove else ["--no-foxglove"]
    recorder = subprocess.Popen(
        [*CLI, "record", "--config", str(rig), "--output", str(path), *extra],
        stdout=subprocess.PIPE,
        text=True,
    )
    context = multiprocessing.get_context("spawn")
    begin, counts = context.Event(), context.Queue()
    publishers = [
        (context.Process(target=publish, args=(endpoint, process, seconds, ready, begin, counts)), ready)
        for process, ready in ((process, context.Event()) for process in (camera, "robot", "perception"))
    ]
    try:
        for publisher, _ in publishers:
            publisher.start()
        for _, ready in publishers:
            if not ready.wait(STARTS_S):
                raise SystemExit("the publishers did not come up")
        run = Run(name)
        begin.set()
        killed_ns = _watch(recorder, seconds, killed, run)
        sent = Counter[str]()
        for _ in publishers:
            sent.update(counts.get(timeout=seconds + STARTS_S))
        threading.Event().wait(ARRIVE_S)
        if not killed:
            recorder.terminate()
        run.sentence = recorder.communicate()[0].strip()
        CONSOLE.print(run.sentence)
    finally:
        for publisher, _ in publishers:
            publisher.kill()
        for process in (recorder, router):
            process.kill()
            process.wait()
    _judge(run, path, sent, killed_ns)
    path.unlink()
    return run


def _watch(recorder: subprocess.Popen[str], seconds: float, killed: bool, run: Run) -> int | None:
    """Sample the recorder while messages come; kill it at two thirds of the time if it is to be."""
    process, begin_s, pause = psutil.Process(recorder.pid), monotonic_s(), threading.Event()
    before, sizes = process.cpu_times(), list[tuple[float, float]]()
    until_s = begin_s + seconds * (2 / 3 if killed else 1.0)
    while (now_s := monotonic_s()) < until_s:
        sizes.append((now_s - begin_s, process.memory_info().rss / 1e6))
        pause.wait(SAMPLE_S)
    after, took_s = process.cpu_times(), monotonic_s() - begin_s
    run.cpu = (after.user + after.system - before.user - before.system) / took_s
    thirds = [[size for at_s, size in sizes if n <= 3 * at_s / took_s < n + 1] for n in range(3)]
    run.most_mb, run.growth_mb = max(size for _, size in sizes), median(thirds[2] or [0.0]) - median(thirds[1] or [0.0])
    if not killed:
        return None
    recorder.send_signal(signal.SIGKILL)
    return now_ns()


def _judge(run: Run, path: Path, sent: Counter[str], killed_ns: int | None) -> None:
    held, last_ns = Counter[str](), 0
    for entry in read_recording(path):
        held[entry.key] += 1
        last_ns = entry.received_ns
    run.megabytes = path.stat().st_size / 1e6
    run.sent = sum(sent.values())
    told = completeness(path)
    if killed_ns is not None:
        run.unheard_s, run.stated, run.sentence = 1e-9 * (killed_ns - last_ns), None, told.sentence
        run.lost = sum(told.lost.values())
        return
    run.lost_by_key = {key: count - held[key] for key, count in sent.items() if count != held[key]}
    run.lost, run.stated = sum(run.lost_by_key.values()), sum(told.lost.values())


def _row(run: Run) -> dict[str, object]:
    """A load against its goals; of what was killed nobody counted what came in the last moments."""
    killed = run.unheard_s is not None
    return {
        "load": run.name,
        "sent": run.sent,
        "lost": None if killed else run.lost,
        "goal": None if killed else 0,
        "file MB": f"{run.megabytes:.0f}",
        "share of a core": f"{run.cpu:.2f}",
        "cpu goal": CPU_GOAL if run.name.startswith("JPEG") else None,
        "most MB": f"{run.most_mb:.0f}",
        "grew MB": f"{run.growth_mb:+.1f}",
        "growth goal": f"{GROWTH_GOAL_MB:.0f}",
    }


if __name__ == "__main__":
    main()
