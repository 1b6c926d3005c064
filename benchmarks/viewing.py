"""What viewing costs: how soon a long recording shows its first picture, and what a viewer costs a running rig.

    python -m benchmarks.viewing --recording sessions/.../session.mcap [--minutes 10] [--rounds 3] [--seconds 8]

The recording is repeated, with its times moved on, until it is long enough. `suturegrasp view` is timed from the start
of its process: to its first picture and to its end, into a file, and, where there is a software Vulkan driver, into a
window without a screen until that has a frame. Then the rig of the demo runs, and by turns there is no viewer, one that
writes a file, and one that is frozen (SIGSTOP): latencies are read from the rig's own recording.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import tyro
from rerun.experimental import ViewerClient
from rich.console import Console
from rich.table import Table

from agents.cli.demo.command import demo_rig
from agents.cli.live.options import Demo
from agents.cli.live.up import start_all, write_config
from agents.launch.session_folder import new_session_folder
from agents.launch.supervisor import Supervisor, supervised
from agents.viewer.showing import OWN_TIMES
from benchmarks.latency import STAGES
from schemas.codec import decode, encode
from schemas.topics import Topic, topic_of
from shared.clock import monotonic_s, now_ns
from shared.recording.mcap_file import Entry, RecordingWriter, read_recording

MODES = ("absent", "live", "frozen")
VULKAN = Path("/usr/share/vulkan/icd.d")
FIRST_PICTURE = "the first picture came"
WINDOW = "a viewer's window is open and fills: "
IN_A_HEADLESS_WINDOW = (
    "from agents.viewer import sinks; sinks.WINDOW_OPTIONS = ('--headless',); from agents.cli.main import main; main()"
)
LONGEST_S = 1800.0


@dataclass(frozen=True)
class Options:
    """What is measured, and for how long.

    Fields:
        recording: of a session; without one, nothing is measured of recordings.
        rounds: of the three modes, each for that many seconds; 0 leaves them out.
        settle: seconds after every change of mode, and at first, that are left out.
    """

    recording: Path | None = None
    minutes: float = 10.0
    rounds: int = 3
    seconds: float = 8.0
    settle: float = 4.0
    start: float = 12.0
    json: Path | None = None


def main() -> None:
    """Measure, print tables, and write JSON where asked to."""
    options = tyro.cli(Options)
    measured: dict[str, Any] = {"cores": os.cpu_count(), "load before": os.getloadavg()[0]}
    console = Console(width=120)
    with tempfile.TemporaryDirectory() as scratch:
        if options.recording is not None:
            measured["recording"] = of_recordings(options.recording, options.minutes, Path(scratch))
            _print(console, f"a recording of {options.minutes:g} minutes, in seconds", measured["recording"])
        if options.rounds:
            measured["rig"] = of_rig(options, Path(scratch))
            title = f"ms from capture until published: median of {options.rounds} rounds (least to most)"
            _print(console, title, measured["rig"])
    console.print(f"{measured['cores']} cores, load {measured['load before']:.1f} before")
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(measured, indent=1) + "\n")


def of_recordings(recording: Path, minutes: float, scratch: Path) -> dict[str, dict[str, str]]:
    """Seconds of `suturegrasp view` on the lengthened recording."""
    long = scratch / "long.mcap"
    lengthen(recording, long, 60.0 * minutes)
    found: dict[str, dict[str, str]] = {}
    if sorted(VULKAN.glob("lvp_icd*.json")):
        found["into a window"] = time_view([sys.executable, "-c", IN_A_HEADLESS_WINDOW], [long])
    into_file = time_view([sys.executable, "-m", "agents.cli"], [long, "--output", scratch / "long.rrd"])
    sizes = {f"{path.suffix[1:]} MB": f"{1e-6 * path.stat().st_size:.0f}" for path in (long, scratch / "long.rrd")}
    found["into a file"] = into_file | sizes
    (scratch / "long.rrd").unlink()
    long.unlink()
    return found


def lengthen(recording: Path, longer: Path, seconds: float) -> None:
    """Write a recording again and again, each time moved on by its length, until it is that long."""
    entries = list(read_recording(recording))
    begin_ns = min(entry.received_ns for entry in entries)
    period_ns = max(entry.received_ns for entry in entries) - begin_ns + 1
    frames = 1 + max(entry.sequence for entry in entries)
    writer = RecordingWriter(longer)
    for turn in range(round(1e9 * seconds / period_ns)):
        for entry in entries:
            writer.write(topic_of(entry.key), moved(entry, turn * period_ns, turn * frames))
    writer.close()


def moved(entry: Entry, by_ns: int, by_frames: int) -> Entry:
    """An entry at a later time, with all times and numbers of frames in it."""
    message = decode(topic_of(entry.key).message, entry.payload)
    changes: dict[str, Any] = {name: getattr(message, name) + by_ns for name in OWN_TIMES if hasattr(message, name)}
    if hasattr(message, "stamp"):
        stamp = message.stamp
        changes["stamp"] = replace(
            stamp,
            sequence=stamp.sequence + by_frames,
            capture_left_ns=stamp.capture_left_ns + by_ns,
            capture_right_ns=stamp.capture_right_ns + by_ns,
        )
    return replace(
        entry,
        payload=encode(replace(message, **changes)) if changes else entry.payload,
        sequence=entry.sequence + by_frames,
        published_ns=entry.published_ns + by_ns,
        received_ns=entry.received_ns + by_ns,
    )


def time_view(command: list[str], arguments: list[Any]) -> dict[str, str]:
    """Seconds from the start of a `view` command to what it does, and what it took."""
    vulkan = {"DISPLAY": ":0", "VK_ICD_FILENAMES": str(next(iter(sorted(VULKAN.glob("lvp_icd*.json"))), ""))}
    began_s = monotonic_s()
    with subprocess.Popen(
        [*command, "view", *map(str, arguments)], stdout=subprocess.PIPE, text=True, env=os.environ | vulkan
    ) as process:
        viewers, seconds, last = [], dict[str, str](), ""
        for line in process.stdout or ():
            after = f"{monotonic_s() - began_s:.1f}"
            if line.startswith(WINDOW):
                seconds["window is open"] = after
                viewers = psutil.Process(process.pid).children(recursive=True)
                seconds["window has a picture"] = f"{_window_has_picture(line.removeprefix(WINDOW), began_s):.1f}"
                process.send_signal(signal.SIGINT)
            elif line.startswith(FIRST_PICTURE):
                seconds["first picture logged"] = after
            last = line
        process.wait(LONGEST_S)
        if not viewers:
            seconds["all of it"] = f"{monotonic_s() - began_s:.1f}"
        print(last.strip())
    for viewer in viewers:
        viewer.kill()
    return seconds


def _window_has_picture(address: str, began_s: float) -> float:
    """Seconds until the window shows a frame of the recording."""
    while monotonic_s() - began_s < LONGEST_S:
        try:
            state = ViewerClient.connect(address.strip()).get_state()
        except Exception:
            _wait(0.1)
            continue
        if any(t.name == "frame" and t.end is not None for recording in state.recordings for t in recording.timelines):
            return monotonic_s() - began_s
        _wait(0.1)
    return float("nan")


def of_rig(options: Options, scratch: Path) -> dict[str, dict[str, str]]:
    """Latencies of each stage with every mode of viewer, by turns, while one rig runs."""
    rig = demo_rig(Demo()).model_copy(update={"viewer": None})
    folder = new_session_folder(scratch)
    config = folder.path / "rig.json"
    write_config(config, rig)
    windows: list[tuple[str, int, int, int]] = []
    with supervised(restart=False) as supervisor:
        start_all(supervisor, rig, config, folder, "file")
        _wait(options.start)
        for turn in range(options.rounds):
            # each mode comes first in some round
            for mode in (*MODES[turn % 3 :], *MODES[: turn % 3]):
                viewer = _viewer(mode, config, folder.path, options.settle)
                begin_ns = now_ns()
                _wait(options.seconds)
                windows.append((mode, turn, begin_ns, now_ns()))
                _end(viewer)
                _check(supervisor)
    return _latencies(folder.recording, windows)


def _viewer(mode: str, config: Path, folder: Path, settle_s: float) -> subprocess.Popen[bytes] | None:
    """A viewer in that mode, after it has settled."""
    viewer = None
    if mode != "absent":
        command = [sys.executable, "-m", "agents.cli", "view", "--config", str(config), "--show", "file", "--numbered"]
        log = (folder / "viewer.log").open("a")
        viewer = subprocess.Popen([*command, "--output", str(folder / "seen.rrd")], stdout=log, stderr=log)
    _wait(settle_s)
    if viewer is not None and mode == "frozen":
        viewer.send_signal(signal.SIGSTOP)
        _wait(1.0)
    return viewer


def _end(viewer: subprocess.Popen[bytes] | None) -> None:
    if viewer is not None:
        viewer.kill()
        viewer.wait()


def _wait(seconds: float) -> None:
    threading.Event().wait(seconds)


def _check(supervisor: Supervisor) -> None:
    for change in supervisor.watch():
        raise SystemExit(f"nothing was measured: {change.sentence}")


def _latencies(recording: Path, windows: list[tuple[str, int, int, int]]) -> dict[str, dict[str, str]]:
    """For each mode and stage the median of the rounds' medians, with the least and the most of them."""
    ms: defaultdict[tuple[str, int, Topic], list[float]] = defaultdict(list)
    for entry in read_recording(recording):
        topic = topic_of(entry.key)
        if topic not in STAGES:
            continue
        for mode, turn, begin_ns, end_ns in windows:
            if begin_ns <= entry.published_ns < end_ns:
                stamp = decode(topic.message, entry.payload).stamp
                ms[mode, turn, topic].append(1e-6 * (entry.published_ns - stamp.capture_left_ns))
    found: dict[str, dict[str, str]] = {}
    for mode in MODES:
        found[mode] = {}
        for topic in STAGES:
            rounds = [values for (m, _, t), values in ms.items() if (m, t) == (mode, topic)]
            medians = [float(np.median(values)) for values in rounds] or [float("nan")]
            count = sum(map(len, rounds))
            found[mode][str(topic)] = (
                f"{np.median(medians):.1f} ({min(medians):.1f} to {max(medians):.1f}), n = {count}"
            )
    return found


def _print(console: Console, title: str, rows: dict[str, dict[str, str]]) -> None:
    columns = list(dict.fromkeys(column for row in rows.values() for column in row))
    table = Table("", *columns, title=title, title_justify="left")
    for name, row in rows.items():
        table.add_row(name, *(row.get(column, "-") for column in columns))
    console.print(table)


if __name__ == "__main__":
    main()
