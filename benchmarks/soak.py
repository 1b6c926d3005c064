"""Memory of every process of the simulated rig, left running: flat, or what grows, and how fast.

    python -m benchmarks.soak [--minutes 60] [--settle 3] [--rate-hz 2] [--json out/soak.json]

All processes of `suturegrasp play` run on a router of their own, recorder and viewer included, with few frames, and
nobody names a goal. What the system counts as a process's own resident memory is read every few seconds; what it maps
in common with others, such as images in shared memory, is left out, as every process would be charged with it. The
first minutes, while processes fill what they keep on purpose, are left out too.
"""

import os
import tempfile
import threading
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import psutil
import tyro

from agents.cli.live.up import start_all, write_config
from agents.configuration.rig import CameraSection, RigConfig, RouterSection, simulated_rig
from agents.launch.session_folder import new_session_folder
from agents.launch.supervisor import Supervisor, supervised
from benchmarks.tables import print_rows, write_json
from shared.clock import monotonic_s
from shared.runtime.session import free_local_endpoint

GOAL_PERCENT = 2.0
"""Of an hour."""
BLOCKS = 20
"""Medians that a line is fitted to: neighbouring samples say the same, and would make it look too sure."""
SURE = 2.0
"""Standard deviations."""
STARTS_S = 30.0
MB = 1e6
HOUR_S = 3600.0


@dataclass(frozen=True)
class Options:
    """How long, and how much there is to do meanwhile.

    Fields:
        settle: minutes that are left out at the beginning.
        every: seconds between samples.
    """

    minutes: float = 60.0
    settle: float = 3.0
    every: float = 5.0
    rate_hz: float = 2.0
    json: Path | None = None
    folder: Path | None = None
    """Where the session is written; a temporary one where none is given."""


@dataclass(frozen=True)
class Trend:
    """How the memory of a process went.

    Fields:
        first_mb, last_mb: medians of the first and the last tenth of the time.
        percent_per_hour, within: slope of a line, by its first tenth, and its standard deviation.
    """

    first_mb: float
    last_mb: float
    percent_per_hour: float
    within: float

    @property
    def judgement(self) -> str:
        """Whether it is flat within the goal, as far as this long a time can tell."""
        slope, unsure = abs(self.percent_per_hour), SURE * self.within
        if slope + unsure <= GOAL_PERCENT:
            return "flat"
        if slope - unsure > GOAL_PERCENT:
            return "grows" if self.percent_per_hour > 0 else "shrinks"
        return "not sure"


def main() -> None:
    """Run, print a table, and write JSON where asked to."""
    options = tyro.cli(Options, description=__doc__)
    endpoint = free_local_endpoint()
    sections = {"router": RouterSection(endpoint=endpoint), "camera": CameraSection(rate_hz=options.rate_hz)}
    with tempfile.TemporaryDirectory() as scratch:
        samples = soak(simulated_rig().model_copy(update=sections), options, options.folder or Path(scratch))
    trends = {name: trend(*np.transpose(of)) for name, of in samples.items()}
    told = {name: asdict(one) | {"flat?": one.judgement} for name, one in trends.items()}
    title = (
        f"{options.minutes:g} minutes after {options.settle:g}, camera at {options.rate_hz:g} Hz, load "
        f"{os.getloadavg()[0]:.1f} at the end; goal: within {GOAL_PERCENT:g} % an hour"
    )
    print_rows(title, [{"process": name} | row for name, row in told.items()])
    write_json(options.json, told)


def soak(rig: RigConfig, options: Options, sessions: Path) -> dict[str, list[tuple[float, float]]]:
    """Seconds and resident bytes by process, once all have settled.

    Raises:
        SystemExit: where a process ended meanwhile.
    """
    folder = new_session_folder(sessions)
    write_config(folder.path / "rig.json", rig)
    samples, turn = defaultdict[str, list[tuple[float, float]]](list), threading.Event()
    with supervised(restart=False) as supervisor:
        start_all(supervisor, rig, folder.path / "rig.json", folder, "file")
        turn.wait(STARTS_S + 60.0 * options.settle)
        end_s = monotonic_s() + 60.0 * options.minutes
        while monotonic_s() < end_s:
            for name, own in _resident(supervisor).items():
                samples[name].append((monotonic_s(), own))
            turn.wait(options.every)
    return dict(samples)


def _resident(supervisor: Supervisor) -> dict[str, float]:
    if changes := supervisor.watch():
        raise SystemExit(f"nothing was measured: {changes[0].sentence}")
    found: dict[str, float] = {}
    for child in supervisor.children:
        if child.process is not None:
            memory = psutil.Process(child.process.pid).memory_info()
            found[child.name] = float(memory.rss - memory.shared)
    return found


def trend(at_s: np.ndarray, resident: np.ndarray) -> Trend:
    """The trend in samples of memory: a line through medians of blocks of them.

    With less than a minute there is none, and its slope is not known at all.
    """
    tenth = max(1, len(resident) // 10)
    first, last = float(np.median(resident[:tenth])), float(np.median(resident[-tenth:]))
    blocks = [b for b in np.array_split(np.arange(len(at_s)), BLOCKS) if b.size]
    if len(blocks) < 3:
        return Trend(first / MB, last / MB, 0.0, float("inf"))
    hours = np.array([np.mean(at_s[b]) for b in blocks]) / HOUR_S
    percent = 100.0 * np.array([np.median(resident[b]) for b in blocks]) / first
    A = np.column_stack([hours - hours.mean(), np.ones_like(hours)])
    slope, level = np.linalg.lstsq(A, percent, rcond=None)[0]
    left = percent - A @ np.array([slope, level])
    within = np.sqrt(left @ left / (len(blocks) - 2) / (A[:, 0] @ A[:, 0]))
    return Trend(first / MB, last / MB, float(slope), float(within))


if __name__ == "__main__":
    main()
