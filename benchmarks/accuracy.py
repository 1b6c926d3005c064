"""How accurate a reconstruction method is on every scene of a data folder, beside published figures.

    .venv/bin/python -m benchmarks.accuracy --data ../shared/data

Each scene is run without masks, as `suturegrasp reconstruct` would run it, and with the best masks that are known.
Prints a table, writes JSON, and compares with the committed baseline of the same method. Times are those of one run
on whatever machine this is; only their order of magnitude means anything.
"""

import argparse
import json
import statistics
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from agents.cli.pipeline import PipelineResult, reconstruct_pair
from agents.reconstruction.methods import DEFAULT_METHOD, METHODS
from agents.viewer.picture import draw_picture
from benchmarks.scenes import TRUTH_SAMPLES, Scene, scenes
from schemas.messages import Status
from shared.arc_length import even_parameters
from shared.camera import project
from shared.curve_distance import curve_distance, inside_ellipse, reprojection_px
from shared.splines import evaluate

BASELINES = Path(__file__).parent / "baselines"
CONSOLE = Console(width=220)
REPROJECTION = ("left to mask", "mask to left", "right to mask", "mask to right")
SEGMENTED = 128


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of scenes")
    parser.add_argument("--method", choices=sorted(METHODS), default=DEFAULT_METHOD)
    parser.add_argument("--only", default="", help="run only scenes whose name contains this")
    parser.add_argument("--json", type=Path, default=Path("out/accuracy.json"), help="where the figures go")
    parser.add_argument("--pictures", type=Path, help="folder for a picture of each run")
    parser.add_argument("--bless", action="store_true", help="make these figures the committed baseline")
    arguments = parser.parse_args()
    loaders = [(name, load) for name, load in scenes(arguments.data) if arguments.only in name]
    if not loaders:
        parser.error(f"no scene under {arguments.data} has a name that contains {arguments.only!r}")

    rows: list[dict[str, Any]] = []
    for _, load in loaders:
        scene = load()
        for masks in (None, scene.masks) if scene.masks else (None,):
            result = reconstruct_pair(
                scene.images, scene.calibration, masks=masks, segmenter=None, method=arguments.method
            )
            rows.append(figures(scene, result, scene.masks_are if masks else "none"))
            if arguments.pictures:
                save_picture(arguments.pictures / f"{scene.group} {scene.name} masks {rows[-1]['masks']}.png", result)
    for group in dict.fromkeys(row["group"] for row in rows):
        print_group(group, [row for row in rows if row["group"] == group])
    save(arguments.json, arguments.method, rows)
    baseline = BASELINES / f"accuracy_{arguments.method}.json"
    if arguments.bless:
        save(baseline, arguments.method, rows)
    elif baseline.is_file():
        compare(json.loads(baseline.read_text())["rows"], rows)


def figures(scene: Scene, result: PipelineResult, masks: str) -> dict[str, Any]:
    """Every measure of one run as plain values, None where it cannot be had."""
    thread = result.reconstruction
    row: dict[str, Any] = {
        "group": scene.group,
        "scene": scene.name,
        "masks": masks,
        "segmenter": result.observations.segmenter,
        "status": thread.status.name.lower(),
        "reason": thread.reason,
        "observations": len(result.observations.points_camera),
        "published": scene.published,
        "ms": round(sum(result.timings_ms.values()), 1),
        "timings_ms": {step: round(ms, 1) for step, ms in result.timings_ms.items()},
    }
    row |= dict.fromkeys(("mean", "95 %", "max", "frechet", "length error", "coverage", *REPROJECTION))
    if thread.status is not Status.OK:
        return row
    knots, control_points, degree = thread.knots, thread.control_points_camera, thread.degree
    curve = evaluate(knots, control_points, degree, even_parameters(knots, control_points, degree, TRUTH_SAMPLES))
    if scene.truth is not None:
        apart = curve_distance(curve, scene.truth)
        row |= {"mean": apart.mean, "95 %": apart.percentile_95, "max": apart.maximum, "frechet": apart.frechet}
        row["length error"] = polyline_length(curve) - polyline_length(scene.truth)
        row["coverage"] = coverage(result, scene.truth)
    if scene.masks is not None:
        for eye, (pixels, mask) in enumerate(zip(project(thread.camera, curve), scene.masks, strict=True)):
            both_ways = reprojection_px(pixels, mask >= SEGMENTED)
            for name, distances in zip(REPROJECTION[2 * eye : 2 * eye + 2], both_ways, strict=True):
                row[name] = float(distances.mean()) if len(distances) else None
    return row


def coverage(result: PipelineResult, truth: np.ndarray) -> float | None:
    """The share of places where the truth lies in the predicted 95 % ellipse, None where none is predicted."""
    thread = result.reconstruction
    if len(thread.posterior_s) == 0:
        return None
    spline = (thread.knots, thread.control_points_camera, thread.degree, thread.posterior_s)
    return float(inside_ellipse(evaluate(*spline), evaluate(*spline, 1), thread.posterior_covariance, truth).mean())


def polyline_length(points: np.ndarray) -> float:
    """The sum of the chords."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def print_group(group: str, rows: list[dict[str, Any]]) -> None:
    """One table of a kind of scenes, and its sums with and without masks."""
    published = list(dict.fromkeys(column for row in rows for column in row["published"]))
    measures = ("mean", "95 %", "max", "frechet", "length error", *REPROJECTION, "coverage")
    table = Table(title=f"{group}: lengths in the calibration's unit, reprojection in px", title_justify="left")
    for column in ("scene", "masks", "by", "status", "n", *measures, "ms", *(f"published {p}" for p in published)):
        table.add_column(column, justify="left" if column in ("scene", "masks", "by", "status") else "right")
    for row in rows:
        table.add_row(
            row["scene"],
            row["masks"],
            row["segmenter"],
            row["status"],
            str(row["observations"]),
            *(shown(row[measure]) for measure in measures),
            f"{row['ms']:.0f}",
            *(shown(row["published"].get(column)) for column in published),
        )
    CONSOLE.print(table)
    for row in rows:
        if row["reason"]:
            CONSOLE.print(f"  {row['scene']} (masks: {row['masks']}): {row['reason']}")
    for masks in dict.fromkeys(row["masks"] for row in rows):
        CONSOLE.print(f"  {summed([row for row in rows if row['masks'] == masks], masks, published)}")
    CONSOLE.print()


def summed(rows: list[dict[str, Any]], masks: str, published: list[str]) -> str:
    """Failures, and median and worst of the mean error, here and as published on the same scenes."""
    failures = sum(row["status"] != "ok" for row in rows)
    parts = [f"masks {masks}: {len(rows)} scenes, {failures} failed"]
    parts += (
        [f"mean error {spread(row['mean'] for row in rows)}"] if any(row["mean"] is not None for row in rows) else []
    )
    for name in REPROJECTION:
        if any(row[name] is not None for row in rows):
            parts.append(f"{name} {spread(row[name] for row in rows)}")
    parts.append(f"time {spread((row['ms'] for row in rows), digits=0)} ms")
    for column in published:
        values = [row["published"].get(column) for row in rows]
        parts.append(f"published {column}: {spread(values)}, {sum(value is None for value in values)} failed")
    return "; ".join(parts)


def spread(values: Iterable[float | None], digits: int = 3) -> str:
    """Median and worst of what there is."""
    known = [value for value in values if value is not None]
    if not known:
        return "none"
    return f"median {statistics.median(known):.{digits}f}, worst {max(known):.{digits}f}"


def shown(value: float | None) -> str:
    """A figure as the table prints it."""
    return "-" if value is None else f"{value:.3f}"


def save(path: Path, method: str, rows: list[dict[str, Any]]) -> None:
    """Write all figures as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"method": method, "rows": rows}, indent=1) + "\n")


def save_picture(path: Path, result: PipelineResult) -> None:
    """Write what a person would see of this run."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), draw_picture(*result.images, result.observations, result.reconstruction))


def compare(before: list[dict[str, Any]], now: list[dict[str, Any]]) -> None:
    """Print which scenes changed their status, or their mean error by more than a tenth, against the baseline."""
    known = {(row["group"], row["scene"], row["masks"]): row for row in before}
    for row in now:
        old = known.get((row["group"], row["scene"], row["masks"]))
        if old is None:
            continue
        was, now_is = old["mean"], row["mean"]
        moved = was is not None and now_is is not None and abs(now_is - was) > 0.1 * was
        if old["status"] != row["status"] or moved:
            CONSOLE.print(
                f"changed: {row['group']} {row['scene']} (masks {row['masks']}): "
                f"{old['status']} {shown(was)} -> {row['status']} {shown(now_is)}"
            )


if __name__ == "__main__":
    main()
