"""How well perception knows the tissue around the thread, and whether it knows how well.

    .venv/bin/python -m benchmarks.surface --data ../shared/data

Scenes of `shared.scene` are measured against the depth that they were drawn at, the board of two real pairs against the
plane through its corners. Of path-traced scenes the thread alone is known: tissue is never nearer than the thread that
lies on it, so what is told to be nearer is wrong. Errors are those of single cells, in millimetres and in deviations as
they are stated: of a normal distribution 68, 95 and 99.7 % lie within one, two and three of them.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8
from rich.console import Console
from rich.table import Table

from agents.perception.surface import tissue_surface
from benchmarks.board import Pair, rectified_board
from benchmarks.scenes import RENDERS, scenes
from schemas.messages import FrameStamp, RectifiedStereo, TissueSurface
from shared.camera import depth_of_disparity, project
from shared.clock import processor_s
from shared.rectification import rectification
from shared.scene.__main__ import ENDOSCOPE, make_scene
from shared.scene.render import render, render_backdrop

STAMP = FrameStamp(1, 0, 0, "")
HALF_SIZE = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)
CONFIGS, DISTANCES_MM = ("easy", "medium", "hard", "crossing"), (70.0, 82.0, 95.0, 108.0, 120.0)
FIRST_SEED = 2001
"""Apart from the seeds on which the constants of the surface were found."""
THREAD = 128
"""Coverage from which a pixel is thread."""
CONSOLE = Console(width=160)


@dataclass(frozen=True)
class Row:
    """What one pair came to.

    Fields:
        valid: share of the cells that were measured, of those with a known truth.
        median_mm, most_mm, worst_mm: of the absolute error, with 95 % within `most_mm`.
        stated_mm: the median of the stated deviation.
        within: shares of the errors within one, two and three stated deviations.
    """

    group: str
    name: str
    cells: int
    valid: float
    median_mm: float
    most_mm: float
    worst_mm: float
    stated_mm: float
    within: tuple[float, float, float]
    ms: float


@dataclass(frozen=True)
class Before:
    """What was told of the tissue at places of a thread that lies before it.

    Fields:
        told: share of the thread's visible places that lie in cells beside measured ones.
        behind_mm: the median of tissue behind thread.
        wrong: share of the places where tissue is told to be nearer than the thread by more than two deviations.
    """

    name: str
    told: float
    behind_mm: float
    wrong: float


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of scenes")
    parser.add_argument("--scenes", type=int, default=20, help="how many scenes of shared.scene")
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="of the first of them")
    parser.add_argument("--json", type=Path, default=Path("out/surface.json"), help="where the figures go")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    rows = [*light_scenes(arguments.seed, arguments.scenes), *boards(arguments.data / "storz_calibration")]
    before = list(path_traced(arguments.data))
    print_rows(rows)
    print_before(before)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    found = {"rows": [asdict(row) for row in rows], "path traced": [asdict(row) for row in before]}
    arguments.json.write_text(json.dumps(found, indent=1) + "\n")


def light_scenes(first: int, count: int) -> Iterator[Row]:
    """Scenes of every configuration and distance; each fifth with half as many pixels a side."""
    for seed in range(first, first + count):
        small = seed % 5 == 0
        camera, config, distance = HALF_SIZE if small else ENDOSCOPE, CONFIGS[seed % 4], DISTANCES_MM[seed // 4 % 5]
        scene = make_scene(config, "tissue", seed, distance_mm=distance, camera=camera)
        pair = render(scene)
        behind = render_backdrop(camera, "tissue", distance, seed)
        surface, ms = measured(camera, (pair.left_bgr, pair.right_bgr), pair.coverage_left)
        group = "drawn, 480 px wide" if small else "drawn"
        yield row_of(group, f"{config} {distance:.0f} mm {seed}", surface, at_cells(surface, behind.depth_left_mm), ms)


def boards(data: Path) -> Iterator[Row]:
    """Real images of a board, by the plane through its corners, within them."""
    for left in sorted(data.glob("*left.images.*.png")):
        images, camera, corners = rectified_board(left)
        places, other = (grid.reshape(-1, 2) for grid in corners)
        # the disparity of a plane is affine in the pixel
        plane, *_ = np.linalg.lstsq(np.column_stack((places, np.ones(len(places)))), (places - other)[:, 0], rcond=None)
        surface, ms = measured(camera, images, np.zeros(images[0].shape[:2], np.uint8))
        u, v = np.meshgrid(surface.u_px, surface.v_px)
        truth = depth_of_disparity(camera, (plane[0] * u + plane[1] * v + plane[2]).ravel()).reshape(u.shape)
        truth[~within_hull(places, u, v)] = np.nan
        yield row_of("real board", left.stem.split(".")[-1], surface, truth, ms)


def path_traced(data: Path) -> Iterator[Before]:
    """Renders whose thread is known, and of whose tissue that it lies behind it."""
    for name, group, load in scenes(data):
        if group not in RENDERS[:3]:
            continue
        scene = load()
        assert scene.masks is not None and scene.truth is not None and scene.visible is not None
        camera = rectification(scene.calibration).camera
        surface, _ = measured(camera, scene.images, scene.masks[0])
        points = scene.truth[scene.visible.all(axis=1)]
        behind, deviation = behind_points(surface, points)
        told = np.isfinite(behind)
        yield Before(
            name=name,
            told=float(told.mean()),
            behind_mm=float(np.median(behind[told])) if told.any() else np.nan,
            wrong=float((behind[told] < -2 * deviation[told]).mean()) if told.any() else np.nan,
        )


def measured(camera: RectifiedStereo, images: Pair, mask: UInt8[np.ndarray, "h w"]) -> tuple[TissueSurface, float]:
    """The surface of a pair, with the least processor time of three."""
    ms: list[float] = []
    surface = None
    for _ in range(3):
        begun_s = processor_s()
        surface = tissue_surface(STAMP, camera, *images, mask >= THREAD)
        ms.append(1e3 * (processor_s() - begun_s))
    assert surface is not None
    return surface, min(ms)


def at_cells(surface: TissueSurface, depth_mm: np.ndarray) -> Float64[np.ndarray, "r c"]:
    """A depth map at the middles of the cells."""
    v, u = np.round(surface.v_px).astype(int), np.round(surface.u_px).astype(int)
    return depth_mm[np.ix_(v, u)].astype(np.float64)


def within_hull(
    corners: Float64[np.ndarray, "n 2"], u: Float64[np.ndarray, "r c"], v: Float64[np.ndarray, "r c"]
) -> Bool[np.ndarray, "r c"]:
    """Which pixels lie within the outline of some corners."""
    hull = cv2.convexHull(corners.astype(np.float32))
    inside = [cv2.pointPolygonTest(hull, (x, y), measureDist=False) >= 0 for x, y in zip(u.flat, v.flat, strict=True)]
    return np.array(inside).reshape(u.shape)


def behind_points(
    surface: TissueSurface, points: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """How far the nearest cell to each point is behind it, in depth, with its deviation; NaN where it is not known."""
    px, _ = project(surface.camera, points)
    column = np.abs(surface.u_px - px[:, :1]).argmin(axis=1)
    row = np.abs(surface.v_px - px[:, 1:]).argmin(axis=1)
    assert surface.deviation is not None
    known = surface.valid[row, column]
    behind = np.where(known, surface.depth[row, column] - points[:, 2], np.nan)
    return behind, np.where(known, surface.deviation[row, column], np.nan)


def row_of(group: str, name: str, surface: TissueSurface, truth: Float64[np.ndarray, "r c"], ms: float) -> Row:
    """The errors of one surface where the truth is known."""
    assert surface.deviation is not None
    judged = surface.valid & np.isfinite(truth)
    error = np.abs(surface.depth - truth)[judged]
    stated = surface.deviation[judged]
    one, two, three = (float((error <= times * stated).mean()) for times in (1, 2, 3))
    return Row(
        group=group,
        name=name,
        cells=int(judged.sum()),
        valid=float(judged.sum() / np.isfinite(truth).sum()),
        median_mm=float(np.median(error)),
        most_mm=float(np.percentile(error, 95)),
        worst_mm=float(error.max()),
        stated_mm=float(np.median(stated)),
        within=(one, two, three),
        ms=ms,
    )


def print_rows(rows: list[Row]) -> None:
    """The table of errors, with the means of each group."""
    table = Table(title="Tissue against the truth, cell by cell", title_justify="left")
    for column in (
        "scene",
        "cells",
        "valid",
        "median mm",
        "95 % mm",
        "worst mm",
        "stated mm",
        "1 σ",
        "2 σ",
        "3 σ",
        "ms",
    ):
        table.add_column(column, justify="left" if column == "scene" else "right")
    for group in dict.fromkeys(row.group for row in rows):
        own = [row for row in rows if row.group == group]
        for row in own:
            table.add_row(f"{row.group}: {row.name}", str(row.cells), *_shown(_numbers(row)))
        mean = np.mean([_numbers(row) for row in own], axis=0)
        table.add_row(f"[bold]{group}: mean of {len(own)}", str(sum(row.cells for row in own)), *_shown(mean))
    CONSOLE.print(table)


def print_before(rows: list[Before]) -> None:
    """The table of path-traced scenes."""
    table = Table(title="Tissue behind the thread of path-traced scenes", title_justify="left")
    for column in ("scene", "told", "behind mm", "nearer than the thread by 2 σ"):
        table.add_column(column, justify="left" if column == "scene" else "right")
    for row in rows:
        table.add_row(row.name, f"{row.told:.0%}", f"{row.behind_mm:.2f}", f"{row.wrong:.1%}")
    wrong = [row.wrong for row in rows if np.isfinite(row.wrong)]
    told = float(np.mean([row.told for row in rows])) if rows else np.nan
    table.add_row("[bold]mean", f"{told:.0%}", "", f"{np.mean(wrong) if wrong else np.nan:.1%}")
    CONSOLE.print(table)


def _numbers(row: Row) -> tuple[float, ...]:
    return row.valid, row.median_mm, row.most_mm, row.worst_mm, row.stated_mm, *row.within, row.ms


def _shown(numbers: "tuple[float, ...] | Float64[np.ndarray, 'n']") -> list[str]:
    forms = (".0%", ".2f", ".2f", ".2f", ".2f", ".1%", ".1%", ".1%", ".0f")
    return [format(float(number), form) for number, form in zip(numbers, forms, strict=True)]


if __name__ == "__main__":
    main()
