"""The scenes of a data folder, whatever their kind, in one form. See the README of the data for what they are."""

import csv
import json
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.camera.image_files import read_mask, read_pair, read_side_by_side
from benchmarks.board import LINES, board_edge
from benchmarks.occlusions import hiding_shaft
from schemas.messages import StereoCalibration
from shared.arc_length import even_parameters
from shared.calibration import read_calibration
from shared.calibration.uncertainty import ERRORS
from shared.rectification import rectification
from shared.splines import clamped_uniform_knots, evaluate

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]

SIM, REAL, CLEAR, CROSSING, OCCLUSION, HIDDEN, BOARD = (
    "ucsd sim",
    "ucsd real",
    "clear render",
    "crossing render",
    "occlusion render",
    "hidden render",
    "board",
)
RENDERS = (CLEAR, CROSSING, OCCLUSION, HIDDEN)
TRUTH_SAMPLES = 2000
HIDDEN_SCENES = 20
GREY_SIM, GREY_REAL = 200, 250
"""Pixels darker than these are the thread of the published scenes, on grey and on white."""


@dataclass(frozen=True)
class StraightEdge:
    """What is known of an edge of a board: see BoardEdge."""

    length_mm: float
    corners_mm: float
    slope_deg: float


@dataclass(frozen=True)
class Scene:
    """A stereo pair with what is known about it.

    Fields:
        group: the kind of scene, as the issue's table of goals tells them apart.
        masks: coverage by thread, as nearly true as is known, for evaluation; None where there is no thread.
        masks_are: where the masks come from.
        truth: points evenly spaced along the true thread, in the left rectified camera; None where unknown.
        visible: of each of them, whether the left and whether the right image shows it.
        published: figures of others on this scene, by column.
    """

    group: str
    name: str
    images: Pair
    calibration: StereoCalibration
    masks: Pair | None
    masks_are: str
    truth: Float64[np.ndarray, "n 3"] | None
    visible: Bool[np.ndarray, "n 2"] | None = None
    edge: StraightEdge | None = None
    published: dict[str, float | None] = field(default_factory=dict[str, float | None])


Loader = Callable[[], Scene]


def scenes(data: Path) -> Iterator[tuple[str, str, Loader]]:
    """All scenes under a data folder: name, group, and a function that loads it."""
    ucsd, renders, board = data / "ucsd_thread", data / "renders", data / "storz_calibration"
    published = _published(ucsd / "published_results.csv", "scene")
    for path in sorted((ucsd / "sim").glob("scene_*.npy")):
        yield f"{SIM} {path.stem[6:]}", SIM, lambda path=path: _ucsd_sim(path, published.get(path.stem[6:], {}))
    for path in sorted((ucsd / "real").glob("*_left.png")):
        yield f"{REAL} {path.stem[:-5]}", REAL, lambda path=path: _ucsd_real(path)
    peers = _published(renders / "peer_results.csv", "scene")
    clear: list[tuple[str, Loader]] = []
    for path in sorted(renders.glob("*.json")):
        kind, load = _kind(path), lambda path=path: _render(path, peers.get(path.stem, {}))
        clear += [(path.stem, load)] if kind == CLEAR else []
        yield f"{kind} {path.stem}", kind, load
    for count in range(HIDDEN_SCENES if clear else 0):
        (name, load), again = clear[count % len(clear)], count // len(clear)
        yield f"{HIDDEN} {name}_{again}", HIDDEN, lambda load=load, again=again: hidden(load(), again)
    for path in sorted(board.glob("*left.images.*.png")):
        for line in LINES:
            name = f"{path.stem.split('.')[-1]} {line[0]} {line[1]}"
            yield f"{BOARD} {name}", BOARD, lambda path=path, line=line, name=name: _board_edge(path, line, name)


def hidden(scene: Scene, again: int) -> Scene:
    """The scene with a tool in front of it that hides a third of the thread, another one for each `again`."""
    name = f"{scene.name}_{again}"
    assert scene.truth is not None and scene.masks is not None and scene.visible is not None
    camera = rectification(scene.calibration).camera
    shaft = hiding_shaft(camera, scene.truth, scene.visible, zlib.crc32(name.encode()))
    painted = [shaft.paint(*pair, eye) for eye, pair in enumerate(zip(scene.images, scene.masks, strict=True))]
    return replace(
        scene,
        group=HIDDEN,
        name=name,
        images=(painted[0][0], painted[1][0]),
        masks=(painted[0][1], painted[1][1]),
        visible=scene.visible & ~shaft.hides(camera, scene.truth),
        published={},
    )


def _kind(path: Path) -> str:
    about = json.loads(path.read_text())
    # renders of `suturegrasp scenes render` do not count their crossings
    if about.get("crossings_left", about["config"] == "crossing"):
        return CROSSING
    return OCCLUSION if about["config"] == "occlusion" else CLEAR


def _ucsd_sim(path: Path, published: dict[str, float | None]) -> Scene:
    name = path.stem[6:]
    image = next(p for p in path.parent.glob(f"{path.stem}.*") if p.suffix in (".png", ".jpg"))
    images = read_side_by_side(image)
    calibration = "calibration_scenes_1_3.yaml" if name[0] in "13" else "calibration_scenes_5_7_9.yaml"
    control_points = np.load(path)
    knots = clamped_uniform_knots(len(control_points))
    truth = evaluate(knots, control_points, 3, even_parameters(knots, control_points, 3, TRUTH_SAMPLES))
    return Scene(
        group=SIM,
        name=name,
        images=images,
        calibration=exact(_calibration(path.with_name(calibration), images, None)),
        masks=_darker_than(images, GREY_SIM),
        masks_are=f"grey<{GREY_SIM}",
        truth=truth,
        visible=np.ones((len(truth), 2), bool),
        published={
            "2023 mean": published.get("icra2023_published_mean_error"),
            "2025 mean": published.get("ral2025_code_rerun_mean_error"),
        },
    )


def _ucsd_real(path: Path) -> Scene:
    images = read_pair(path, path.with_name(path.name.replace("_left", "_right")))
    return Scene(
        group=REAL,
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
        group=_kind(path),
        name=path.stem,
        images=images,
        calibration=exact(_calibration(path, images, None)),
        masks=(
            read_mask(beside("mask_left"), "the left mask", width, height),
            read_mask(beside("mask_right"), "the right mask", width, height),
        ),
        masks_are="true",
        truth=samples[:, [columns.index(axis) for axis in "xyz"]].astype(np.float64),
        visible=samples[:, [columns.index("visible_left"), columns.index("visible_right")]] > 0,
        published={"2025 mean": peer.get("mean_mm")},
    )


def _board_edge(path: Path, line: tuple[str, int], name: str) -> Scene:
    edge = board_edge(path, *line)
    known = StraightEdge(edge.length_mm, edge.corners_mm, edge.slope_deg)
    return Scene(BOARD, name, edge.images, edge.calibration, edge.masks, "edge", None, edge=known)


def _calibration(path: Path, images: Pair, unit: str | None) -> StereoCalibration:
    height, width = images[0].shape[:2]
    return read_calibration(path, unit=unit, image_size=(width, height)).calibration


def exact(calibration: StereoCalibration) -> StereoCalibration:
    """The calibration of a camera that draws its images by it."""
    return replace(calibration, covariance=np.zeros((len(ERRORS), len(ERRORS))))


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
