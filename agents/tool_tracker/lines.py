"""How well the long edges of an instrument lie on edges of the images, whatever colour is on either side.

Shaft and wrist are long and straight, and their edges are seen where colour does not tell steel from tissue. With g the
slope of colour and n the normal of an expected edge, what counts is the mean of

    (n·g)² / (|g|² + STEEP²)

over both edges and both eyes: 1 where all steep slopes stand across the edge, a half or less in texture.
"""

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from agents.tool_tracker.correction import about
from agents.tool_tracker.evidence import SHRINK
from agents.tool_tracker.search import Scores
from agents.tool_tracker.tubes import FINGER, Tube
from schemas.messages import RectifiedStereo

STEEP = 8.0
"""Grey levels a small pixel."""
LEAST = 12
"""Fewer points in view than this count as if there were more, without an edge."""
STEP = 2

Slopes = tuple[Float32[np.ndarray, "k l"], Float32[np.ndarray, "k l"], Float32[np.ndarray, "k l"]]


def lined(
    camera: RectifiedStereo,
    soft: tuple[UInt8[np.ndarray, "h w 3"], ...],
    parts: tuple[Tube, ...],
    pivot: Float64[np.ndarray, "3"],
) -> Scores:
    """The module's mean for twists; `parts` is where the tool is without any."""
    slopes = [_slopes(one) for one in soft]
    points, along = _edges(parts)
    eyes = (0.0, camera.baseline)

    def scores(twists: Float64[np.ndarray, "m 6"]) -> Float64[np.ndarray, "m"]:
        T = about(pivot, twists)
        p = np.einsum("mij,nj->mni", T[:, :3, :3], points) + T[:, None, :3, 3]
        d = np.einsum("mij,nj->mni", T[:, :3, :3], along)
        return sum(
            (0.5 * _steep(camera, one, p, d, eye_x) for one, eye_x in zip(slopes, eyes, strict=True)),
            np.zeros(len(twists)),
        )

    return scores


def _slopes(soft: UInt8[np.ndarray, "h w 3"]) -> Slopes:
    """Products of the slopes of colour along x and y (xx, yy, xy) at 1 / SHRINK of the size, of slopes at most 1."""
    size = (soft.shape[1] // SHRINK, soft.shape[0] // SHRINK)
    small = cv2.GaussianBlur(cv2.resize(soft, size, interpolation=cv2.INTER_AREA).astype(np.float32), (0, 0), 1.0)
    x, y = (cv2.Sobel(small, cv2.CV_32F, *order) / 8 for order in ((1, 0), (0, 1)))
    products = [(one * other).sum(axis=2) for one, other in ((x, x), (y, y), (x, y))]
    share = 1 / (products[0] + products[1] + STEEP**2)
    xx, yy, xy = (cv2.GaussianBlur(one * share, (0, 0), 1.0) for one in products)
    return xx, yy, xy


def _edges(parts: tuple[Tube, ...]) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Points of both edges of shaft and wrist, and the way along them."""
    points, along = [], []
    for part in (one for one in parts if one.part != FINGER):
        d = np.gradient(part.places, axis=0)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        b = np.cross(d, part.places)
        b *= np.maximum(part.wide, part.thick)[:, None] / np.linalg.norm(b, axis=1, keepdims=True)
        points += [(part.places + side * b)[::STEP] for side in (-1, 1)]
        along += [d[::STEP]] * 2
    return np.concatenate(points), np.concatenate(along)


def _steep(
    camera: RectifiedStereo,
    slopes: Slopes,
    points: Float64[np.ndarray, "m n 3"],
    along: Float64[np.ndarray, "m n 3"],
    eye_x: float,
) -> Float64[np.ndarray, "m"]:
    """The mean over what is in view of one eye."""
    z = np.maximum(points[..., 2], 1e-3)
    x, y = (points[..., 0] - eye_x) / z, points[..., 1] / z
    u, v = along[..., 0] - x * along[..., 2], along[..., 1] - y * along[..., 2]
    long = np.maximum(np.hypot(u, v), 1e-9)
    column = ((camera.fx_px * x + camera.cx_px) / SHRINK).astype(np.int64)
    row = ((camera.fy_px * y + camera.cy_px) / SHRINK).astype(np.int64)
    height, width = slopes[0].shape
    seen = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    at = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
    xx, yy, xy = (one[at] for one in slopes)
    across = (v * v * xx + u * u * yy - 2 * u * v * xy) / long**2
    return (across * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), LEAST)
