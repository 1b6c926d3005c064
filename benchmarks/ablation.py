"""What each step of method `refined` buys: the same scenes with one step left out at a time.

    .venv/bin/python -m benchmarks.ablation --data ../shared/data

Published synthetic scenes without masks, renders with true masks. A step is left out by setting the constant that
governs it to where it does nothing.
"""

import argparse
import statistics
from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np
from jaxtyping import Float64
from rich.console import Console
from rich.table import Table

from agents.cli.reconstruct.pipeline import reconstruct_pair
from agents.reconstruction.methods import METHODS
from agents.reconstruction.refined import (
    alignment,
    constraints,
    method,
    normal_equations,
    refinement,
    rows,
    sightings,
    smoothing,
)
from benchmarks.measures import sampled
from benchmarks.scenes import CLEAR, CROSSING, OCCLUSION, SIM, scenes
from schemas.messages import Status, ThreadObservations
from shared.curve_distance import curve_distance

Change = tuple[ModuleType, str, Any]
Observed = tuple[str, ThreadObservations, Float64[np.ndarray, "m 3"]]

STEPS: dict[str, tuple[Change, ...]] = {
    "all of it": (),
    "first curve alone: no refinement against both images": ((refinement, "STEPS", 0),),
    "one round of refinement": ((refinement, "STEPS", 1),),
    "no common ends": ((alignment, "piece_ends", lambda _: np.zeros(0, np.int64)),),
    "no robust weights": ((refinement, "ROBUST", 1e6),),
    "one smoothing for the whole thread": ((smoothing, "LEAST_WEIGHT", 1.0), (smoothing, "MOST_WEIGHT", 1.0)),
    "smoothing fixed, not chosen": (
        (refinement, "COARSE", np.array([1e4])),
        (refinement, "FINE", np.array([1.0])),
        (smoothing, "LEAST_WEIGHT", 1.0),
        (smoothing, "MOST_WEIGHT", 1.0),
    ),
    "no bending in the roughness": ((normal_equations, "BENDING", 0.0),),
    "folds stay": ((sightings, "FOLD_FACTOR", 1e9),),
    "no region holds the curve": ((constraints, "SLACK_PRICE", 1e-6),),
    "rows taken as they are": ((rows, "LEAST_ROW_OFFSET_PX", 1e9), (method, "MOST_ROW_ROUNDS", 0)),
}


def main() -> None:
    """Run the ablation from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of scenes")
    arguments = parser.parse_args()
    observed = list(observations(arguments.data))
    table = Table(title="mean curve error, median / worst; failures", title_justify="left")
    for column in ("left out", *dict.fromkeys(group for group, _, _ in observed)):
        table.add_column(column)
    for name, changes in STEPS.items():
        with changed(changes):
            table.add_row(name, *columns(observed))
    Console(width=180).print(table)


def observations(data: Path) -> Iterator[Observed]:
    """Kind of scene, what perception saw, and the true curve."""
    for _, group, load in scenes(data):
        if group not in (SIM, CLEAR, CROSSING, OCCLUSION):
            continue
        scene = load()
        masks = None if group == SIM else scene.masks
        result = reconstruct_pair(scene.images, scene.calibration, masks=masks, segmenter=None, method=method.METHOD)
        if scene.truth is not None:
            yield f"{group}, masks {'none' if masks is None else 'true'}", result.observations, scene.truth


def columns(observed: list[Observed]) -> list[str]:
    """Median and worst error of each kind of scene, and how many failed."""
    cells: list[str] = []
    for group in dict.fromkeys(each for each, _, _ in observed):
        errors: list[float] = []
        failed = 0
        for kind, seen, truth in observed:
            if kind != group:
                continue
            thread = METHODS[method.METHOD](seen)
            if thread.status is Status.OK:
                errors.append(curve_distance(sampled(thread), truth).mean)
            failed += thread.status is not Status.OK
        cells.append(f"{statistics.median(errors):.3f} / {max(errors):.3f}; {failed}")
    return cells


@contextmanager
def changed(changes: tuple[Change, ...]) -> Generator[None]:
    """Constants set for a while."""
    with ExitStack() as stack:
        for module, name, value in changes:
            stack.enter_context(patch.object(module, name, value))
        yield


if __name__ == "__main__":
    main()
