"""What each rule of perception changes on scenes that validate, left out one at a time, with a paired bootstrap.

    .venv/bin/python -m benchmarks.rules --lab DIR... --renders ../shared/data DIR2... --thread-free DIR3...

Each row leaves one rule out. It says by how much the mean over scenes changes, with the interval in which 95 % of the
means of redrawn scenes lie: lab scenes (benchmarks/lab.py) that are right, and wrong though ok, of a hundred; of
renders the thread that is found, what of the found is thread, and the error of visible parts; false curves of a hundred
thread-free frames. A rule whose intervals all hold 0 is not shown to help.
"""

from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np
import tyro
from jaxtyping import Float64
from rich.progress import track

from agents.perception import observe
from agents.perception.candidates import candidates
from agents.perception.centrelines import centrelines, glints
from agents.perception.segmentation import network
from agents.perception.segmenter_names import NETWORK
from agents.reconstruction.refined import method
from benchmarks import lab
from benchmarks.curve_verdicts import RIGHT, WRONG
from benchmarks.perception import precision, recall, row_of
from benchmarks.scenes import SHOWN_RENDERS, reconstructed, rendered, scenes
from benchmarks.tables import print_rows
from benchmarks.thread_free import thread_free
from schemas.messages import Status

Change = tuple[ModuleType, str, Any]


def _first(given: Any, *_: Any) -> Any:
    return given


WITHOUT_METAL = 0.87, 0.0, 0.72, -0.21
"""`network.WEIGHTS` as `benchmarks.training.line_odds` fits them without that."""
RULES: dict[str, tuple[Change, ...]] = {
    "faint stretches of lines": ((network, "FAINTEST", 102),),
    "what speaks against metal": ((network, "WEIGHTS", WITHOUT_METAL),),
    "threads that are certainly others": ((candidates, "certainly_others", lambda *_: []),),
    "what both eyes' middles err apart": ((observe, "drawn_together", lambda _, lines, **__: lines),),
    "glints filled": ((centrelines, "without_glints", lambda mask: (mask, glints.depth_of(mask))),),
    "ends sought in the image": ((centrelines, "to_tips", _first),),
    "middles learned": ((centrelines, "by_learning", lambda *_: None),),
    "ends that are covered": ((method, "with_covered_ends", _first),),
    "curves that are mostly guessed": ((method, "MOST_GUESSED", 1.0),),
    "curves for which little speaks": ((method, "LEAST_SCORE", 0.0),),
}


@dataclass(frozen=True)
class Options:
    """What is judged."""

    lab: list[Path] = field(default_factory=list)
    """Folders of scenes of a lab, with NAME.json each."""
    renders: list[Path] = field(default_factory=list)
    """Folders that hold renders of tissue in their folder `renders`, such as ../shared/data."""
    thread_free: list[Path] = field(default_factory=list)
    """Folders of path-traced scenes without thread, looked at as benchmarks/thread_free.py does."""
    frames: int = 60
    """Thread-free ones."""
    only: str = ""
    """Rules whose name contains this."""
    draws: int = 10_000
    """Of the scenes, for the intervals."""


def main() -> None:
    """Leave out and print."""
    options = tyro.cli(Options, description=__doc__)
    if not (options.lab or options.renders or options.thread_free):
        raise SystemExit("name folders by --lab, --renders or --thread-free; suturegrasp scenes render makes some")
    whole = judged(options, "nothing", ())
    columns = {name: f"{name} ({len(values)})" for name, values in whole.items() if len(values)}
    means = {column: f"{np.nanmean(whole[name]):.3f}" for name, column in columns.items()}
    rows = [{"left out": "nothing: the means"} | means]
    for rule, changes in RULES.items():
        if options.only in rule:
            without = judged(options, rule, changes)
            changed = {c: interval(without[name] - whole[name], options.draws) for name, c in columns.items()}
            rows.append({"left out": rule} | changed)
    print_rows("changes of means", rows)


def judged(options: Options, name: str, changes: tuple[Change, ...]) -> dict[str, Float64[np.ndarray, "n"]]:
    """What each scene comes to while something is changed, by column; NaN where it says nothing."""
    for module, attribute, value in changes:
        patch.object(module, attribute, value).start()
    try:
        return _of_lab(options, name) | _of_renders(options, name) | _of_thread_free(options, name)
    finally:
        patch.stopall()


def _of_lab(options: Options, name: str) -> dict[str, Float64[np.ndarray, "n"]]:
    paths = sorted(path for folder in options.lab for path in folder.glob("*.json"))
    given = (rendered(path) for path in track(paths, name, transient=True))
    verdicts = [lab.judged(scene, reconstructed(scene))["verdict"] for scene in given]
    return {kind: np.array([100.0 * (verdict == kind) for verdict in verdicts]) for kind in (RIGHT, WRONG)}


def _of_renders(options: Options, name: str) -> dict[str, Float64[np.ndarray, "n"]]:
    loads = [load for folder in options.renders for _, group, load in scenes(folder) if group in SHOWN_RENDERS]
    rows = [row_of(load(), NETWORK) for load in track(loads, name, transient=True)]
    error = [np.nan if row.get("mean seen") is None else row["mean seen"] for row in rows]
    return {
        "recall %": np.array([100 * recall(row) for row in rows]),
        "precision %": np.array([100 * precision(row) if row["given"] else np.nan for row in rows]),
        "error, mm": np.array(error, np.float64),
    }


def _of_thread_free(options: Options, name: str) -> dict[str, Float64[np.ndarray, "n"]]:
    if not options.thread_free:
        return {"false curves": np.zeros(0)}
    frames = track(thread_free(options.frames, 0, options.thread_free), name, options.frames, transient=True)
    ok = [reconstructed(scene).reconstruction.status is Status.OK for scene in frames]
    return {"false curves": 100.0 * np.array(ok, np.float64)}


def interval(changes: Float64[np.ndarray, "n"], draws: int) -> str:
    """The mean of paired changes, and where 95 % of the means of redrawn ones lie."""
    changes, rng = changes[np.isfinite(changes)], np.random.default_rng(1)
    if not changes.any():
        return "0"
    means = changes[rng.integers(len(changes), size=(draws, len(changes)))].mean(axis=1)
    low, high = np.percentile(means, (2.5, 97.5))
    return f"{changes.mean():+.3f} ({low:+.3f} to {high:+.3f})"


if __name__ == "__main__":
    main()
