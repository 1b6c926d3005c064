"""What each rule of perception changes in scenes of a lab, left out one at a time, with a paired bootstrap over scenes.

    .venv/bin/python -m benchmarks.rules --scenes DIR [--scenes DIR2]

Scenes are those of benchmarks/lab.py. Each row leaves one rule out and says how many more scenes of a hundred are
right, and wrong though ok, with the interval in which 95 % of the means of redrawn scenes lie. A rule whose intervals
hold 0 is not shown to help here.
"""

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np
import tyro
from jaxtyping import Float64
from rich.progress import track
from rich.table import Table

from agents.perception import observe, told_apart
from agents.perception.candidates import candidates
from agents.perception.segmentation import network
from agents.reconstruction.refined import method
from benchmarks import lab
from benchmarks.tables import CONSOLE

RIGHT, WRONG = "right", "wrong though ok"
Change = tuple[ModuleType, str, Any]


def _first(given: Any, *_: Any) -> Any:
    return given


def _second(_: Any, given: Any, *__: Any) -> Any:
    return given


RULES: dict[str, tuple[Change, ...]] = {
    "print": ((told_apart, "without_printed", _second),),
    "lines that one eye alone shows": ((told_apart, "seen_by_both", _first),),
    "threads that are certainly others": ((candidates, "certainly_others", lambda *_: []),),
    "ends that the other eye shows": (
        (observe, "ended_together", lambda _, left, right, *__: (left.centrelines, right.centrelines)),
    ),
    "what both eyes' middles err apart": ((observe, "drawn_together", lambda _, lines, **__: lines),),
    "fainter pieces of the thread's colour": ((network, "FAINT_MEAN", network.LEAST_MEAN),),
    "curves that are mostly guessed": ((method, "MOST_GUESSED", 1.0),),
}


@dataclass(frozen=True)
class Options:
    """What is judged."""

    scenes: list[Path]
    """Folders of rendered scenes, with NAME.json each."""
    draws: int = 10_000
    """Of the scenes, for the intervals."""


def main() -> None:
    """Leave out and print."""
    options = tyro.cli(Options)
    paths = sorted(path for folder in options.scenes for path in folder.glob("*.json"))
    if not paths:
        raise SystemExit("these folders hold no NAME.json; render scenes with suturegrasp scenes render")
    whole = verdicts(paths, "nothing", ())
    table = Table("left out", RIGHT, WRONG, "more right, per 100", "more wrong, per 100", title=f"{len(paths)} scenes")
    table.add_row("nothing", str(whole.count(RIGHT)), str(whole.count(WRONG)), "", "")
    for name, changes in RULES.items():
        without = verdicts(paths, name, changes)
        intervals = [interval(_more(without, whole, verdict), options.draws) for verdict in (RIGHT, WRONG)]
        table.add_row(name, str(without.count(RIGHT)), str(without.count(WRONG)), *intervals)
    CONSOLE.print(table)


def verdicts(paths: list[Path], name: str, changes: tuple[Change, ...]) -> list[str]:
    """Of each scene, while something is changed."""
    for module, attribute, value in changes:
        patch.object(module, attribute, value).start()
    try:
        return [lab.judged(path, lab.Options(path.parent))["verdict"] for path in track(paths, name, transient=True)]
    finally:
        patch.stopall()


def _more(without: list[str], whole: list[str], verdict: str) -> Float64[np.ndarray, "n"]:
    return np.array([100.0 * ((a == verdict) - (b == verdict)) for a, b in zip(without, whole, strict=True)])


def interval(changes: Float64[np.ndarray, "n"], draws: int) -> str:
    """The mean of paired changes, and where 95 % of the means of redrawn ones lie."""
    rng = np.random.default_rng(1)
    means = changes[rng.integers(len(changes), size=(draws, len(changes)))].mean(axis=1)
    low, high = np.percentile(means, (2.5, 97.5))
    return f"{changes.mean():+.1f} ({low:+.1f} to {high:+.1f})"


if __name__ == "__main__":
    main()
