"""Perception on scenes that nobody has seen: seeds are drawn now, rendered, and judged once.

    .venv/bin/python -m benchmarks.sealed --output out/sealed --meshes ../shared/data/instruments [--seed N --small 8]

- crossings: threads that cross themselves over tissue.
- lab: needle drivers from their meshes, needles and rods over pads and phantoms.
- thread-free: drawn tissue, rendered fields, and path-traced scenes again and again in other light, mirrored and turned
  (benchmarks/thread_free.py), half of them with needle drivers over pads and phantoms.

Without --seed a seed is drawn and told; scenes that lie in the folder already are not rendered again. The table belongs
into the record whatever it says, and a set that was looked at is sealed no more.
"""

import json
import secrets
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.progress import track
from rich.table import Table

from agents.perception.segmenter_names import NETWORK
from benchmarks import lab, perception
from benchmarks.perception import false_threads, precision, recall
from benchmarks.scenes import scenes
from benchmarks.tables import CONSOLE

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
    options = tyro.cli(Options)
    seed = secrets.randbelow(SEEDS) if options.seed is None else options.seed
    CONSOLE.print(f"seed {seed}")
    rendered(options, seed)
    rows = {name: _rows(options.output / name) for name in ("crossings", "lab")}
    table = Table("what", *rows, title=f"sealed scenes, seed {seed}", title_justify="left")
    for what in _figures(rows["lab"]):
        table.add_row(what, *(_figures(of)[what] for of in rows.values()))
    CONSOLE.print(table)
    for name, of in rows.items():
        wrong = [row["scene"] for row in of if row["verdict"] == "wrong though ok"]
        CONSOLE.print(f"{name}, wrong though ok: {', '.join(wrong) or 'none'}")
    free = false_threads(options.frames, NETWORK, seed, [options.output / "free", options.output / "free_lab"])
    for kind, counts in free.items():
        CONSOLE.print(f"thread-free, {kind}: {counts['reconstruction']} curves in {counts['frames']} frames")
    (options.output / "sealed.json").write_text(json.dumps({"seed": seed, "rows": rows, "thread-free": free}) + "\n")


def rendered(options: Options, seed: int) -> None:
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


def _rows(folder: Path) -> list[dict[str, Any]]:
    """Of each scene what `benchmarks.perception` and `benchmarks.lab` make of it."""
    loads = [(name.split()[-1], load) for name, kind, load in scenes(folder) if not kind.startswith("hidden")]
    if not loads:
        raise SystemExit(f"{folder} holds no scenes; what suturegrasp scenes render said stands above")
    rows: list[dict[str, Any]] = []
    for name, load in track(loads, folder.name, transient=True):
        path = folder / "renders" / f"{name}.json"
        row = perception.row_of(load(), NETWORK, False, None)
        rows.append(row | {"scene": name, "verdict": lab.judged(path, lab.Options(path.parent))["verdict"]})
    return rows


def _figures(rows: list[dict[str, Any]]) -> dict[str, str]:
    """What the scenes of one kind come to, by name."""
    found, right = [recall(row) for row in rows], [precision(row) for row in rows if row["given"]]
    all_found = sum(row["found"] for row in rows) / sum(row["true"] for row in rows)
    all_right = sum(row["right"] for row in rows) / max(sum(row["given"] for row in rows), 1)
    verdicts = [row["verdict"] for row in rows]
    error = [row["mean seen"] for row in rows if row.get("mean seen") is not None]
    inside = [np.sum(list(row["coverage"].values()), axis=0) for row in rows if row["coverage"]]
    shares = [within / places for within, places in inside]
    return {
        "scenes": str(len(rows)),
        "right / wrong though ok / refused": " / ".join(
            str(verdicts.count(verdict)) for verdict in ("right", "wrong though ok", "refused")
        ),
        "found whole": str(sum(share >= WHOLE for share in found)),
        "recall, all / worst": f"{all_found:.1%} / {min(found):.1%}",
        "precision, all / worst": f"{all_right:.1%} / {min(right, default=0.0):.1%}",
        "error of visible parts, median / worst, mm": f"{np.median(error):.2f} / {max(error):.2f}" if error else "-",
        "95 % ellipse, all / worst": f"{np.divide(*np.sum(inside, axis=0)):.1%} / {min(shares):.1%}" if inside else "-",
    }


if __name__ == "__main__":
    main()
