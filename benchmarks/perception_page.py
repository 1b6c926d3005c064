"""Pictures of the renders of which each segmenter finds least, finds most that is no thread, and gives the worst curve.

    .venv/bin/python -m benchmarks.perception_page --data ../shared/data --output docs/pictures

Writes a crop around the worst place of each as JPEG, and prints the table of figures of docs/perception_worst_cases.md.
By recall and precision: one eye's image as it is, and with right places green, false ones yellow, missed truth red.
By error: the left image, and depth along the thread, of the true curve (red) and of the reconstructed one (green).
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64, Int32, UInt8
from rich.console import Console
from rich.progress import track
from scipy.spatial import KDTree

from agents.cli.reconstruct.pipeline import PipelineResult, reconstruct_pair
from agents.perception.segmenter_names import NETWORK
from agents.reconstruction.method_names import DEFAULT_METHOD
from benchmarks.measures import figures, sampled
from benchmarks.perception import shares_of
from benchmarks.perception_pictures import FALSE, MISSED, RIGHT, told_apart
from benchmarks.scenes import CLEAR, CROSSING, OCCLUSION, Scene, scenes
from benchmarks.segmenters import COMPARED, ON_TISSUE
from benchmarks.variations import NONE, Run
from shared.camera import project

RECALL, PRECISION, ERROR = "recall", "precision", "error"
CROP_PX, LARGER = (210, 150), 3
"""Width and height of a crop in the image, and how many times as large it is shown."""
CROWD_PX = 30.0
"""The worst place is the one with most others of its kind within that."""
QUALITY = 80
BESIDE = 10
"""Of the true samples, so many before and after give the direction there."""
MARGIN_PX = 36
DARKER_GREEN = (0, 160, 0)

Line = tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n"]]
"""Arc length and depth, in mm."""


@dataclass(frozen=True)
class Case:
    """A scene and what one segmenter makes of it."""

    scene: Scene
    result: PipelineResult
    row: dict[str, Any]

    @property
    def measures(self) -> dict[str, float]:
        """Recall and precision, and the mean error of the curve's visible part in mm; the lower, the worse."""
        row = self.row
        error = np.inf if row["mean seen"] is None else row["mean seen"]
        return {RECALL: row["found"] / row["true"], PRECISION: row["right"] / max(row["given"], 1), ERROR: -error}


def main() -> None:
    """Run it from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--segmenters", nargs="+", choices=ON_TISSUE, default=[NETWORK])
    parser.add_argument("--worst", type=int, default=2, help="so many scenes by each measure")
    parser.add_argument("--output", type=Path, default=Path("out/worst"), help="folder of the pictures")
    arguments = parser.parse_args()
    of_thread = [load for _, group, load in scenes(arguments.data) if group in (CLEAR, CROSSING, OCCLUSION)]
    arguments.output.mkdir(parents=True, exist_ok=True)
    print("| segmenter | worst by | scene | recall | precision | error | there | picture |\n|" + 8 * "---|")
    for segmenter in arguments.segmenters:
        cases = [case_of(load(), segmenter) for load in track(of_thread, segmenter, console=Console(stderr=True))]
        for measure in (RECALL, PRECISION, ERROR):
            worst = sorted(cases, key=lambda case: case.measures[measure])[: arguments.worst]
            for place, case in enumerate(worst, 1):
                picture, said = picture_of(case, measure)
                name = f"worst_{segmenter}_{measure}_{place}.jpg"
                cv2.imwrite(str(arguments.output / name), picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
                of = case.measures
                shown = f"{of[RECALL]:.1%} | {of[PRECISION]:.1%} | {-of[ERROR]:.2f} mm"
                print(f"| `{segmenter}` | {measure} | `{case.scene.name}` | {shown} | {said} | {name} |", flush=True)


def case_of(scene: Scene, segmenter: str) -> Case:
    """Run one scene from its raw images."""
    result = reconstruct_pair(
        scene.images, scene.calibration, masks=None, segmenter=segmenter, method=DEFAULT_METHOD, segmenters=COMPARED
    )
    row = figures(Run(scene, None, NONE, scene.calibration), result) | shares_of(scene, result)
    return Case(scene, result, row)


def picture_of(case: Case, measure: str) -> tuple[UInt8[np.ndarray, "h w 3"], str]:
    """The worst place by a measure, and a few words on what is there."""
    return _of_curve(case) if measure == ERROR else _of_lines(case, missed=measure == RECALL)


def _of_lines(case: Case, missed: bool) -> tuple[UInt8[np.ndarray, "h w 3"], str]:
    scene, result = case.scene, case.result
    assert scene.truth is not None and scene.visible is not None
    seen = result.observations
    lines = seen.centrelines_left, seen.centrelines_right
    eyes = [told_apart(*eye) for eye in zip(lines, project(seen.camera, scene.truth), scene.visible.T, strict=True)]
    crowds = [_crowd(eye[2] if missed else eye[1]) for eye in eyes]
    eye = int(np.argmax([size for size, _ in crowds]))
    _, middle_px = crowds[eye]
    plain = _crop(result.images[eye], middle_px)
    drawn = plain.copy()
    for points, colour in zip(eyes[eye], (RIGHT, FALSE, MISSED), strict=True):
        _dot(drawn, points, _corner(result.images[eye], middle_px), colour)
    where = f"{('left', 'right')[eye]} image at {middle_px[0]:.0f}, {middle_px[1]:.0f}"
    return np.hstack([plain, _gap(plain), drawn]), where


def _of_curve(case: Case) -> tuple[UInt8[np.ndarray, "h w 3"], str]:
    scene, camera = case.scene, case.result.observations.camera
    assert scene.truth is not None and scene.visible is not None
    curve = sampled(case.result.reconstruction)
    nearest = np.asarray(KDTree(scene.truth).query(curve)[1], np.int64)
    apart = curve - scene.truth[nearest]
    off = np.linalg.norm(apart, axis=1)
    worst = int(np.argmax(np.where((scene.visible[:, 0] & scene.visible[:, 1])[nearest], off, 0.0)))
    truth_px, curve_px = project(camera, scene.truth)[0], project(camera, curve)[0]
    at = int(nearest[worst])
    along = truth_px[min(at + BESIDE, len(truth_px) - 1)] - truth_px[max(at - BESIDE, 0)]
    slope_deg = np.degrees(np.arctan2(abs(along[1]), abs(along[0])))
    whole = case.result.images[0].copy()
    for places, colour, wide in ((curve_px, RIGHT, 3), (truth_px, MISSED, 1)):
        cv2.polylines(whole, [np.rint(places).astype(np.int32)], False, colour, wide)
    height = LARGER * CROP_PX[1]
    width = round(height * whole.shape[1] / whole.shape[0])
    shown = np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    step = np.linalg.norm(np.diff(scene.truth, axis=0), axis=1)
    arc_mm = np.concatenate(([0.0], np.cumsum(step)))
    depths = _depths((arc_mm, scene.truth[:, 2]), (arc_mm[nearest], curve[:, 2]), arc_mm[at], shown.shape[:2])
    said = f"{off[worst]:.2f} mm off, {abs(apart[worst, 2]):.2f} mm of it in depth; {slope_deg:.0f}° to the rows"
    return np.hstack([shown, _gap(shown), depths]), said


def _depths(true: Line, given: Line, at_mm: float, size: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    """Depth along the thread, of the truth and of the curve, with a grey line at the worst place."""
    plot = np.full((*size, 3), 255, np.uint8)
    both = [np.concatenate(axis) for axis in zip(true, given, strict=True)]
    low, high = np.array([[axis.min(), axis.max()] for axis in both]).T
    room = np.array(size[::-1]) - 2 * MARGIN_PX

    def place(line: Line) -> Int32[np.ndarray, "n 2"]:
        share = (np.stack(line, axis=1) - low) / (high - low)
        share[:, 1] = 1.0 - share[:, 1]
        return np.rint(MARGIN_PX + share * room).astype(np.int32)

    column = int(place((np.array([at_mm]), low[1:]))[0, 0])
    cv2.line(plot, (column, MARGIN_PX), (column, size[0] - MARGIN_PX), (200, 200, 200), 2)
    for line, colour in ((true, MISSED), (given, DARKER_GREEN)):
        cv2.polylines(plot, [place(line)], False, colour, 2, cv2.LINE_AA)
    said = f"depth, {low[1]:.1f} to {high[1]:.1f} mm, along {high[0]:.0f} mm of thread"
    cv2.putText(plot, said, (MARGIN_PX, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (0, 0, 0), 1, cv2.LINE_AA)
    return plot


def _crowd(points: Float64[np.ndarray, "n 2"]) -> tuple[int, Float64[np.ndarray, "2"]]:
    """The place with most others around it, and how many these are."""
    if not len(points):
        return 0, np.zeros(2)
    around = np.asarray(KDTree(points).query_ball_point(points, CROWD_PX, return_length=True), np.int64)
    most = int(np.argmax(around))
    return int(np.max(around)), points[most]


def _corner(image: UInt8[np.ndarray, "h w 3"], middle_px: Float64[np.ndarray, "2"]) -> tuple[int, int]:
    u, v = (
        int(np.clip(round(at - size / 2), 0, side - size))
        for at, size, side in zip(middle_px, CROP_PX, image.shape[1::-1], strict=True)
    )
    return u, v


def _crop(image: UInt8[np.ndarray, "h w 3"], middle_px: Float64[np.ndarray, "2"]) -> UInt8[np.ndarray, "H W 3"]:
    u, v = _corner(image, middle_px)
    part = image[v : v + CROP_PX[1], u : u + CROP_PX[0]]
    return np.asarray(cv2.resize(part, None, fx=LARGER, fy=LARGER, interpolation=cv2.INTER_CUBIC), np.uint8)


def _dot(
    crop: UInt8[np.ndarray, "h w 3"],
    points: Float64[np.ndarray, "n 2"],
    corner: tuple[int, int],
    colour: tuple[int, int, int],
) -> None:
    at = np.rint((points - corner + 0.5) * LARGER - 0.5).astype(np.int64)
    for u, v in at[((at >= 0) & (at < crop.shape[1::-1])).all(axis=1)]:
        cv2.circle(crop, (int(u), int(v)), 1, colour, cv2.FILLED)


def _gap(beside: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h 6 3"]:
    return np.full((len(beside), 6, 3), 255, np.uint8)


if __name__ == "__main__":
    main()
