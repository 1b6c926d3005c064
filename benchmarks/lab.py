"""What is made of path-traced scenes of a lab, by their truth: which curves are right, and which wrong though ok.

    suturegrasp scenes render --config easy medium needle rod several --background pad phantom --with meshes \\
        --meshes ../shared/data/instruments --count 2 --seed 100 --samples 40 --output DIR
    .venv/bin/python -m benchmarks.lab --scenes DIR [--pictures out/lab]

Right: in both eyes at least 90 % of the curve lies within 14 px (of 1280) of one true thread, and at least 70 % of what
both eyes see of that thread is followed, as for the pads (benchmarks/real_images.py). Wrong though ok: whatever else is
ok.
"""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from rich.progress import track

from agents.cli.reconstruct.pipeline import PipelineResult
from benchmarks.curve_verdicts import REFUSED, curve_of, projected, verdict
from benchmarks.pictures import MAGENTA, dotted, save
from benchmarks.scenes import Scene, reconstructed, rendered
from benchmarks.tables import CONSOLE, Row, print_rows, write_json
from schemas.messages import Status


@dataclass(frozen=True)
class Options:
    """What is judged."""

    scenes: Path
    """Folder of rendered scenes, with NAME.json each."""
    segmenter: str | None = None
    """Default: what suits each picture."""
    json: Path | None = None
    """Write everything there."""
    pictures: Path | None = None
    """Write pictures of the curves over the left images into this folder."""


def main() -> None:
    """Judge and print."""
    options = tyro.cli(Options, description=__doc__)
    paths = sorted(options.scenes.glob("*.json"))
    if not paths:
        raise SystemExit(f"{options.scenes} holds no NAME.json; render scenes into it with suturegrasp scenes render")
    rows: list[Row] = []
    for path in track(paths, "scenes", transient=True):
        scene = rendered(path)
        result = reconstructed(scene, segmenter=options.segmenter)
        rows.append(judged(scene, result))
        if options.pictures is not None:
            thread = result.reconstruction
            curve = curve_of(thread, scene.calibration)[0] if thread.status is Status.OK else np.zeros((0, 2))
            save(options.pictures / f"{scene.name}.jpg", dotted(scene.images[0], (curve, MAGENTA)))
    print_rows("scenes of a lab", rows)
    CONSOLE.print(dict(Counter(row["verdict"] for row in rows)))
    write_json(options.json, rows)


def judged(scene: Scene, result: PipelineResult) -> Row:
    """One scene; a row of a table."""
    thread = result.reconstruction
    row: Row = {"scene": scene.name, "status": thread.status.name.lower()}
    if thread.status is not Status.OK:
        told = REFUSED if scene.threads else "none there"
        return row | {"on thread %": None, "followed %": None, "verdict": told, "why": thread.reason[:90]}
    threads = [
        (projected(true.points, scene.calibration), projected(true.points[true.visible.all(axis=1)], scene.calibration))
        for true in scene.threads
    ]
    width = scene.images[0].shape[1]
    return row | verdict(curve_of(thread, scene.calibration), threads, width) | {"why": ""}


if __name__ == "__main__":
    main()
