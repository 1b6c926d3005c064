"""Perception on scenes that nobody has seen: seeds are drawn now, rendered, and judged once.

    .venv/bin/python -m benchmarks.sealed --output out/sealed --meshes ../shared/data/instruments [--seed N --small 8]

- crossings: threads that cross themselves over tissue.
- lab: needle drivers from their meshes, needles and rods over pads and phantoms.
- thread-free: drawn tissue, rendered fields, and path-traced scenes again and again in other light, mirrored and turned
  (benchmarks/thread_free.py), half of them with needle drivers over pads and phantoms.

Without --seed a seed is drawn and told; scenes that lie in the folder already are not rendered again. The table belongs
into the record whatever it says, and a set that was looked at is sealed no more.
"""

import secrets
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from rich.progress import track

from agents.perception.segmenter_names import NETWORK
from benchmarks.curve_verdicts import REFUSED, RIGHT, WRONG
from benchmarks.lab import judged
from benchmarks.measures import coverage_of
from benchmarks.perception import false_threads, found_row, precision, recall
from benchmarks.scenes import reconstructed, rendered
from benchmarks.tables import CONSOLE, Row, print_rows, share, write_json

SEEDS = 10**9
WHOLE = 0.95
"""A thread of which so much is found is found whole."""
LAB = "easy", "medium", "needle", "rod"
SAMPLES = "10"


@dataclass(frozen=True)
class Options:
    """How much is judged, and where it goes."""

    output: Path
    meshes: Path = Path("../shared/data/instruments")
    """Of the Large Needle Driver."""
    seed: int | None = None
    """Of the scenes; drawn, if it is not given."""
    small: int = 1
    """So many times fewer scenes, to try the command out."""
    frames: int = 2000
    """Thread-free ones; a third of them path-traced."""


def main() -> None:
    """Draw, render, judge and print."""
    options = tyro.cli(Options, description=__doc__)
    seed = secrets.randbelow(SEEDS) if options.seed is None else options.seed
    CONSOLE.print(f"seed {seed}")
    render_all(options, seed)
    rows = {name: _rows(options.output / name / "renders") for name in ("crossings", "lab")}
    figures = {name: _figures(of) for name, of in rows.items()}
    told = [{"what": what} | {name: of[what] for name, of in figures.items()} for what in figures["lab"]]
    print_rows(f"sealed scenes, seed {seed}", told)
    for name, of in rows.items():
        wrong = [row["scene"] for row in of if row["verdict"] == WRONG]
        CONSOLE.print(f"{name}, wrong though ok: {', '.join(wrong) or 'none'}")
    free = false_threads(options.frames, NETWORK, seed, [options.output / "free", options.output / "free_lab"])
    for kind, counts in free.items():
        CONSOLE.print(f"thread-free, {kind}: {counts['reconstruction']} curves in {counts['frames']} frames")
    write_json(options.output / "sealed.json", {"seed": seed, "rows": rows, "thread-free": free})


def render_all(options: Options, seed: int) -> None:
    """Render what is not there yet."""
    tissue, with_meshes = ("chicken", "paper"), ("--with", "meshes", "--meshes", str(options.meshes))
    most = -(-20 // options.small), -(-5 // options.small), -(-15 // options.small)
    _render(options.output / "crossings" / "renders", ("crossing",), tissue, most[0], seed)
    _render(options.output / "lab" / "renders", LAB, ("pad", "phantom"), most[1], seed, *with_meshes)
    _render(options.output / "free", ("none",), tissue, most[2], seed)
    _render(options.output / "free_lab", ("none",), ("pad", "phantom"), most[2], seed, *with_meshes)


def _render(
    folder: Path, configs: tuple[str, ...], grounds: tuple[str, ...], count: int, seed: int, *more: str
) -> None:
    program = Path(sys.executable).with_name("suturegrasp")
    which = "--config", *configs, "--background", *grounds, "--count", str(count), "--seed", str(seed)
    command = [str(program), "scenes", "render", *which, "--samples", SAMPLES, "--output", str(folder), *more]
    # 1: some found no place before the camera
    if subprocess.run(command, check=False).returncode not in (0, 1):
        raise SystemExit("the scenes could not be rendered; what suturegrasp scenes render said stands above")


def _rows(folder: Path) -> list[Row]:
    """Of each scene what `benchmarks.perception` and `benchmarks.lab` make of it."""
    paths = sorted(folder.glob("*.json"))
    if not paths:
        raise SystemExit(f"{folder} holds no scenes; what suturegrasp scenes render said stands above")
    rows: list[Row] = []
    for path in track(paths, folder.parent.name, transient=True):
        scene = rendered(path)
        result = reconstructed(scene, segmenter=NETWORK)
        rows.append(found_row(scene, result) | {"verdict": judged(scene, result)["verdict"]})
    return rows


def _figures(rows: list[Row]) -> dict[str, str]:
    """What the scenes of one kind come to, by name."""
    found, right = [recall(row) for row in rows], [precision(row) for row in rows if row["given"]]
    counts = {name: sum(row[name] for row in rows) for name in ("found", "true", "right", "given")}
    verdicts = [row["verdict"] for row in rows]
    error = [row["mean seen"] for row in rows if row["mean seen"] is not None]
    inside = [coverage_of(row) for row in rows if row["coverage"]]
    return {
        "scenes": str(len(rows)),
        "right / wrong though ok / refused": " / ".join(
            str(verdicts.count(verdict)) for verdict in (RIGHT, WRONG, REFUSED)
        ),
        "found whole": str(sum(of >= WHOLE for of in found)),
        "recall, all / worst": f"{share(counts['found'], counts['true'])} / {min(found):.1%}",
        "precision, all / worst": f"{share(counts['right'], counts['given'])} / {min(right, default=0.0):.1%}",
        "error of visible parts, median / worst, mm": f"{np.median(error):.2f} / {max(error):.2f}" if error else "-",
        "95 % ellipse, all / worst": f"{share(*np.sum(inside, axis=0))} / {min(i / n for i, n in inside):.1%}"
        if inside
        else "-",
    }


if __name__ == "__main__":
    main()
