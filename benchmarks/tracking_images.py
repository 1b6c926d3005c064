"""From images of a moving thread to its curve: perception and reconstruction, each with what the other said last.

    .venv/bin/python -m benchmarks.tracking_images --seeds 40 44

Draws sequences of a thread on tissue (tests/rigs/sequences.py: still, slow, fast, a tool passes, laid elsewhere, out of
sight), feeds both agents with the raw images in one process, and prints for each kind of motion the error of the curve,
how often it was wrong though ok, in how many frames the thread was followed or looked for, and the processor's time.
`--late 2` has threads come two frames late, and `--every 2` leaves every second frame out, as a slow machine does.
"""

import argparse
import json
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from agents.camera.scene_source import calibration_of
from agents.perception.agent import Perception
from agents.reconstruction.agent import Reconstruction
from benchmarks.tracking import on_curve
from schemas.messages import ImageEncoding, Status, StereoFrame, ThreadObservations, ThreadReconstruction, TrackStep
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, THREAD, Topic
from shared.clock import processor_s
from shared.images import encode_image
from shared.runtime.agent import Agent, Received, outputs_in
from tests.rigs.sequences import CAMERA, KINDS, Kind, images_of, stamp_of

CONFIGS = "medium", "hard", "crossing"
FRAMES_EACH, WRONG_MM = 40, 1.0


@dataclass(frozen=True)
class Row:
    """One frame: error of the curve in mm, None where it failed; what perception did; processor's milliseconds."""

    motion: str
    thread: str
    number: int
    error_mm: float | None
    how: str
    restarted: bool
    perception_ms: float
    reconstruction_ms: float


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs=2, default=(40, 44), help="first, and one past the last")
    parser.add_argument("--frames", type=int, default=FRAMES_EACH, help="of each sequence")
    parser.add_argument("--late", type=int, default=1, help="frames after which a thread reaches perception")
    parser.add_argument("--every", type=int, default=1, help="one frame in so many is seen")
    parser.add_argument("--json", type=Path, default=Path("out/tracking_images.json"), help="where the figures go")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    rows: list[Row] = []
    for kind in KINDS:
        for seed in range(*arguments.seeds):
            config = CONFIGS[seed % len(CONFIGS)]
            rows += rows_of(kind, config, seed, arguments.frames, arguments.late, arguments.every)
    print_table(rows)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


def rows_of(kind: Kind, config: str, seed: int, frames: int, late: int, every: int) -> list[Row]:
    """The frames of one sequence."""
    perception, reconstruction = Perception(), Reconstruction()
    _fed(perception, CALIBRATION, calibration_of(CAMERA))
    threads: list[ThreadReconstruction] = []
    rows: list[Row] = []
    for number, drawn in enumerate(images_of(config, seed, kind, frames, background="tissue")):
        if number % every:
            continue
        if len(threads) >= late:
            _fed(perception, THREAD, threads[-late])
        left, right = (encode_image(image, ImageEncoding.RAW) for image in drawn.images)
        before_s = processor_s()
        seen = _fed(perception, FRAMES, StereoFrame(stamp_of(number), left, right))[OBSERVATIONS]
        seen_s = processor_s()
        thread = _fed(reconstruction, OBSERVATIONS, seen)[THREAD]
        threads.append(thread)
        ok = thread.status is Status.OK
        rows.append(
            Row(
                kind.name,
                f"{config} {seed}",
                number,
                float(on_curve(thread, drawn.truth)[1].mean()) if ok else None,
                _how(seen, number),
                thread.track is not None and thread.track.step is TrackStep.RESTARTED,
                1e3 * (seen_s - before_s),
                1e3 * (processor_s() - seen_s),
            )
        )
    return rows


def _fed(agent: Agent, topic: Topic, message: object) -> dict[Topic, Any]:
    """What an agent says to a message, by topic."""
    return {out.topic: out.message for out in outputs_in(agent.step(Received(topic, str(topic), 1, message)))}


def _how(seen: ThreadObservations, number: int) -> str:
    if seen.looked_sequence == number:
        return "looked"
    return "near" if seen.segmented_sequence in (None, number) else "followed"


def print_table(rows: list[Row]) -> None:
    """A line for each kind of motion."""
    table = Table(title="from raw images; errors in mm, times of the processor", title_justify="left")
    for column in ("motion", "frames", "ok", "median", "95 %", "worst", f"wrong though ok (> {WRONG_MM:g} mm)"):
        table.add_column(column, justify="left" if column == "motion" else "right")
    for column in ("followed", "near", "looked", "restarted", "perception ms", "reconstruction ms"):
        table.add_column(column, justify="right")
    of_kind: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        of_kind[row.motion].append(row)
    for motion, some in of_kind.items():
        errors = np.array([row.error_mm for row in some if row.error_mm is not None])
        how = [row.how for row in some]
        told = f"{np.median(errors):.3f}", f"{np.percentile(errors, 95):.3f}", f"{errors.max():.3f}"
        counts = (str(how.count(name)) for name in ("followed", "near", "looked"))
        ms = (f"{np.mean([getattr(row, name) for row in some]):.0f}" for name in ("perception_ms", "reconstruction_ms"))
        wrong = str(int((errors > WRONG_MM).sum()))
        restarted = str(sum(row.restarted for row in some))
        table.add_row(motion, str(len(some)), str(len(errors)), *told, wrong, *counts, restarted, *ms)
    Console(width=170).print(table)


if __name__ == "__main__":
    main()
