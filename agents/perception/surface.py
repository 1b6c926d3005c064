"""Coarse depth of the tissue around the thread, from the rectified pair (semi-global matching, OpenCV's StereoSGBM).

The images are reduced, since the grid is coarse. Disparities that the right image does not confirm are dropped by the
matcher's own left-right check; those on the thread and beside it are dropped too, where windows mix thread and ground.
Each cell of the grid has the median of what is left in it, and is not valid where that is too little.

What a matcher interpolates between whole disparities is drawn towards them. So the pair is matched twice, the second
time with the right image moved by half a pixel, where the same pull points the other way; their mean is nearly free of
it. The deviation of a cell's disparity is

    σ² = σ₀² + (c s)²

with s the spread (median absolute deviation, scaled to a normal one) of the cell's pixels about a plane, and c and σ₀
as they were found on rendered scenes: semi-global matching hands errors on from pixel to pixel,
so that a median of many is hardly surer than one. Depth has σ z / δ.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from schemas.messages import FrameStamp, RectifiedStereo, TissueSurface
from shared.camera import depth_of_disparity

WIDTH_PX = 480
"""Of the reduced images: disparities are then good to a fraction of a pixel, and take some ten milliseconds."""
CELL_PX = 12
"""Of the reduced images: the sides of a cell."""
WINDOW_PX = 5
LEAST_SHARE = 0.3
"""Of a cell's pixels: fewer measured ones leave it invalid."""
LEAST_CHANGE, TEXTURE_STEP_PX = 1.5, 4
"""Grey levels by which the ground must change over so many pixels, on average over a cell."""
THREAD_MARGIN_PX = 3
"""Beside the thread, in the reduced image: half the window, and what blur adds."""
PARTS_OF_A_PIXEL = 16
"""StereoSGBM gives disparities in these."""
SHIFT_PX = 0.5
"""Of the right image for the second matching."""
MOST_APART_PX = 1.0
"""Two matchings that differ by more have found different places."""
MOST_UNLIKE_PX = 2.0
"""From a cell to that of its neighbours that is most like it."""
USUAL_REACH_SHARE = 0.125
"""Of the width: the largest disparity that is looked at where the pair does not show how large they are."""
MARGIN_PX = 4
"""Of disparities beyond those that the images show at half their size."""
SLOPE_CAP = 31
"""Slopes of the brightness are cut off there before they are compared, so that glints do not count for all."""
FLOOR_PX, SPREAD_SHARE = 0.05, 0.65
"""σ₀ and c, in pixels of the reduced images."""
NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class _Cells:
    """The disparity of each cell in pixels of the reduced image with its deviation; NaN where it is not known."""

    disparity_px: Float64[np.ndarray, "r c"]
    deviation_px: Float64[np.ndarray, "r c"]


def tissue_surface(
    stamp: FrameStamp,
    camera: RectifiedStereo,
    left: UInt8[np.ndarray, "h w 3"],
    right: UInt8[np.ndarray, "h w 3"],
    thread: Bool[np.ndarray, "h w"],
    shown_px: Float64[np.ndarray, "2"] | None = None,
) -> TissueSurface:
    """The depth of the tissue that both eyes see, in cells of the left image.

    Args:
        thread: pixels of the left image that are thread, or an instrument.
        shown_px: least and greatest disparity, as far as the pair shows them.
    """
    share = min(1.0, WIDTH_PX / camera.image_width)
    disparity = _disparity(
        _reduced(left, share), _reduced(right, share), _reach_px(shown_px, camera.image_width) * share
    )
    height, width = disparity.shape
    own = cv2.resize(thread.astype(np.uint8), (width, height), interpolation=cv2.INTER_AREA)
    near_thread = cv2.dilate((own > 0).astype(np.uint8), np.ones((2 * THREAD_MARGIN_PX + 1,) * 2, np.uint8)) > 0
    disparity[near_thread] = np.nan
    cells = _cells(disparity)
    valid = np.isfinite(cells.disparity_px)
    depth, deviation = np.zeros(valid.shape), np.zeros(valid.shape)
    depth[valid] = depth_of_disparity(camera, cells.disparity_px[valid] / share)
    deviation[valid] = depth[valid] * cells.deviation_px[valid] / cells.disparity_px[valid]
    rows, columns = valid.shape
    u, v = (((np.arange(count) + 0.5) * CELL_PX) / share - 0.5 for count in (columns, rows))
    return TissueSurface(stamp, camera, u, v, depth, valid, deviation)


def _reach_px(shown_px: Float64[np.ndarray, "2"] | None, width: int) -> float:
    """The largest disparity that is looked at."""
    return USUAL_REACH_SHARE * width if shown_px is None else float(shown_px[1])


def _reduced(image: UInt8[np.ndarray, "h w 3"], share: float) -> UInt8[np.ndarray, "h w"]:
    size = max(1, round(image.shape[1] * share)), max(1, round(image.shape[0] * share))
    return cv2.resize(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), size, interpolation=cv2.INTER_AREA)


def _disparity(
    left: UInt8[np.ndarray, "h w"], right: UInt8[np.ndarray, "h w"], reach_px: float
) -> Float64[np.ndarray, "h w"]:
    """Disparity of each pixel in this image's own pixels, the mean of both matchings; NaN where it is not known."""
    reach = _sixteens(round(reach_px))
    if left.shape[1] <= reach + WINDOW_PX:
        return np.full(left.shape, np.nan)
    least, count = _range(left, right, reach)
    shift = np.array([[1.0, 0.0, SHIFT_PX], [0.0, 1.0, 0.0]])
    moved = cv2.warpAffine(right, shift, right.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
    once, again = (_matched(left, np.asarray(image), least, count) for image in (right, moved))
    again += SHIFT_PX
    return np.where((np.abs(once - again) <= MOST_APART_PX) & _textured(left), 0.5 * (once + again), np.nan)


def _range(left: UInt8[np.ndarray, "h w"], right: UInt8[np.ndarray, "h w"], reach: int) -> tuple[int, int]:
    """The least disparity and how many from there on hold all that a match of the images at half their size finds.

    A field fills a small part of what is possible, and time goes with their number.
    """
    left, right = (cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for image in (left, right))
    found = 2.0 * _matched(np.asarray(left), np.asarray(right), 0, _sixteens(reach // 2))
    found = found[np.isfinite(found)]
    if not len(found):
        return 0, reach
    least = max(0, int(found.min()) - MARGIN_PX)
    return least, min(_sixteens(int(found.max()) + MARGIN_PX - least), _sixteens(reach - least))


def _sixteens(disparities: int) -> int:
    """As many, in the sixteens that StereoSGBM wants."""
    return 16 * max(1, -(-disparities // 16))


def _matched(
    left: UInt8[np.ndarray, "h w"], right: UInt8[np.ndarray, "h w"], least: int, count: int
) -> Float64[np.ndarray, "h w"]:
    matcher = cv2.StereoSGBM.create(
        minDisparity=least,
        numDisparities=count,
        blockSize=WINDOW_PX,
        P1=2 * WINDOW_PX**2,
        P2=8 * WINDOW_PX**2,
        disp12MaxDiff=1,
        preFilterCap=SLOPE_CAP,
        uniquenessRatio=20,
        speckleWindowSize=60,
        speckleRange=2,
    )
    # the leftmost pixels have their counterparts beyond the border, so that the border is moved out and its own dropped
    out = least + count
    padded = [cv2.copyMakeBorder(image, 0, 0, out, 0, cv2.BORDER_REPLICATE) for image in (left, right)]
    found = np.asarray(matcher.compute(*padded))[:, out:] / PARTS_OF_A_PIXEL
    beyond = found > np.arange(left.shape[1])[None, :]
    return np.where((found >= max(least, 1)) & ~beyond, found, np.nan)


def _textured(image: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Where the image changes along its rows by more than noise: elsewhere the matcher only spreads its neighbours."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)
    change = np.abs(smooth - np.roll(smooth, TEXTURE_STEP_PX, axis=1))
    return cv2.blur(change, (CELL_PX, CELL_PX)) > LEAST_CHANGE


def _cells(disparity: Float64[np.ndarray, "h w"]) -> _Cells:
    """The median of each cell, and its deviation by the spread about a plane through the cells beside it."""
    rows, columns = (side // CELL_PX for side in disparity.shape)
    whole = disparity[: rows * CELL_PX, : columns * CELL_PX].reshape(rows, CELL_PX, columns, CELL_PX)
    cells = whole.transpose(0, 2, 1, 3).reshape(rows, columns, CELL_PX**2)
    enough = np.isfinite(cells).sum(axis=2) >= LEAST_SHARE * CELL_PX**2
    medians = _supported(np.where(enough, _medians(cells), np.nan))
    v, u = (offset.ravel() - 0.5 * (CELL_PX - 1) for offset in np.mgrid[:CELL_PX, :CELL_PX])
    across, down = (_slopes(medians, axis)[:, :, None] for axis in (1, 0))
    spread = NORMAL_MAD * _medians(np.abs(cells - medians[:, :, None] - across * u - down * v))
    return _Cells(medians, np.hypot(FLOOR_PX, SPREAD_SHARE * spread))


def _medians(cells: Float64[np.ndarray, "r c p"]) -> Float64[np.ndarray, "r c"]:
    """The median of what is known in each cell; NaN where nothing is."""
    ordered = np.sort(cells, axis=2)
    known = np.isfinite(cells).sum(axis=2)
    return np.take_along_axis(ordered, np.maximum(known - 1, 0)[:, :, None] // 2, axis=2)[:, :, 0]


def _supported(medians: Float64[np.ndarray, "r c"]) -> Float64[np.ndarray, "r c"]:
    """Without cells that are unlike all that lie beside them: tissue and tools go on there, false matches seldom do."""
    rows, columns = medians.shape
    around = np.pad(medians, 1, constant_values=np.nan)
    like = np.zeros(medians.shape, bool)
    for down, along in (place for place in np.ndindex(3, 3) if place != (1, 1)):
        like |= np.abs(around[down : down + rows, along : along + columns] - medians) <= MOST_UNLIKE_PX
    return np.where(like, medians, np.nan)


def _slopes(medians: Float64[np.ndarray, "r c"], axis: int) -> Float64[np.ndarray, "r c"]:
    """Change for each pixel along an axis, from the known ones of the two cells beside each; 0 where neither is."""
    if medians.shape[axis] < 2:
        return np.zeros(medians.shape)
    step = np.diff(medians, axis=axis) / CELL_PX
    beside = [np.insert(step, end, np.nan, axis=axis) for end in (0, step.shape[axis])]
    known = np.isfinite(beside).sum(axis=0)
    return np.nansum(beside, axis=0) / np.maximum(known, 1)
