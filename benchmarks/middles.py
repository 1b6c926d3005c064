"""What the middles of the thread in both images cost the curve, and what they err by.

    .venv/bin/python -m benchmarks.middles --data ../shared/data

Every render is run from its raw images. Then each middle is moved towards the true one, so that shares of its error are
left, and the curve is made again: what better middles would bring, with everything else as it is. The same with nothing
left where the thread runs at some angles to the rows. And what both eyes err across the thread, averaged over 40 px of
it: each, how far alike, and by how much that changes when the left image gets its own noise once more, is compressed
once more, or is moved by half a pixel. What these change is chance and cannot be learned; the rest follows from what is
seen.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8
from rich.console import Console
from rich.table import Table
from scipy.spatial import KDTree

from agents.cli.reconstruct.pipeline import PipelineResult, reconstruct_pair
from agents.perception.centrelines import thread_centrelines
from agents.perception.segmentation.network import segment_network
from agents.reconstruction.method_names import DEFAULT_METHOD
from agents.reconstruction.methods import METHODS
from benchmarks.eyes_alike import GROSS_PX, STEP_PX, across
from benchmarks.measures import figures
from benchmarks.scenes import CLEAR, CROSSING, OCCLUSION, Scene, scenes
from benchmarks.variations import NONE, Run
from schemas.messages import Centrelines
from shared.camera import project

LEFT_OF_ERROR = 1.0, 2 / 3, 1 / 3, 0.0
EVERYWHERE = 0.0, 90.0
TRUE_AT_DEG = (0.0, 5.0), (0.0, 10.0), (0.0, 20.0), (10.0, 90.0), (20.0, 90.0), (40.0, 90.0)
"""Angles to the rows from and up to which middles are true."""
NEAR_PX, DENSE_PX = 1.5, 0.05
"""A point farther from the true middle is of something else, and stays."""
STEEP = 0.3
"""Share of the normal along the row from which the eyes are compared: below it, errors across tell nothing of depth."""
MOVED_PX, JPEG_QUALITY, BLOCK_PX = 0.5, 95, 4
"""Compressed once more, the image lies half a block aside, since the same blocks would change nothing."""
Image = UInt8[np.ndarray, "h w 3"]
Errors = Float64[np.ndarray, "n"]


@dataclass(frozen=True)
class Off:
    """Of one scene, in pixels across the thread: rms of each eye and of their difference, correlation, changes."""

    eye: float
    apart: float
    alike: float
    changed: dict[str, float]


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of scenes")
    parser.add_argument("--only", default="", help="run only scenes whose name contains this")
    arguments = parser.parse_args()
    chosen = [
        load()
        for name, group, load in scenes(arguments.data)
        if group in (CLEAR, CROSSING, OCCLUSION) and arguments.only in name
    ]
    if not chosen:
        parser.error(f"no render under {arguments.data} has a name that contains {arguments.only!r}")
    console = Console(width=140)
    found = [(scene, _found(scene)) for scene in chosen]
    print_curves(console, found)
    print_off(console, [off_of(scene, result) for scene, result in found])


def _found(scene: Scene) -> PipelineResult:
    return reconstruct_pair(scene.images, scene.calibration, masks=None, segmenter="network", method=DEFAULT_METHOD)


def nearer(
    lines: Centrelines, true_px: Float64[np.ndarray, "n 2"], share: float, at_deg: tuple[float, float] = EVERYWHERE
) -> Centrelines:
    """Middles moved towards a true curve, so that a share of what they err across it is left.

    Args:
        at_deg: angles to the rows between which the true curve runs where they are; others stay.
    """
    travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(true_px, axis=0), axis=1))))
    even = np.arange(0.0, travelled[-1], DENSE_PX)
    dense = np.column_stack([np.interp(even, travelled, part) for part in true_px.T])
    found = KDTree(dense).query(lines.point_px)
    distance, nearest = np.asarray(found[0], np.float64), np.asarray(found[1], np.int64)
    run = np.abs(np.gradient(dense, axis=0))[nearest]
    angle_deg = np.degrees(np.arctan2(run[:, 1], run[:, 0]))
    moves = (distance < NEAR_PX) & (angle_deg >= at_deg[0]) & (angle_deg <= at_deg[1])
    left = np.where(moves, share, 1.0)[:, None]
    return replace(lines, point_px=dense[nearest] + left * (lines.point_px - dense[nearest]))


def with_share(
    scene: Scene, result: PipelineResult, share: float, at_deg: tuple[float, float] = EVERYWHERE
) -> PipelineResult:
    """The curve made again from middles that err by a share of what they do, at some angles to the rows."""
    assert scene.truth is not None
    seen = result.observations
    left, right = (
        nearer(lines, true_px, share, at_deg)
        for lines, true_px in zip(
            (seen.centrelines_left, seen.centrelines_right), project(seen.camera, scene.truth), strict=True
        )
    )
    seen = replace(seen, centrelines_left=left, centrelines_right=right)
    return replace(result, observations=seen, reconstruction=METHODS[DEFAULT_METHOD](seen))


def print_curves(console: Console, found: list[tuple[Scene, PipelineResult]]) -> None:
    """A column for each share of the error that is left, and for each range of angles at which nothing is."""
    shares = {f"{share:.2f}": (share, EVERYWHERE) for share in LEFT_OF_ERROR}
    _print_curves(console, "curve error, mm, with so much of the middles' error left", found, shares)
    angles = {f"{low:.0f} to {high:.0f}°": (0.0, (low, high)) for low, high in TRUE_AT_DEG}
    _print_curves(console, "curve error, mm, with true middles at such angles to the rows", found, angles)


def _print_curves(
    console: Console,
    title: str,
    found: list[tuple[Scene, PipelineResult]],
    columns: dict[str, tuple[float, tuple[float, float]]],
) -> None:
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for name in columns:
        table.add_column(name, justify="right")
    rows = [
        [figures(_run(scene), with_share(scene, result, *moved)) for scene, result in found]
        for moved in columns.values()
    ]
    for text, group, key, summary in (
        ("clear, median", CLEAR, "mean", np.median),
        ("visible parts, worst scene", "", "mean seen", np.max),
        ("crossings, mean error, worst", CROSSING, "mean", np.max),
    ):
        values = [[row[key] for row in column if row["group"] == (group or row["group"])] for column in rows]
        table.add_row(text, *(f"{summary(column):.3f}" if column else "-" for column in values))
    console.print(table)


def _run(scene: Scene) -> Run:
    return Run(scene, None, NONE, scene.calibration)


def off_of(scene: Scene, result: PipelineResult) -> Off:
    """What both eyes err across the true thread, and what chance has to do with it."""
    assert scene.truth is not None
    seen, true_px = result.observations, project(result.observations.camera, scene.truth)
    travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(true_px[0], axis=0), axis=1))))
    at = np.searchsorted(travelled, np.arange(0.0, travelled[-1], STEP_PX)).clip(0, len(travelled) - 1)

    def err(eye: int, lines: Centrelines) -> Errors:
        error = across(true_px[eye], lines, at)[0]
        return np.where(np.abs(error) < GROSS_PX, error, np.nan)

    left, right = err(0, seen.centrelines_left), err(1, seen.centrelines_right)
    run = np.gradient(true_px[0], axis=0)[at]
    steep = np.isfinite(left + right) & (np.abs(run[:, 1]) > STEEP * np.linalg.norm(run, axis=1))
    coverage = segment_network(scene.images[0])
    before = err(0, thread_centrelines(scene.images[0], coverage))
    changed: dict[str, float] = {}
    for name, change in CHANGES.items():
        image, moved_px = change(scene.images[0])
        lines = thread_centrelines(image, coverage)
        again = err(0, replace(lines, point_px=lines.point_px - [moved_px, 0.0]))
        changed[name] = _rms((again - before)[np.isfinite(again + before)])
    left, right = left[steep], right[steep]
    alike = float(np.mean(left * right) / (_rms(left) * _rms(right)))
    return Off(np.sqrt(_rms(left) * _rms(right)), _rms(left - right), alike, changed)


def noisy(image: Image) -> tuple[Image, float]:
    """With as much noise once more as its second differences show (Immerkær 1996)."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    second = cv2.filter2D(grey, -1, np.outer([1, -2, 1], [1, -2, 1]).astype(np.float32))
    sigma = float(np.median(np.abs(second))) / 0.6745 / 6.0
    more = np.random.default_rng(1).normal(0.0, sigma, image.shape)
    return np.clip(np.rint(image + more), 0, 255).astype(np.uint8), 0.0


def compressed(image: Image) -> tuple[Image, float]:
    """As JPEG once more, in other blocks."""
    aside = np.pad(image, ((BLOCK_PX, 0), (BLOCK_PX, 0), (0, 0)), mode="edge")
    coded = cv2.imencode(".jpg", aside, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)[BLOCK_PX:, BLOCK_PX:], 0.0


def moved(image: Image) -> tuple[Image, float]:
    """Half a pixel to the right, by the Fourier transform, which blurs nothing."""
    margin = 16
    padded = np.pad(image.astype(np.float64), ((0, 0), (margin, margin), (0, 0)), mode="reflect")
    turn = np.exp(-2j * np.pi * np.fft.fftfreq(padded.shape[1]) * MOVED_PX)[:, None]
    there = np.fft.ifft(np.fft.fft(padded, axis=1) * turn, axis=1).real[:, margin:-margin]
    return np.clip(np.rint(there), 0, 255).astype(np.uint8), MOVED_PX


CHANGES: dict[str, Callable[[Image], tuple[Image, float]]] = {
    "its noise once more": noisy,
    "compressed once more": compressed,
    "half a pixel aside": moved,
}


def _rms(values: Errors) -> float:
    return float(np.sqrt(np.mean(values**2)))


def print_off(console: Console, found: list[Off]) -> None:
    """Medians over the scenes."""
    table = Table(title=f"across the thread, averaged over 40 px: medians of {len(found)} scenes", title_justify="left")
    table.add_column("")
    table.add_column("", justify="right")
    for text, values, unit in (
        ("each eye, rms", [off.eye for off in found], " px"),
        ("left less right, rms", [off.apart for off in found], " px"),
        ("correlation of both eyes", [off.alike for off in found], ""),
        *((f"changed: {name}, rms", [off.changed[name] for off in found], " px") for name in CHANGES),
    ):
        table.add_row(text, f"{np.median(values):.3f}{unit}")
    console.print(table)


if __name__ == "__main__":
    main()
