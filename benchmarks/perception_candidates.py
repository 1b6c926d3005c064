"""How well several threads are told apart, and instruments and needles found: path-traced scenes, whole pipeline.

    suturegrasp scenes render --config several needle --background chicken paper --count 10 --seed 9000 --output DIR
    .venv/bin/python -m benchmarks.perception_candidates --scenes DIR

A scene of several threads counts as right where the curve lies on one true thread, from end to end, and every other
thread is listed beside it; a curve ends at a needle where at most 2 % of it lie on that, or within 3 px. Everything
runs without masks, as `suturegrasp reconstruct` would run it.
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float64
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial import cKDTree

from agents.camera.image_files import read_pair
from agents.cli.reconstruct.pipeline import PipelineResult, reconstruct_pair
from agents.perception.occluders import occluders_in
from agents.reconstruction.method_names import DEFAULT_METHOD
from schemas.messages import Occluder, Status
from shared.calibration import read_calibration
from shared.camera import project
from shared.splines import evaluate

NEAR_PX = 6.0
"""In an image 960 px wide: about a thread's width."""
WHOLE, PURE = 0.95, 0.95
"""Of what is visible of a thread, and of a curve."""
LISTED_WHOLE, LISTED_PURE = 0.8, 0.9
"""Of a thread that is listed: it is cut before every crossing, and no curve bridges what hides it."""
PLACES = 800
MOST_ON_NEEDLE, BESIDE_NEEDLE_PX = 0.02, 3
"""Of the curve: half of that is how well tips are found."""

Line = Float64[np.ndarray, "n 2"]


@dataclass(frozen=True)
class TrueThread:
    """Where a thread lies in the left image, and which of its places that image shows."""

    px: Line
    visible: Bool[np.ndarray, "n"]


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=Path, nargs="+", required=True, help="folders of path-traced scenes")
    parser.add_argument("--json", type=Path, default=Path("out/perception_candidates.json"), help="where figures go")
    arguments = parser.parse_args()
    found = sorted(path for folder in arguments.scenes for path in folder.glob("*.json"))
    if not found:
        parser.error("these folders hold no scenes; render some with `suturegrasp scenes render`")
    rows = [row_of(path) for path in track(found, "scenes")]
    print_tables(Console(width=140), rows)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


def row_of(path: Path) -> dict[str, Any]:
    """The figures of one scene."""
    about = json.loads(path.read_text())
    stem = str(path.with_suffix(""))
    left, right = read_pair(Path(f"{stem}_left.png"), Path(f"{stem}_right.png"))
    calibration = read_calibration((path,), unit="mm", image_size=left.shape[1::-1]).calibration
    result = reconstruct_pair((left, right), calibration, masks=None, segmenter=None, method=DEFAULT_METHOD)
    threads = true_threads(path, about)
    row = {"name": path.stem, "ground": about["background"], "config": about["config"], "threads": len(threads)}
    row["listed"] = len(result.reconstruction.other_threads)
    row |= of_curve(result, threads) | of_needle(result, Path(f"{stem}_needle_left.png"))
    return row | of_instruments(left, Path(f"{stem}_tool_left.png"))


def true_threads(path: Path, about: dict[str, Any]) -> list[TrueThread]:
    """Every thread of a scene."""
    K = np.array(about["K"])
    found: list[TrueThread] = []
    for file in (path.with_suffix(".npy"), *sorted(path.parent.glob(f"{path.stem}_thread*.npy"))):
        truth = np.load(file)
        if not len(truth):
            continue
        px = truth[:, :2] / truth[:, 2:3] * (K[0, 0], K[1, 1]) + K[:2, 2]
        inside = ((px >= 0) & (px <= (about["width"] - 1, about["height"] - 1))).all(axis=1)
        found.append(TrueThread(px, (truth[:, 4] > 0) & inside))
    return found


def of_curve(result: PipelineResult, threads: list[TrueThread]) -> dict[str, Any]:
    """Whether the curve is one thread, from end to end, and whether the others are listed."""
    thread = result.reconstruction
    none = {"reason": thread.reason, "pure": 0.0, "whole": 0.0, "one thread": False, "others listed": False}
    if thread.status is not Status.OK or not threads:
        return none
    points = evaluate(thread.knots, thread.control_points_camera, thread.degree, np.linspace(0, 1, PLACES))
    curve_px, _ = project(thread.camera, points)
    pure = [share_near(curve_px, true.px) for true in threads]
    own = int(np.argmax(pure))
    whole = share_near(threads[own].px[threads[own].visible], curve_px)
    others = [true for number, true in enumerate(threads) if number != own]
    listed = all(any(_is_listed(true, other.left_px) for other in thread.other_threads) for true in others)
    one = pure[own] >= PURE and whole >= WHOLE
    return {"reason": "", "pure": pure[own], "whole": whole, "one thread": one, "others listed": listed}


def _is_listed(thread: TrueThread, listed_px: Line) -> bool:
    # what is listed has a place every 6 px
    whole = share_near(thread.px[thread.visible], listed_px, NEAR_PX + 3)
    return whole >= LISTED_WHOLE and share_near(listed_px, thread.px) >= LISTED_PURE


def of_needle(result: PipelineResult, truth: Path) -> dict[str, Any]:
    """The share of the curve that lies on a needle; nothing where there is none."""
    thread = result.reconstruction
    if not truth.is_file() or thread.status is not Status.OK:
        return {"on needle": None}
    coverage = np.asarray(cv2.imread(str(truth), cv2.IMREAD_GRAYSCALE))
    wide = cv2.dilate(coverage, np.ones((2 * BESIDE_NEEDLE_PX + 1,) * 2, np.uint8))
    points = evaluate(thread.knots, thread.control_points_camera, thread.degree, np.linspace(0, 1, PLACES))
    at = np.rint(project(thread.camera, points)[0]).astype(np.intp)
    u, v = at[:, 0].clip(0, wide.shape[1] - 1), at[:, 1].clip(0, wide.shape[0] - 1)
    return {"on needle": float(np.mean(np.asarray(wide)[v, u] > 128))}


def of_instruments(left: np.ndarray, truth: Path) -> dict[str, Any]:
    """How much of the instruments is found, and of the image falsely."""
    found = occluders_in(left)
    tool = np.zeros(found.shape, bool)
    if truth.is_file():
        coverage = cv2.imread(str(truth), cv2.IMREAD_GRAYSCALE)
        tool = np.asarray(cv2.resize(np.asarray(coverage), found.shape[::-1], interpolation=cv2.INTER_AREA)) > 128
    is_tool = found == Occluder.TOOL.value
    return {
        "instruments": float(tool.mean()),
        "found": float((is_tool & tool).sum() / max(1, tool.sum())),
        "false": float((is_tool & ~tool).mean()),
    }


def share_near(places: Line, line: Line, within_px: float = NEAR_PX) -> float:
    """The share of places that lie near a line."""
    return float(np.mean(cKDTree(line).query(places)[0] <= within_px)) if len(places) and len(line) else 0.0


def print_tables(console: Console, rows: list[dict[str, Any]]) -> None:
    """What became of scenes by how many threads they have, and of instruments by what they lie on."""
    table = Table("threads", "scenes", "one true thread, end to end", "others listed", "both", "others listed, mean")
    for several, name in ((True, "several"), (False, "one")):
        some = [row for row in rows if (row["threads"] > 1) == several and row["threads"]]
        if some:
            both = sum(row["one thread"] and row["others listed"] for row in some)
            one, listed = (sum(row[what] for row in some) for what in ("one thread", "others listed"))
            mean = np.mean([row["listed"] for row in some])
            table.add_row(name, str(len(some)), str(one), str(listed) if several else "", str(both), f"{mean:.1f}")
    console.print(table)
    table = Table("ground", "scenes", "with instruments", "of these found, mean", "false, mean / worst")
    for ground in sorted({row["ground"] for row in rows}):
        some = [row for row in rows if row["ground"] == ground]
        there = [row["found"] for row in some if row["instruments"] > 0]
        false = [row["false"] for row in some]
        table.add_row(
            ground,
            str(len(some)),
            str(len(there)),
            f"{np.mean(there):.0%}" if there else "",
            f"{np.mean(false):.1%} / {np.max(false):.1%} of the image",
        )
    console.print(table)
    shares = [row["on needle"] for row in rows if row["on needle"] is not None]
    if shares:
        ended = sum(share <= MOST_ON_NEEDLE for share in shares)
        console.print(
            f"needles: {ended} of {len(shares)} curves end where it begins; "
            f"on it, mean / worst: {np.mean(shares):.1%} / {np.max(shares):.1%} of the curve"
        )
    for row in rows:
        if row["threads"] and not (row["one thread"] and (row["threads"] == 1 or row["others listed"])):
            console.print(
                f"{row['name']}: {row['pure']:.0%} of the curve on one thread, {row['whole']:.0%} of that thread, "
                f"others {'' if row['others listed'] else 'not '}listed {row['reason']}"
            )


if __name__ == "__main__":
    main()
