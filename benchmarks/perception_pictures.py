"""What was found, missed and false of a thread, drawn over both images."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8
from scipy.spatial import KDTree

from agents.cli.reconstruct.pipeline import PipelineResult
from benchmarks.centreline_share import NEAR_PX
from benchmarks.scenes import Scene
from schemas.messages import Centrelines
from shared.camera import project

RIGHT, MISSED, FALSE = (0, 255, 0), (0, 0, 255), (0, 255, 255)
"""Blue first: green, red and yellow."""


def save_finding(path: Path, scene: Scene, result: PipelineResult) -> None:
    """Write both images side by side: right centrelines green, false ones yellow, missed truth red."""
    assert scene.truth is not None and scene.visible is not None
    seen = result.observations
    lines = seen.centrelines_left, seen.centrelines_right
    truth = project(seen.camera, scene.truth)
    drawn = [drawn_over(*eye) for eye in zip(result.images, lines, truth, scene.visible.T, strict=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.hstack(drawn))


def save_false(path: Path, result: PipelineResult) -> None:
    """Write both images of a scene without thread side by side, with what was taken for thread in yellow."""
    seen, nowhere = result.observations, np.zeros((0, 2))
    lines = seen.centrelines_left, seen.centrelines_right
    drawn = [
        drawn_over(image, of_eye, nowhere, np.zeros(0, bool))
        for image, of_eye in zip(result.images, lines, strict=True)
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.hstack(drawn))


def drawn_over(
    image: UInt8[np.ndarray, "h w 3"],
    lines: Centrelines,
    truth_px: Float64[np.ndarray, "m 2"],
    visible: Bool[np.ndarray, "m"],
) -> UInt8[np.ndarray, "h w 3"]:
    """One image with the places that were found in it, and those of the visible truth that were missed."""
    drawn = image.copy()
    for points, colour in zip(told_apart(lines, truth_px, visible), (RIGHT, FALSE, MISSED), strict=True):
        _dots(drawn, points, colour)
    return drawn


def told_apart(
    lines: Centrelines, truth_px: Float64[np.ndarray, "m 2"], visible: Bool[np.ndarray, "m"]
) -> tuple[Float64[np.ndarray, "r 2"], Float64[np.ndarray, "f 2"], Float64[np.ndarray, "k 2"]]:
    """What was found in one image: right and false places of it, and those of the visible truth that were missed."""
    points, true = lines.point_px, truth_px[visible]
    if not (len(points) and len(true)):
        return np.zeros((0, 2)), points, true
    missed = np.asarray(KDTree(points).query(true)[0]) > NEAR_PX
    false = np.asarray(KDTree(true).query(points)[0]) > NEAR_PX
    return points[~false], points[false], true[missed]


def _dots(image: UInt8[np.ndarray, "h w 3"], points: Float64[np.ndarray, "n 2"], colour: tuple[int, int, int]) -> None:
    at = np.rint(points).astype(np.int64)
    inside = ((at >= 0) & (at < image.shape[1::-1])).all(axis=1)
    image[at[inside, 1], at[inside, 0]] = colour
