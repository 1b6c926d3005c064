"""Oriented line filters: a second derivative across a line, a long Gaussian along it, the best of several angles.

A Gaussian that is longer along u than across v is a round one, blurred further along u, so that

    ∂²/∂v² G(σ_v, σ_u) = (sin²θ ∂_xx − 2 sinθ cosθ ∂_xy + cos²θ ∂_yy) G(σ_v, σ_v) * L(√(σ_u² − σ_v²)),

where L runs along the line at angle θ. The three derivatives are those of every angle, and L touches two pixels in
every second row or column alone, between which what is blurred hardly changes: a twentieth of the work of the whole
filters or of products of spectra. The same derivatives tell the direction across a line.
"""

import functools
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Int64

ACROSS_PX, ALONG_PX = 1.1, 3.0
"""Standard deviations of the oriented filter: it answers best to a line 2.2 px wide, and well from 1 to 4."""
ORIENTATIONS = 8
ROUND_PX, ALONG_REACH_PX = 4, 7
"""How far the derivatives, and the lines, reach."""
RADIUS_PX = ROUND_PX + ALONG_REACH_PX
STEP_PX, WIDE_STEP_PX = 2, 2.5
"""Along a line, in columns or rows, as long as places do not lie farther apart than that."""
CALM_PX = 5
"""Side of the window over which derivatives are averaged for a direction."""
DIRECTION_REACH_PX = ROUND_PX + CALM_PX // 2

ANGLES = np.arange(ORIENTATIONS) * (np.pi / ORIENTATIONS)
MIRRORED = (0,), *((k, ORIENTATIONS - k) for k in range(1, ORIENTATIONS // 2)), (ORIENTATIONS // 2,)
"""Angles of either sign, whose filters differ in the sign of ∂_xy alone."""
Derivatives = tuple[tuple[Float32[np.ndarray, "k"], Float32[np.ndarray, "k"]], ...]


@dataclass(frozen=True)
class _Filters:
    """The filters in parts.

    Fields:
        derivatives: kernels along x and along y of ∂_xx, ∂_xy and ∂_yy of the round Gaussian.
        mixed: how much of each derivative is in the filter of each angle.
        lines: the kernel along the line at each angle.
        radius: how far they reach.
    """

    derivatives: Derivatives
    mixed: Float32[np.ndarray, "a 3"]
    lines: tuple[Float32[np.ndarray, "r c"], ...]
    radius: int


def line_response(
    contrast: Float32[np.ndarray, "h w"], rows: slice = slice(None), columns: slice = slice(None)
) -> Float32[np.ndarray, "r c"]:
    """How much each pixel of some rows and columns of a contrast looks like part of a line.

    It is in the contrast's grey levels, by the best filter.
    """
    return _strongest(contrast, rows, columns, _filters())


def rough_line_response(contrast: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """About the same for a contrast of half the width and height, with lines half as long.

    The derivatives are Sobel's: in the smaller image they are about as wide as the others in the larger one.
    """
    return _strongest(contrast, slice(None), slice(None), _rough_filters())


def _strongest(
    contrast: Float32[np.ndarray, "h w"], rows: slice, columns: slice, filters: _Filters
) -> Float32[np.ndarray, "r c"]:
    """The greatest answer of any angle, and 0 where all are less."""
    margin = filters.radius
    padded = cv2.copyMakeBorder(contrast, margin, margin, margin, margin, cv2.BORDER_REFLECT)
    (top, bottom, _), (left, right, _) = rows.indices(contrast.shape[0]), columns.indices(contrast.shape[1])
    padded = padded[top : bottom + 2 * margin, left : right + 2 * margin]
    xx, xy, yy = (cv2.sepFilter2D(padded, cv2.CV_32F, x, y) for x, y in filters.derivatives)
    strongest = np.zeros(padded.shape, np.float32)
    both, across, answer = (np.empty_like(strongest) for _ in range(3))
    mixed = filters.mixed.tolist()
    for mirrored in MIRRORED:
        of_xx, _, of_yy = mixed[mirrored[0]]
        cv2.addWeighted(xx, of_xx, yy, of_yy, 0, dst=both)
        for k in mirrored:
            cv2.scaleAdd(xy, mixed[k][1], both, dst=across)
            cv2.filter2D(across, cv2.CV_32F, filters.lines[k], dst=answer)
            cv2.max(strongest, answer, dst=strongest)
    # memory that was in use just now: to get some takes ten times as long as to write to it
    inner = strongest[margin:-margin, margin:-margin]
    found = answer.ravel()[: inner.size].reshape(inner.shape)
    np.copyto(found, inner)
    return found


def across_lines(contrast: Float32[np.ndarray, "h w"], pixel: Int64[np.ndarray, "p"]) -> Float32[np.ndarray, "p 2"]:
    """Unit vectors (columns, rows), of either sign, in which a contrast bends most at some of its pixels.

    Args:
        pixel: indices, in order.
    """
    if len(pixel) == 0:
        return np.zeros((0, 2), np.float32)
    row, column = np.divmod(pixel, contrast.shape[1])
    top, left = max(0, int(row[0]) - DIRECTION_REACH_PX), max(0, int(column.min()) - DIRECTION_REACH_PX)
    # what lies around these pixels is all that they are asked about
    part = contrast[top : int(row[-1]) + DIRECTION_REACH_PX + 1, left : int(column.max()) + DIRECTION_REACH_PX + 1]
    calm = cv2.blur(part, (CALM_PX, CALM_PX), borderType=cv2.BORDER_REFLECT)
    at = (row - top) * part.shape[1] + column - left
    bends = (cv2.sepFilter2D(calm, cv2.CV_32F, x, y, borderType=cv2.BORDER_REFLECT) for x, y in _filters().derivatives)
    xx, xy, yy = (bend.ravel()[at] for bend in bends)
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    # that of the greatest value, to which the least lies at a right angle; a bright line bends downwards
    angle += np.where(xx + yy < 0, np.float32(np.pi / 2), np.float32(0))
    return np.column_stack((np.cos(angle), np.sin(angle))).astype(np.float32, copy=False)


def oriented_kernels() -> list[Float32[np.ndarray, "k k"]]:
    """The whole filter of each angle; each sums to 0 and its magnitudes to 2."""
    filters = _filters()
    return [_whole(filters.derivatives, *parts) for parts in zip(filters.mixed, filters.lines, strict=True)]


@functools.cache
def _filters() -> _Filters:
    x = np.arange(-ROUND_PX, ROUND_PX + 1.0)
    level = np.exp(-0.5 * (x / ACROSS_PX) ** 2)
    slope, bend = -x / ACROSS_PX**2 * level, (x**2 / ACROSS_PX**2 - 1) / ACROSS_PX**2 * level
    # a kernel cut short would see a line in an even ground
    bend -= bend.sum() * level / level.sum()
    level, slope, bend = (part.astype(np.float32) for part in (level, slope, bend))
    return _filters_of(((bend, level), (slope, slope), (level, bend)), [_line(angle) for angle in ANGLES])


@functools.cache
def _rough_filters() -> _Filters:
    """Those for an image of half the width and height."""
    level, slope, bend = (np.array(part, np.float32) for part in ((1, 2, 1), (-1, 0, 1), (1, -2, 1)))
    return _filters_of(((bend, level), (slope, slope), (level, bend)), [_line(angle, 1, 2) for angle in ANGLES])


def _filters_of(derivatives: Derivatives, lines: list[Float32[np.ndarray, "r c"]]) -> _Filters:
    mixed = -np.column_stack((np.sin(ANGLES) ** 2, -np.sin(2 * ANGLES), np.cos(ANGLES) ** 2)).astype(np.float32)
    for k, line in enumerate(lines):
        mixed[k] *= 2 / np.abs(_whole(derivatives, mixed[k], line)).sum()
    radius = len(derivatives[0][0]) // 2 + max(max(line.shape) for line in lines) // 2
    return _Filters(derivatives, mixed, tuple(lines), radius)


def _line(angle: float, widest_step: int = STEP_PX, pixel_px: int = 1) -> Float32[np.ndarray, "r c"]:
    """A Gaussian along a line through the middle, each of its places shared between two pixels.

    Args:
        widest_step: in pixels, along the columns or rows.
        pixel_px: how far pixels lie apart.
    """
    if np.abs(np.sin(angle)) > np.abs(np.cos(angle)):
        return np.ascontiguousarray(_line(np.pi / 2 - angle, widest_step, pixel_px).T)
    step = widest_step if abs(widest_step / np.cos(angle)) <= WIDE_STEP_PX else 1
    reach = round(ALONG_REACH_PX / pixel_px * abs(np.cos(angle)))
    reach -= reach % step
    x = np.arange(-reach, reach + 1, step)
    y = np.round(x * np.tan(angle), 9)
    aside = int(np.ceil(np.abs(y).max()))
    weight = np.exp(-0.5 * (pixel_px * x / np.cos(angle)) ** 2 / (ALONG_PX**2 - ACROSS_PX**2))
    line = np.zeros((2 * aside + 1, 2 * reach + 1), np.float32)
    below = np.floor(y).astype(int)
    share = y - below
    line[below + aside, x + reach] += weight * (1 - share)
    line[np.minimum(below + aside + 1, 2 * aside), x + reach] += weight * share
    return line


def _whole(
    derivatives: Derivatives,
    mixed: Float32[np.ndarray, "3"],
    line: Float32[np.ndarray, "r c"],
) -> Float32[np.ndarray, "n n"]:
    side = 2 * RADIUS_PX + 1
    spot = np.zeros((side, side), np.float32)
    spot[RADIUS_PX, RADIUS_PX] = 1
    parts = [cv2.sepFilter2D(spot, cv2.CV_32F, x, y) for x, y in derivatives]
    round_part = sum((share * part for share, part in zip(mixed, parts, strict=True)), np.zeros_like(spot))
    return np.asarray(cv2.filter2D(round_part, cv2.CV_32F, line, borderType=cv2.BORDER_CONSTANT), np.float32)
