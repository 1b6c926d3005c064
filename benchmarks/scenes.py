"""The scenes of a data folder, whatever their kind, in one form. See the README of the data for what they are."""

import csv
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.camera.image_files import read_mask, read_pair, read_side_by_side
from schemas.messages import StereoCalibration
from shared.arc_length import even_parameters
from shared.calibration import read_calibration
from shared.splines import clamped_uniform_knots, evaluate

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]

TRUTH_SAMPLES = 2000
GREY_SIM, GREY_REAL = 200, 250
"""Pixels darker than these are the thread of the published scenes, on grey and on white."""


@dataclass(frozen=True)
class Scene:
    """A stereo pair with what is known about it.

    Fields:
        masks: coverage by thread, as nearly true as is known, for evaluation; None where there is no thread.
        masks_are: where the masks come from.
        truth: points evenly spaced along the true thread, in the left rectified camera; None where unknown.
        published: figures of others on this scene, by column.
    """

    group: str
    name: str
    images: Pair
    calibration: StereoCalibration
    masks: Pair | None
    masks_are: str
    truth: Float64[np.ndarray, "n 3"] | None
    published: dict[str, float | None] = field(default_factory=dict[str, float | None])


def scenes(data: Path) -> Iterator[tuple[str, Callable[[], Scene]]]:
    """Names of all scenes under a data folder, each with a function that loads it."""
    ucsd, renders, board = data / "ucsd_thread", data / "renders", data / "storz_calibration"
    published = _published(ucsd / "published_results.csv", "scene")
    for path in sorted((ucsd / "sim").glob("scene_*.npy")):
        yield f"ucsd sim {path.stem[6:]}", lambda path=path: _ucsd_sim(path, published.get(path.stem[6:], {}))
    for path in sorted((ucsd / "real").glob("*_left.png")):
        yield f"ucsd real {path.stem[:-5]}", lambda path=path: _ucsd_real(path)
    peers = _published(renders / "peer_results.csv", "scene")
    for path in sorted(renders.glob("*.json")):
        yield f"renders {path.stem}", lambda path=path: _render(path, peers.get(path.stem, {}))
    for path in sorted(board.glob("*left.images.*.png")):
        yield f"board {path.stem.split('.')[-1]}", lambda path=path: _board(path)


def _ucsd_sim(path: Path, published: dict[str, float | None]) -> Scene:
    name = path.stem[6:]
    image = next(p for p in path.parent.glob(f"{path.stem}.*") if p.suffix in (".png", ".jpg"))
    images = read_side_by_side(image)
    calibration = "calibration_scenes_1_3.yaml" if name[0] in "13" else "calibration_scenes_5_7_9.yaml"
    control_points = np.load(path)
    knots = clamped_uniform_knots(len(control_points))
    truth = evaluate(knots, control_points, 3, even_parameters(knots, control_points, 3, TRUTH_SAMPLES))
    return Scene(
        group="ucsd sim",
        name=name,
        images=images,
        calibration=_calibration(path.with_name(calibration), images, None),
        masks=_darker_than(images, GREY_SIM),
        masks_are=f"grey<{GREY_SIM}",
        truth=truth,
        published={
            "2023 mean": published.get("icra2023_published_mean_error"),
            "2025 mean": published.get("ral2025_code_rerun_mean_error"),
        },
    )


def _ucsd_real(path: Path) -> Scene:
    images = read_pair(path, path.with_name(path.name.replace("_left", "_right")))
    return Scene(
        group="ucsd real",
        name=path.stem[:-5],
        images=images,
        calibration=_calibration(path.with_name("calibration.yaml"), images, "mm"),
        masks=_darker_than(images, GREY_REAL),
        masks_are=f"grey<{GREY_REAL}",
        truth=None,
    )


def _render(path: Path, peer: dict[str, float | None]) -> Scene:
    def beside(ending: str) -> Path:
        return path.with_name(f"{path.stem}_{ending}.png")

    images = read_pair(beside("left"), beside("right"))
    height, width = images[0].shape[:2]
    columns: list[str] = json.loads(path.read_text())["npy_columns"]
    samples = np.load(path.with_suffix(".npy"))
    return Scene(
        group="renders",
        name=path.stem,
        images=images,
        calibration=_calibration(path, images, None),
        masks=(
            read_mask(beside("mask_left"), "the left mask", width, height),
            read_mask(beside("mask_right"), "the right mask", width, height),
        ),
        masks_are="true",
        truth=samples[:, [columns.index(axis) for axis in "xyz"]].astype(np.float64),
        published={"2025 mean": peer.get("mean_mm")},
    )


def _board(path: Path) -> Scene:
    images = read_pair(path, path.with_name(path.name.replace("left", "right")))
    calibration = _calibration(path.parent, images, "mm")
    return Scene("board", path.stem.split(".")[-1], images, calibration, None, "", None)


def _calibration(path: Path, images: Pair, unit: str | None) -> StereoCalibration:
    height, width = images[0].shape[:2]
    return read_calibration(path, unit=unit, image_size=(width, height)).calibration


def _darker_than(images: Pair, grey: int) -> Pair:
    def mask(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
        return np.where(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) < grey, 255, 0).astype(np.uint8)

    return mask(images[0]), mask(images[1])


def _published(path: Path, key: str) -> dict[str, dict[str, float | None]]:
    """Rows of a table of figures by scene; what is no number (a failure) is None."""
    if not path.is_file():
        return {}

    def number(text: str) -> float | None:
        return float(text) if text.replace(".", "", 1).isdigit() else None

    with path.open(newline="") as file:
        return {row[key]: {k: number(v) for k, v in row.items() if k != key} for row in csv.DictReader(file)}
