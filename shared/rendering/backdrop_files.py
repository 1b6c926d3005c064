"""What the light renderer lays threads over, and fields for it on disk: images, the surface, lamps."""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from schemas.messages import RectifiedStereo
from shared.rendering.surface import Surface


class SceneError(ValueError):
    """A scene that cannot be rendered: the text names what is wrong and what would do."""


@dataclass(frozen=True)
class Light:
    """A lamp beside the lens: where it is, in mm in the left camera's frame, and its share of the light."""

    place_mm: tuple[float, float, float]
    share: float


@dataclass(frozen=True)
class Backdrop:
    """What lies behind the thread, seen by both cameras, without noise; depths in mm along each camera's axis.

    Fields:
        shadows: whether a thread casts any.
        lights: those that cast them; none: the light renderer's own.
    """

    surface: Surface
    left_bgr: UInt8[np.ndarray, "h w 3"]
    right_bgr: UInt8[np.ndarray, "h w 3"]
    depth_left_mm: Float32[np.ndarray, "h w"]
    depth_right_mm: Float32[np.ndarray, "h w"]
    shadows: bool
    lights: tuple[Light, ...] = ()


DEPTH_STEP_MM = 0.005
"""Of the surface on disk."""


@dataclass(frozen=True)
class StoredField:
    """A field as it was rendered: by which camera, in mm, its surface, both images, and the lamps beside the lens."""

    camera: RectifiedStereo
    surface: Surface
    left_bgr: UInt8[np.ndarray, "h w 3"]
    right_bgr: UInt8[np.ndarray, "h w 3"]
    lights: tuple[Light, ...]


@lru_cache(maxsize=2)
def stored_field(folder: Path) -> StoredField:
    """The field in a folder, as it was rendered."""
    document = json.loads((folder / "backdrop.json").read_text(encoding="utf-8"))
    with np.load(folder / "surface.npz") as stored:
        depth, (x0, y0, step) = stored["depth"], stored["grid"].tolist()
    left, right = (np.asarray(cv2.imread(str(folder / f"{side}.jpg")), np.uint8) for side in ("left", "right"))
    return StoredField(
        RectifiedStereo(**document["camera"], metres_per_unit=1e-3),
        Surface((depth * DEPTH_STEP_MM).astype(np.float32), x0, y0, step),
        left,
        right,
        tuple(Light((x, y, z), share) for x, y, z, share in document["lights"]),
    )
