"""What things are made of, as Mitsuba's materials: metals plain and worn, toothed jaws, black shafts."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32

from shared.rendering.path_traced.engine import engine
from shared.rendering.path_traced.solids import METALS, Solid
from shared.rendering.surface import rough_field, smooth_field

TILE_MM, TILE_PX = 16.0, 512
TEETH_MM, TEETH_DEPTH_MM = 0.5, 0.12
ENGRAVED, ENGRAVED_AT_MM = "S420", (5.5, 4.6)


def of_solid(solid: Solid) -> dict[str, Any]:
    """The material of a solid, seen from both sides."""
    finish = FINISHES.get(solid.finish)
    inside = metal(solid.metal, solid.metallic, 0.32) if finish is None else finish(solid)
    return {"type": "twosided", "inside": inside}


def metal(name: str, metallic: float, roughness: float) -> dict[str, Any]:
    """One of `METALS`, the same all over."""
    return {
        "type": "principled",
        "base_color": colour(METALS[name]),
        "metallic": metallic,
        "roughness": roughness,
        "specular": 0.5,
    }


def bitmap(values: np.ndarray) -> dict[str, Any]:
    """A texture of linear values, which ends at its border."""
    pixels = engine().Bitmap(np.ascontiguousarray(values, dtype=np.float32))
    return {"type": "bitmap", "bitmap": pixels, "raw": True, "wrap_mode": "clamp"}


def colour(value: tuple[float, float, float]) -> dict[str, Any]:
    """One colour, linear, red first."""
    return {"type": "rgb", "value": list(value)}


def _worn(solid: Solid) -> dict[str, Any]:
    grain, scratches = _wear()
    return _steel(solid, grain, scratches)


def _engraved(solid: Solid) -> dict[str, Any]:
    grain, scratches = _wear()
    cut = _engraving()
    return _steel(solid, np.clip(grain + 0.3 * cut, 0.0, 1.0), scratches * (1.0 - 0.75 * cut))


def _steel(solid: Solid, grain: Float32[np.ndarray, "n n"], shade: Float32[np.ndarray, "n n"]) -> dict[str, Any]:
    base = np.array(METALS[solid.metal], dtype=np.float32)
    return {
        "type": "principled",
        "base_color": _tiled(shade[..., None] * base, TILE_MM, TILE_MM),
        "metallic": solid.metallic,
        "roughness": _tiled(grain[..., None], TILE_MM, TILE_MM),
        "specular": 0.5,
    }


def _toothed(solid: Solid) -> dict[str, Any]:
    """Furrows across the jaw, and finer ones along it."""
    t = np.arange(64) / 64.0
    along = np.abs(2.0 * t - 1.0)
    height = np.minimum(along[:, None], 0.4 + 0.6 * np.abs(2.0 * np.mod(2.0 * t, 1.0) - 1.0))
    shade = (0.25 + 0.75 * height)[..., None] * np.array(METALS[solid.metal], dtype=np.float32)
    plain = {
        "type": "principled",
        "base_color": _tiled(shade, 2.0 * TEETH_MM, TEETH_MM),
        "metallic": solid.metallic,
        "roughness": 0.4,
        "specular": 0.5,
    }
    return {
        "type": "bumpmap",
        "arbitrary": _tiled(height[..., None], 2.0 * TEETH_MM, TEETH_MM),
        "scale": TEETH_DEPTH_MM,
        "bsdf": plain,
    }


def _shaft(solid: Solid) -> dict[str, Any]:
    return {
        "type": "principled",
        "base_color": colour(METALS[solid.metal]),
        "roughness": 0.36,
        "specular": 0.5,
        "clearcoat": 0.15,
        "clearcoat_gloss": 0.6,
    }


def _tiled(values: np.ndarray, wide_mm: float, high_mm: float) -> dict[str, Any]:
    """A texture that is repeated over a surface whose texture is in mm."""
    scale = engine().ScalarTransform4f().scale([1.0 / wide_mm, 1.0 / high_mm, 1.0])
    return {**bitmap(values), "wrap_mode": "mirror", "to_uv": scale}


@lru_cache(maxsize=1)
def _wear() -> tuple[Float32[np.ndarray, "n n"], Float32[np.ndarray, "n n"]]:
    """Roughness of used steel, and its shade, 0 to 1: brushed, blotched, scratched; the same for all."""
    rng, shape = np.random.default_rng(91), (TILE_PX, TILE_PX)
    mm = TILE_PX / TILE_MM
    brushed = smooth_field(rng, shape, 0.1 * mm, (1.0, 5.0))
    blotched = rough_field(rng, shape, 3.0 * mm, 4)
    scratches = np.zeros(shape, dtype=np.uint8)
    for _ in range(70):
        start, way = rng.uniform(0, TILE_PX, 2), rng.normal(0.0, 0.9 * mm, 2)
        ends = [tuple(int(value) for value in 16.0 * point) for point in (start, start + way)]
        cv2.line(scratches, ends[0], ends[1], int(rng.uniform(60, 200)), 1, cv2.LINE_AA, 4)
    lines = scratches.astype(np.float32) / 255.0
    grain = np.clip(0.23 + 0.05 * blotched + 0.02 * brushed + 0.2 * lines, 0.14, 0.8).astype(np.float32)
    shade = np.clip(0.9 + 0.05 * blotched + 0.02 * brushed - 0.2 * lines, 0.4, 1.0).astype(np.float32)
    return grain, shade


@lru_cache(maxsize=1)
def _engraving() -> Float32[np.ndarray, "n n"]:
    """Where letters are cut, 0 to 1, on the wrist's flat sides."""
    plate = np.zeros((TILE_PX, TILE_PX), dtype=np.uint8)
    mm = TILE_PX / TILE_MM
    place = tuple(int(mm * value) for value in ENGRAVED_AT_MM)
    cv2.putText(plate, ENGRAVED, place, cv2.FONT_HERSHEY_DUPLEX, 2.0, 255, 4, cv2.LINE_AA)
    cv2.circle(plate, (place[0] - int(mm), place[1] - int(0.8 * mm)), int(0.7 * mm), 255, 4, cv2.LINE_AA)
    return cv2.GaussianBlur(plate.astype(np.float32) / 255.0, (0, 0), 1.0)


FINISHES: dict[str, Callable[[Solid], dict[str, Any]]] = {
    "worn": _worn,
    "engraved": _engraved,
    "toothed": _toothed,
    "shaft": _shaft,
}
