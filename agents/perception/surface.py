"""Coarse depth of the tissue around the thread, from the rectified pair (semi-global matching, OpenCV's StereoSGBM).

The images are reduced, since the grid is coarse. Disparities that the right image does not confirm are dropped by the
matcher's own left-right check; those on the thread and beside it are dropped too, where windows mix thread and ground.
Each cell of the grid has the median of what is left in it, and is not valid where that is too little.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.perception.matching import largest_disparity_px
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
FRAMES_BETWEEN_SURFACES = 10
"""Of the camera."""
LEAST_FRAMES_WITHOUT = 4
"""For each surface so many frames at least are looked at, where many of the camera's are left out."""
PARTS_OF_A_PIXEL = 16
"""StereoSGBM gives disparities in these."""


def surface_is_due(stamp: FrameStamp, before: FrameStamp | None) -> bool:
    """Whether a frame is the first of so many for which a surface is made; `before` was looked at before it."""
    if before is None:
        # the first frame of all already takes longest
        return False
    period = max(FRAMES_BETWEEN_SURFACES, LEAST_FRAMES_WITHOUT * abs(stamp.sequence - before.sequence))
    return before.sequence // period != stamp.sequence // period


def tissue_surface(
    stamp: FrameStamp,
    camera: RectifiedStereo,
    left: UInt8[np.ndarray, "h w 3"],
    right: UInt8[np.ndarray, "h w 3"],
    thread: Bool[np.ndarray, "h w"],
) -> TissueSurface:
    """The depth of the tissue that both eyes see, in cells of the left image.

    Args:
        thread: pixels of the left image that are thread.
    """
    share = min(1.0, WIDTH_PX / camera.image_width)
    disparity = _disparity(_reduced(left, share), _reduced(right, share), share * camera.image_width) / share
    height, width = disparity.shape
    own = cv2.resize(thread.astype(np.uint8), (width, height), interpolation=cv2.INTER_AREA)
    near_thread = cv2.dilate((own > 0).astype(np.uint8), np.ones((2 * THREAD_MARGIN_PX + 1,) * 2, np.uint8)) > 0
    disparity[near_thread] = np.nan
    cells = _cell_medians(disparity)
    valid = np.isfinite(cells)
    depth = np.zeros(cells.shape)
    depth[valid] = depth_of_disparity(camera, cells[valid])
    rows, columns = cells.shape
    u, v = (((np.arange(count) + 0.5) * CELL_PX) / share - 0.5 for count in (columns, rows))
    return TissueSurface(stamp, camera, u, v, depth, valid)


def _reduced(image: UInt8[np.ndarray, "h w 3"], share: float) -> UInt8[np.ndarray, "h w"]:
    size = max(1, round(image.shape[1] * share)), max(1, round(image.shape[0] * share))
    return cv2.resize(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), size, interpolation=cv2.INTER_AREA)


def _disparity(
    left: UInt8[np.ndarray, "h w"], right: UInt8[np.ndarray, "h w"], width: float
) -> Float64[np.ndarray, "h w"]:
    """Disparity of each pixel in this image's own pixels; NaN where it is not known."""
    reach = 16 * -(-largest_disparity_px(round(width)) // 16)
    if left.shape[1] <= reach + WINDOW_PX:
        return np.full(left.shape, np.nan)
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=reach,
        blockSize=WINDOW_PX,
        P1=2 * WINDOW_PX**2,
        P2=8 * WINDOW_PX**2,
        disp12MaxDiff=1,
        uniquenessRatio=20,
        speckleWindowSize=60,
        speckleRange=2,
    )
    # the leftmost pixels have their counterparts beyond the border, so that the border is moved out and its own dropped
    padded = [cv2.copyMakeBorder(image, 0, 0, reach, 0, cv2.BORDER_REPLICATE) for image in (left, right)]
    found = np.asarray(matcher.compute(*padded))[:, reach:] / PARTS_OF_A_PIXEL
    beyond = found > np.arange(left.shape[1])[None, :]
    return np.where((found >= 1.0) & ~beyond & _textured(left), found, np.nan)


def _textured(image: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Where the image changes along its rows by more than noise: elsewhere the matcher only spreads its neighbours."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)
    change = np.abs(smooth - np.roll(smooth, TEXTURE_STEP_PX, axis=1))
    return cv2.blur(change, (CELL_PX, CELL_PX)) > LEAST_CHANGE


def _cell_medians(disparity: Float64[np.ndarray, "h w"]) -> Float64[np.ndarray, "r c"]:
    """The median of each cell; NaN where too few of its pixels are known."""
    rows, columns = (side // CELL_PX for side in disparity.shape)
    whole = disparity[: rows * CELL_PX, : columns * CELL_PX].reshape(rows, CELL_PX, columns, CELL_PX)
    cells = whole.transpose(0, 2, 1, 3).reshape(rows, columns, CELL_PX**2)
    ordered = np.sort(cells, axis=2)
    known = np.isfinite(cells).sum(axis=2)
    middle = np.take_along_axis(ordered, np.maximum(known - 1, 0)[:, :, None] // 2, axis=2)[:, :, 0]
    return np.where(known >= LEAST_SHARE * CELL_PX**2, middle, np.nan)
