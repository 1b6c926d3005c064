"""Edges of a calibration board as if they were threads: the only metric truth among real images.

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

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.camera.image_files import read_pair
from schemas.messages import RectifiedStereo, StereoCalibration
from shared.calibration import read_calibration
from shared.rectification import rectification, rectify_image

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

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]


@dataclass(frozen=True)
class BoardEdge:
    """A rectified pair with one edge drawn as a thread, and what is known of it.

    Fields:
        length_mm: as the board has it.
        corners_mm: as its two end corners have it, triangulated by themselves.
        slope_deg: of its picture against the rows.
    """

    images: Pair
    masks: Pair
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
) -> tuple[Pair, RectifiedStereo, tuple[Float64[np.ndarray, "r c 2"], Float64[np.ndarray, "r c 2"]]]:
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
