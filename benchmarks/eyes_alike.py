"""How far both images of a thread err alike, by its direction: what `shared_errors` of the posterior takes them for.

    .venv/bin/python -m benchmarks.eyes_alike --scenes FOLDER [FOLDER ...]

For path-traced pairs with truth (`suturegrasp scenes render`): centrelines of raw images, each image's signed distance
across the true thread, averaged over 40 px of it. Of both images' errors the half sum moves the curve aside, the half
difference in depth; each is told as rms over what the points state for it if each eye erred by itself.
"""

import argparse
import itertools
import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64
from rich.console import Console
from rich.table import Table
from scipy.spatial import KDTree

from agents.camera.scene_source import calibration_of
from agents.cli.reconstruct.pipeline import reconstruct_pair
from agents.reconstruction.method_names import DEFAULT_METHOD
from schemas.messages import Centrelines, RectifiedStereo, Status
from shared.camera import project

STEP_PX, WINDOW = 2.0, 20
"""Between places along the left image, and how many of them are averaged over."""
NEAR_PX, GROSS_PX = 2.5, 1.0
"""A centreline farther away is of something else; averages beyond the other are wrong courses and no light."""
LEAST_SHARE = 0.6
SLOPES_DEG = 0, 3, 6, 10, 15, 25, 45, 90
RISING_DEG = 0, 10, 20, 35, 60
FEWEST = 100
MM = 1e-3
OTHERS = "none", "rod", "needle", "several"


@dataclass(frozen=True)
class Off:
    """At places along one thread: what both eyes err over what they state, and how the thread runs there.

    Fields:
        differing, common: of the difference and of the sum.
        slope_deg: to the rows of the left image; rising_deg: to the plane across the line of sight.
    """

    differing: Float64[np.ndarray, "n"]
    common: Float64[np.ndarray, "n"]
    slope_deg: Float64[np.ndarray, "n"]
    rising_deg: Float64[np.ndarray, "n"]


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=Path, nargs="+", required=True, help="folders of path-traced pairs with truth")
    parser.add_argument("--only", default="", help="scenes whose name contains this")
    arguments = parser.parse_args()
    paths = [
        path for folder in arguments.scenes for path in sorted(folder.glob("*.json")) if arguments.only in path.stem
    ]
    found = [off for path in paths if (off := of_scene(path)) is not None]
    if not found:
        parser.error("no scene of one thread there")
    print_found(found)


def of_scene(path: Path) -> Off | None:
    """Of one pair; None where it does not show one thread, or none is found."""
    about = json.loads(path.read_text())
    if about.get("config") in OTHERS or about.get("threads", 1) != 1 or not path.with_suffix(".npy").is_file():
        return None
    K = np.array(about["K"])
    size = about["width"], about["height"]
    camera = RectifiedStereo(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], MM * about["baseline_mm"], 1.0)
    left, right = (cv2.imread(str(path.with_name(f"{path.stem}_{side}.png"))) for side in ("left", "right"))
    pair = np.asarray(left, np.uint8), np.asarray(right, np.uint8)
    seen = reconstruct_pair(pair, calibration_of(camera), masks=None, segmenter=None, method=DEFAULT_METHOD)
    if seen.observations.status is not Status.OK:
        return None
    truth = MM * np.load(path.with_suffix(".npy"))[:, :3]
    lines = seen.observations.centrelines_left, seen.observations.centrelines_right
    return off_of(truth, lines, camera)


def off_of(truth: Float64[np.ndarray, "n 3"], lines: tuple[Centrelines, Centrelines], camera: RectifiedStereo) -> Off:
    """What both images' centrelines err along a true thread."""
    both_px = project(camera, truth)
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(both_px[0], axis=0), axis=1))))
    at = np.searchsorted(along, np.arange(0.0, along[-1], STEP_PX)).clip(0, len(along) - 1)
    errors, stated = zip(*(across(px, one, at) for px, one in zip(both_px, lines, strict=True)), strict=True)
    spread = np.hypot(*stated)
    tangent = np.gradient(truth, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]
    ray = truth / np.linalg.norm(truth, axis=1)[:, None]
    run = np.gradient(both_px[0], axis=0)[at]
    slope = np.degrees(np.arctan2(np.abs(run[:, 1]), np.abs(run[:, 0])))
    rising = np.degrees(np.arcsin(np.clip(np.abs((tangent * ray).sum(axis=1)), 0.0, 1.0)))[at]
    good = np.isfinite(errors[0] + errors[1]) & (np.maximum(*np.abs(errors)) < GROSS_PX)
    return Off(
        ((errors[1] - errors[0]) / spread)[good], ((errors[1] + errors[0]) / spread)[good], slope[good], rising[good]
    )


def across(
    truth_px: Float64[np.ndarray, "n 2"], lines: Centrelines, at: np.ndarray
) -> tuple[Float64[np.ndarray, "k"], Float64[np.ndarray, "k"]]:
    """An image's error across the thread, averaged along it, and what its points state; NaN where it shows none."""
    run = np.gradient(truth_px, axis=0)
    run /= np.maximum(np.linalg.norm(run, axis=1), 1e-12)[:, None]
    found = KDTree(lines.point_px).query(truth_px)
    distance, nearest = np.asarray(found[0], np.float64), np.asarray(found[1], np.int64)
    off = ((lines.point_px[nearest] - truth_px) * np.column_stack((-run[:, 1], run[:, 0]))).sum(axis=1)
    shown = distance[at] < NEAR_PX
    window = np.ones(WINDOW)
    count = np.convolve(shown, window, "same")
    mean = np.convolve(np.where(shown, off[at], 0.0), window, "same") / np.maximum(count, 1.0)
    return np.where(count > LEAST_SHARE * WINDOW, mean, np.nan), lines.deviation_px[nearest][at]


def print_found(found: list[Off]) -> None:
    """A row for each range of the rising, a column for each of the slope: difference / sum."""
    differing, common, slope, rising = (
        np.concatenate([getattr(one, name) for one in found])
        for name in ("differing", "common", "slope_deg", "rising_deg")
    )
    table = Table(
        title=f"{len(found)} threads: what differs / what is common, over what is stated", title_justify="left"
    )
    table.add_column("rising \\ slope, degrees")
    pairs = list(itertools.pairwise(SLOPES_DEG))
    for low, high in pairs:
        table.add_column(f"{low} to {high}", justify="right")
    for low, high in itertools.pairwise(RISING_DEG):
        cells: list[str] = []
        for least, most in pairs:
            here = (slope >= least) & (slope < most) & (rising >= low) & (rising < high)
            rms = [float(np.sqrt(np.mean(part[here] ** 2))) for part in (differing, common)] if here.any() else []
            cells.append(f"{rms[0]:.2f} / {rms[1]:.2f}" if here.sum() >= FEWEST else "-")
        table.add_row(f"{low} to {high}", *cells)
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
