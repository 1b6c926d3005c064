"""The scenes of a data folder, whatever their kind, in one form. See the README of the data for what they are.

Each is run several times, by the masks and calibration that it is handed over with. Beside what lies in the folder
there are two kinds.

Tools painted in front of a render, so that they hide a stretch of its thread in both images as one body would.

A tool is a straight shaft with a round tip that comes in from outside the image, flat and parallel to the image plane,
nearer than any of the thread. So it has one disparity, larger than all of the thread's, and hides other places in the
right image than in the left one.

Edges of a calibration board as if they were threads: the only metric truth among real images.

Where squares of a chessboard meet, black turns to white along straight lines of known length. Each image is searched
for such an edge by itself: from one corner to the next, across the line between them, and pixel by pixel the edge is
where the brightness changes. Along these places a dark thread is drawn into the image and into its mask. So its course
carries the errors of a real lens, sensor and calibration, and nothing of the board's geometry but which corners it
runs between.

A camera's sharpening and blooming make white squares larger or smaller, in these images by up to half a pixel on each
side, and in the left one otherwise than in the right one. As black and white change sides from square to square, that
bends a straight edge into a zigzag. It is told by just that, one number for all edges of a direction in an image, and
taken out; what is left is not touched.
"""

import csv
import json
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.camera.image_files import read_mask, read_pair, read_side_by_side
from schemas.messages import RectifiedStereo, StereoCalibration
from shared.arc_length import even_parameters
from shared.calibration import read_calibration
from shared.calibration.uncertainty import ERRORS
from shared.camera import project
from shared.rectification import rectification, rectify_image
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


NONE, BINARY = "none", "binary"
SEGMENTED = 128
FOCAL_SHARE, ROWS_PX, TURN_DEG = 1e-3, 0.3, 0.1
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Run:
    """A scene with the masks and the calibration to be used for it.

    Fields:
        masks: None where the images have to be segmented.
        masks_are: `none` then, otherwise where they come from.
        calibration_is: what is wrong with the calibration, empty where nothing is.
        R_rectified_camera: how that turns the frame of the result against the frame of the truth.
    """

    scene: Scene
    masks: Pair | None
    masks_are: str
    calibration: StereoCalibration
    calibration_is: str = ""
    R_rectified_camera: Float64[np.ndarray, "3 3"] | None = None


def runs(scene: Scene) -> Iterator[Run]:
    """Every way in which a scene is run."""
    if scene.group not in (HIDDEN, BOARD):
        yield Run(scene, None, NONE, scene.calibration)
    if scene.masks is None:
        return
    yield Run(scene, scene.masks, scene.masks_are, scene.calibration)
    if scene.group != CLEAR:
        return
    binary = [np.where(mask >= SEGMENTED, 255, 0).astype(np.uint8) for mask in scene.masks]
    yield Run(scene, (binary[0], binary[1]), BINARY, scene.calibration)
    for name, wrong in wrong_calibrations(scene.calibration):
        yield Run(scene, scene.masks, scene.masks_are, wrong, name, _turn_of_left(wrong))


def wrong_calibrations(calibration: StereoCalibration) -> Iterator[tuple[str, StereoCalibration]]:
    """The calibration with one error each, of the size that a careful calibration still has."""
    calibration = replace(calibration, covariance=None)
    focal = np.diag([1.0 + FOCAL_SHARE, 1.0 + FOCAL_SHARE, 1.0])
    # K diag(k, k, 1) scales the focal lengths and leaves the principal point
    yield "f 0.1 %", replace(calibration, K_left=calibration.K_left @ focal, K_right=calibration.K_right @ focal)
    rows = np.array(calibration.K_right)
    rows[1, 2] += ROWS_PX
    yield "rows 0.3 px", replace(calibration, K_right=rows)
    for axis, direction in AXES.items():
        turned = np.array(calibration.T_right_left)
        turned[:3, :3] = cv2.Rodrigues(np.radians(TURN_DEG) * np.array(direction))[0] @ turned[:3, :3]
        yield f"{axis} 0.1°", replace(calibration, T_right_left=turned)


def _turn_of_left(calibration: StereoCalibration) -> Float64[np.ndarray, "3 3"]:
    """How rectification turns the left camera: R_rectified_left, by the same OpenCV call as in the pipeline."""
    distortion = [
        np.array(d) if len(d) else np.zeros(5) for d in (calibration.distortion_left, calibration.distortion_right)
    ]
    size = (calibration.image_width, calibration.image_height)
    R, t = np.array(calibration.T_right_left[:3, :3]), calibration.T_right_left[:3, 3:].copy()
    K_left, K_right = np.array(calibration.K_left), np.array(calibration.K_right)
    return np.asarray(cv2.stereoRectify(K_left, distortion[0], K_right, distortion[1], size, R, t, alpha=-1)[0])


LEAST_HIDDEN, MOST_HIDDEN = 0.30, 0.45
"""Share of the thread that either image misses."""
END_SHARE = 0.05
"""Of the thread at either end, which stays visible: nobody can know how far a thread goes on behind a tool."""
NEARER = 0.92
"""Depth of the tool as a share of the thread's nearest."""
TRIES, CANDIDATES = 2000, 4
REACH_PX = 4000.0
EDGE_PX = 1.0
"""Half the width over which the tool's border blends with what lies behind it."""


@dataclass(frozen=True)
class Shaft:
    """A tool in pixels of the left image; in the right image it lies `disparity_px` further left."""

    tip: Float64[np.ndarray, "2"]
    direction: Float64[np.ndarray, "2"]
    half_width_px: float
    disparity_px: float

    def distance(self, px: Float64[np.ndarray, "n 2"], eye: int) -> Float64[np.ndarray, "n"]:
        """How far pixels of an image lie from the shaft's axis."""
        offset = px - self.tip + (eye * self.disparity_px, 0.0)
        along = np.clip(offset @ self.direction, 0.0, REACH_PX)
        return np.linalg.norm(offset - along[:, None] * self.direction, axis=1)

    def hides(self, camera: RectifiedStereo, points: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n 2"]:
        """Which points the tool hides from the left and from the right camera."""
        distance = [self.distance(px, eye) for eye, px in enumerate(project(camera, points))]
        return np.column_stack(distance) < self.half_width_px

    def paint(
        self, image: UInt8[np.ndarray, "h w 3"], mask: UInt8[np.ndarray, "h w"], eye: int
    ) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w"]]:
        """The image with the tool in it, and the mask without what it hides."""
        height, width = mask.shape
        v, u = np.mgrid[:height, :width].astype(np.float64)
        distance = self.distance(np.column_stack((u.ravel(), v.ravel())), eye).reshape(height, width)
        cover = np.clip(0.5 + 0.5 * (self.half_width_px - distance) / EDGE_PX, 0.0, 1.0)
        # a metal cylinder, lit from the front: bright along its axis, dark at its borders
        shade = 40.0 + 150.0 * np.sqrt(np.clip(1.0 - (distance / self.half_width_px) ** 2, 0.0, 1.0))
        metal = shade[..., None] * (1.0, 0.97, 0.94)
        blended = cover[..., None] * metal + (1.0 - cover[..., None]) * image
        return np.rint(blended).astype(np.uint8), np.rint((1.0 - cover) * mask).astype(np.uint8)


def hiding_shaft(
    camera: RectifiedStereo, truth: Float64[np.ndarray, "n 3"], visible: Bool[np.ndarray, "n 2"], seed: int
) -> Shaft:
    """A tool that hides 30 to 45 % of a thread from either camera, and no end of it.

    Each tool drawn from the seed has just the width that hides enough; of the first few that do, the thinnest is taken.

    Raises:
        ValueError: where none of them leaves both ends in sight.
    """
    random = np.random.default_rng(seed)
    pixels = project(camera, truth)
    disparity = camera.fx_px * camera.baseline / (NEARER * float(truth[:, 2].min()))
    end = max(1, round(END_SHARE * len(truth)))
    found: list[Shaft] = []
    for _ in range(TRIES):
        angle, over = random.uniform(0.0, 2.0 * np.pi), random.uniform(0.0, 60.0)
        direction = np.array([np.cos(angle), np.sin(angle)])
        passes = pixels[0][int(random.uniform(0.2, 0.8) * len(truth))]
        axis = Shaft(passes - over * direction, direction, 1.0, disparity)
        distance = np.column_stack([axis.distance(px, eye) for eye, px in enumerate(pixels)])
        half_width = float(np.quantile(np.where(visible, distance, -1.0), LEAST_HIDDEN, axis=0).max()) + EDGE_PX
        shaft = Shaft(axis.tip, direction, half_width, disparity)
        covered = distance < half_width
        missed = (covered | ~visible).mean(axis=0)
        if (missed <= MOST_HIDDEN).all() and not (covered[:end].any() or covered[-end:].any()):
            found.append(shaft)
        if len(found) == CANDIDATES:
            break
    if not found:
        raise ValueError("no tool hides enough of this thread and leaves both ends in sight")
    return min(found, key=lambda shaft: shaft.half_width_px)


CORNERS = (13, 8)
"""Inner corners along a row and along a column of the chessboard: it has 14 x 9 squares."""
SQUARE_MM = 3.0
LINES = tuple(("row", index) for index in (1, 3, 4, 6)) + tuple(("column", index) for index in (1, 4, 6, 8, 11))
"""Two squares meet along each of these, one of either colour, which change sides from square to square."""
ACROSS_PX = 6.0
CORNER_SHARE = 0.15
"""Of a square's side next to each corner, where the edge fades into the crossing one; bridged by a straight line."""
HALF_WIDTH_PX = 2.0
THREAD_BGR = (90.0, 40.0, 70.0)

Drawn = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]


@dataclass(frozen=True)
class BoardEdge:
    """A rectified pair with one edge drawn as a thread, and what is known of it.

    Fields:
        length_mm: as the board has it.
        corners_mm: as its two end corners have it, triangulated by themselves.
        slope_deg: of its picture against the rows.
    """

    images: Drawn
    masks: Drawn
    calibration: StereoCalibration
    length_mm: float
    corners_mm: float
    slope_deg: float


def board_edge(left: Path, direction: str, index: int) -> BoardEdge:
    """One line of a board, by the number of its row or column of inner corners."""
    images, camera, corners = rectified_board(left)
    lines = [_line(grid, direction, index) for grid in corners]
    blooms = _blooms(left, direction)
    drawn = [draw_thread(*of) for of in zip(images, map(edge_places, images, lines, blooms), strict=True)]
    ends = [line[[0, -1]] for line in lines]
    z = camera.fx_px * camera.baseline / (ends[0][:, 0] - ends[1][:, 0])
    across = (ends[0] - (camera.cx_px, camera.cy_px)) * z[:, None] / camera.fx_px
    du, dv = np.abs(lines[0][-1] - lines[0][0])
    return BoardEdge(
        images=(drawn[0][0], drawn[1][0]),
        masks=(drawn[0][1], drawn[1][1]),
        calibration=_rectified(camera),
        length_mm=(len(lines[0]) - 1) * SQUARE_MM,
        corners_mm=float(np.linalg.norm(np.diff(np.column_stack((across, z)), axis=0))),
        slope_deg=float(np.degrees(np.arctan2(dv, du))),
    )


@cache
def rectified_board(
    left: Path,
) -> tuple[Drawn, RectifiedStereo, tuple[Float64[np.ndarray, "r c 2"], Float64[np.ndarray, "r c 2"]]]:
    """The rectified pair, its camera, and the inner corners in both images, one row of the board after the other."""
    images = read_pair(left, left.with_name(left.name.replace("left", "right")))
    height, width = images[0].shape[:2]
    to_rectified = rectification(read_calibration(left.parent, unit="mm", image_size=(width, height)).calibration)
    pair = rectify_image(images[0], to_rectified.map_left), rectify_image(images[1], to_rectified.map_right)
    return pair, to_rectified.camera, (_corners(pair[0]), _corners(pair[1]))


def edge_places(
    image: UInt8[np.ndarray, "h w 3"], corners: Float64[np.ndarray, "n 2"], bloom_px: float = 0.0
) -> Float64[np.ndarray, "p 2"]:
    """Where the brightness changes between neighbouring corners, one place to a pixel of length; the ends are corners.

    Each is the centroid of the squared slope of the brightness across the line, less how far white has bloomed.
    """
    places = [corners[:1]]
    for on_line, normal, offset, brighter in _crossings(image, corners):
        # white that is larger moves the edge to the dark side
        places.append(on_line + (offset + bloom_px * brighter)[:, None] * normal)
    return np.vstack((*places, corners[-1:]))


@cache
def _blooms(left: Path, direction: str) -> tuple[float, float]:
    """How many pixels white squares are too large on each side, in the left and in the right image."""
    images, _, grids = rectified_board(left)
    found: list[float] = []
    for image, grid in zip(images, grids, strict=True):
        lines = [_line(grid, direction, index) for along, index in LINES if along == direction]
        moved = [-brighter * offset.mean() for line in lines for *_, offset, brighter in _crossings(image, line)]
        found.append(float(np.mean(moved)))
    return found[0], found[1]


def _line(grid: Float64[np.ndarray, "r c 2"], direction: str, index: int) -> Float64[np.ndarray, "n 2"]:
    return grid[index] if direction == "row" else grid[:, index]


Crossed = tuple[Float64[np.ndarray, "k 2"], Float64[np.ndarray, "2"], Float64[np.ndarray, "k"], int]


def _crossings(image: UInt8[np.ndarray, "h w 3"], corners: Float64[np.ndarray, "n 2"]) -> Iterator[Crossed]:
    """For each square: places on the line between its corners, its normal, how far along that the edge lies, and on
    which side it is brighter."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    across = np.arange(-ACROSS_PX, ACROSS_PX + 0.25, 0.5)
    for start, end in pairwise(corners):
        length = float(np.linalg.norm(end - start))
        along = (end - start) / length
        normal = np.array([-along[1], along[0]])
        at = np.arange(CORNER_SHARE * length, (1.0 - CORNER_SHARE) * length)
        on_line = start + at[:, None] * along
        grid = (on_line[:, None] + across[:, None] * normal).astype(np.float32)
        u, v = np.ascontiguousarray(grid[..., 0]), np.ascontiguousarray(grid[..., 1])
        profile = cv2.remap(grey, u, v, cv2.INTER_LINEAR).astype(np.float64)
        steepness = np.gradient(profile, axis=1) ** 2
        offset = steepness @ across / np.maximum(steepness.sum(axis=1), 1e-9)
        yield on_line, normal, offset, 1 if profile[:, -1].mean() > profile[:, 0].mean() else -1


def draw_thread(
    image: UInt8[np.ndarray, "h w 3"], line: Float64[np.ndarray, "p 2"]
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w"]]:
    """The image with a thread along a line, cut off square at its ends, and its mask."""
    height, width = image.shape[:2]
    low = np.maximum(np.floor(line.min(axis=0)).astype(int) - 6, 0)
    high = np.minimum(np.ceil(line.max(axis=0)).astype(int) + 7, (width, height))
    v, u = np.mgrid[low[1] : high[1], low[0] : high[0]].astype(np.float64)
    distance = np.full(u.shape, np.inf)
    for start, end in pairwise(line):
        # only what is near a piece, which is about a pixel long, can be coloured by it
        near = 2 + HALF_WIDTH_PX + np.abs(end - start).max()
        part = tuple(
            slice(max(int(c - near - o), 0), int(c + near - o) + 2)
            for c, o in zip(start[::-1], low[::-1].astype(float), strict=True)
        )
        along, du, dv = end - start, u[part] - start[0], v[part] - start[1]
        share = np.clip((du * along[0] + dv * along[1]) / max(float(along @ along), 1e-12), 0.0, 1.0)
        distance[part] = np.minimum(distance[part], np.hypot(du - share * along[0], dv - share * along[1]))
    cover = np.clip(HALF_WIDTH_PX + 0.5 - distance, 0.0, 1.0)
    for end, inside in ((line[0], line[5]), (line[-1], line[-6])):
        inward = (inside - end) / np.linalg.norm(inside - end)
        before = (u - end[0]) * inward[0] + (v - end[1]) * inward[1]
        cover *= np.clip(0.5 + before, 0.0, 1.0)
    painted, mask = image.copy(), np.zeros((height, width), np.uint8)
    window = slice(low[1], high[1]), slice(low[0], high[0])
    painted[window] = np.rint(cover[..., None] * THREAD_BGR + (1.0 - cover[..., None]) * image[window])
    mask[window] = np.rint(255.0 * cover)
    return painted, mask


def _corners(image: UInt8[np.ndarray, "h w 3"]) -> Float64[np.ndarray, "r c 2"]:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(grey, CORNERS, flags=flags)
    assert found, "the chessboard was not found in a rectified image"
    return np.asarray(corners, np.float64).reshape(CORNERS[1], CORNERS[0], 2)


def _rectified(camera: RectifiedStereo) -> StereoCalibration:
    """The calibration of images that are rectified already."""
    K = np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])
    T_right_left = np.eye(4)
    T_right_left[0, 3] = -camera.baseline
    return StereoCalibration(
        image_width=camera.image_width,
        image_height=camera.image_height,
        K_left=K,
        distortion_left=np.zeros(0),
        K_right=K,
        distortion_right=np.zeros(0),
        T_right_left=T_right_left,
        metres_per_unit=camera.metres_per_unit,
    )
