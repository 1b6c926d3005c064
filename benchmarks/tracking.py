"""What following the thread from frame to frame buys: error, steadiness of s, restarts and time, beside single frames.

    .venv/bin/python -m benchmarks.tracking

Renders sequences of a moving thread (tests/rigs/sequences.py), reconstructs each frame alone and as the live agent
would with tracking, prints a table and writes JSON. Times are those of one core, from observations to the curve, the
least of some runs of each frame: by the clock on the wall, and as time of the processor, which grows less where others
use the machine too.
"""

import argparse
import json
import statistics
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64
from rich.console import Console
from rich.table import Table

from agents.reconstruction.methods import METHODS, TRACKERS
from agents.reconstruction.refined.method import METHOD
from schemas.messages import Status, ThreadReconstruction, TrackStep
from shared.arc_length import even_parameters
from shared.clock import Stopwatch, processor_s
from shared.splines import evaluate
from tests.rigs.sequences import KINDS, Frame, Kind, sequence

THREADS = (("medium", 3), ("hard", 2), ("crossing", 4))
FRAMES, REPEATS = 45, 2
OUTER = 20
"""Material points at each end that do not count for the steadiness of s: a curve that ends early has no place there."""
CURVE_SAMPLES = 601
Row = dict[str, Any]


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=FRAMES, help="of each sequence")
    parser.add_argument("--only", default="", help="run only sequences whose name contains this")
    parser.add_argument("--binary", action="store_true", help="masks that only say yes or no")
    parser.add_argument("--json", type=Path, default=Path("out/tracking.json"), help="where the figures go")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    rows: list[Row] = []
    for kind in KINDS:
        for config, seed in THREADS:
            if arguments.only in f"{kind.name} {config}":
                rows.append(
                    row_of(kind, config, list(sequence(config, seed, kind, arguments.frames, arguments.binary)))
                )
    if not rows:
        parser.error(f"no sequence has a name that contains {arguments.only!r}")
    print_table(rows)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


def row_of(kind: Kind, config: str, frames: list[Frame]) -> Row:
    """The figures of one sequence, alone and tracked."""
    alone, tracked = METHODS[METHOD], TRACKERS[METHOD]
    return {
        "motion": kind.name,
        "thread": config,
        "alone": figures(frames, lambda frame, _: alone(frame.observations)),
        "tracked": figures(frames, lambda frame, last: tracked(frame.observations, last)),
    }


def figures(frames: list[Frame], step: Callable[[Frame, ThreadReconstruction | None], ThreadReconstruction]) -> Row:
    """Errors in mm, the deviation of s from frame to frame in mm along the thread, failures, restarts, and times."""
    errors: list[float] = []
    places: list[np.ndarray] = []
    ms: list[float] = []
    cpu_ms: list[float] = []
    steps: Counter[str] = Counter()
    last: ThreadReconstruction | None = None
    for frame in frames:
        times: list[float] = []
        cpu_times: list[float] = []
        thread = last
        for _ in range(REPEATS):
            watch, before_s = Stopwatch("curve"), processor_s()
            with watch.step("curve"):
                thread = step(frame, last)
            cpu_times.append(1e3 * (processor_s() - before_s))
            times.append(watch.ms["curve"])
        assert thread is not None
        last = thread
        ms.append(min(times))
        cpu_ms.append(min(cpu_times))
        steps[thread.track.step.name if thread.track else ""] += 1
        if thread.status is Status.OK:
            place, distance = on_curve(thread, frame.truth)
            errors.append(float(distance.mean()))
            places.append(place[OUTER:-OUTER])
    length = float(np.linalg.norm(np.diff(frames[0].truth, axis=0), axis=1).sum())
    return {
        "ms": statistics.median(ms),
        "cpu ms": statistics.median(cpu_ms),
        "error": statistics.median(errors),
        "worst error": max(errors),
        "s": length * float(np.std(places, axis=0).mean()),
        "worst s": length * float(np.abs(places - np.median(places, axis=0)).mean(axis=1).max()),
        "failed": len(frames) - len(errors),
        "restarted": steps[TrackStep.RESTARTED.name],
    }


def on_curve(
    thread: ThreadReconstruction, truth: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """Which place of the thread each true point is, on the scale of the first curve, and how far from the curve."""
    knots, control_points = thread.knots, thread.control_points_camera
    points = evaluate(knots, control_points, 3, even_parameters(knots, control_points, 3, CURVE_SAMPLES))
    chord = np.diff(points, axis=0)
    off = truth[:, None] - points[None, :-1]
    t = np.clip(np.einsum("nka,ka->nk", off, chord) / np.maximum((chord**2).sum(axis=1), 1e-18), 0.0, 1.0)
    distance = np.linalg.norm(off - t[..., None] * chord, axis=2)
    nearest = distance.argmin(axis=1)
    every = np.arange(len(truth))
    s = (nearest + t[every, nearest]) / (CURVE_SAMPLES - 1)
    first, last = thread.track.material_s if thread.track else (0.0, 1.0)
    return first + (last - first) * s, distance[every, nearest]


def print_table(rows: list[Row]) -> None:
    """A row for each sequence, and the median time of all."""
    table = Table(title=f"Sequences of {METHOD}: alone → tracked; lengths in mm", title_justify="left")
    for column in ("motion", "thread", "error", "worst", "s", "worst s", "failed", "restarted", "ms", "CPU ms"):
        table.add_column(column, justify="left" if column in ("motion", "thread") else "right", no_wrap=True)
    for row in rows:
        a, b = row["alone"], row["tracked"]
        pairs = [f"{a[key]:.3f} → {b[key]:.3f}" for key in ("error", "worst error", "s", "worst s")]
        counts = [f"{a['failed']} → {b['failed']}", str(b["restarted"])]
        times = [f"{a[key]:.1f} → {b[key]:.1f}" for key in ("ms", "cpu ms")]
        table.add_row(row["motion"], row["thread"], *pairs, *counts, *times)
    console = Console(width=160)
    console.print(table)
    for key, clock in (("ms", "of the clock"), ("cpu ms", "of the processor")):
        alone, tracked = (statistics.median(row[way][key] for row in rows) for way in ("alone", "tracked"))
        console.print(
            f"observations to curve, median of sequences: {alone:.1f} ms {clock} alone, {tracked:.1f} ms tracked"
        )


if __name__ == "__main__":
    main()
