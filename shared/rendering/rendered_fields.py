"""The path-traced fields that come with the project, seen by any camera from any distance.

Each was rendered once, a little wider than an endoscope's view. At another distance it is the same field, lamps
included, scaled about the left eye by k: the left image stays as it is, and the right eye, which stands at B and not at
k B₀, looks the same point of the surface up in the stored right image, (B − k B₀) / z further right in slope.
"""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from schemas.messages import RectifiedStereo
from shared.rendering.backdrop_files import Backdrop, Light, SceneError, StoredField, stored_field
from shared.rendering.surface import Surface, depth_at_points, meet_rays, ray_tangents

FIELDS = Path(__file__).with_name("fields")
WIDER = 1.01
"""A camera may see so much further aside than a field goes; there its border is repeated."""


def rendered_backdrop(camera: RectifiedStereo, distance_mm: float, seed: int) -> Backdrop:
    """One of the fields, which the seed chooses, as both eyes of a camera see it from so far in the left one's middle.

    Raises:
        SceneError: where the camera sees further aside than the fields go.
    """
    field, k = _scaled(_field(seed), distance_mm)
    p, q = ray_tangents(camera)
    if np.abs(p).max() > WIDER * _aside(field.camera) or np.abs(q).max() > WIDER * _down(field.camera):
        raise SceneError(
            f"a camera of {camera.image_width}x{camera.image_height} with f = {camera.fx_px:.0f} px sees further than"
            " the rendered fields go; use background tissue, or a longer focal length"
        )
    depths = [meet_rays(field.surface, p, q, eye_x_mm) for eye_x_mm in (0.0, camera.baseline)]
    further = np.float32(camera.baseline - k * field.camera.baseline) / depths[1]
    return Backdrop(
        field.surface,
        _looked_up(field.left_bgr, field.camera, p, q),
        _looked_up(field.right_bgr, field.camera, p + further, q),
        depths[0],
        depths[1],
        shadows=True,
        lights=field.lights,
    )


def rendered_surface(distance_mm: float, seed: int) -> Surface:
    """The surface of that field at that distance."""
    return _scaled(_field(seed), distance_mm)[0].surface


def _field(seed: int) -> StoredField:
    folders = sorted(FIELDS.iterdir())
    return stored_field(folders[(seed - 1) % len(folders)])


def _scaled(field: StoredField, distance_mm: float) -> tuple[StoredField, float]:
    """The whole field k times as large and as far from the left eye, so that its middle is so far away, and k.

    Its images are then those of a baseline k times as long.
    """
    surface = field.surface
    k = distance_mm / float(depth_at_points(surface, np.zeros((1, 2)))[0])
    depth = (k * surface.depth_mm).astype(np.float32)
    lights = tuple(Light((k * x, k * y, k * z), light.share) for light in field.lights for x, y, z in [light.place_mm])
    grown = Surface(depth, k * surface.x0_mm, k * surface.y0_mm, k * surface.step_mm)
    return replace(field, surface=grown, lights=lights), k


def _looked_up(
    image: UInt8[np.ndarray, "h w 3"],
    camera: RectifiedStereo,
    p: Float32[np.ndarray, "H W"],
    q: Float32[np.ndarray, "H W"],
) -> UInt8[np.ndarray, "H W 3"]:
    """The stored image along rays of these slopes."""
    u = (camera.fx_px * p + camera.cx_px).astype(np.float32)
    v = (camera.fy_px * q + camera.cy_px).astype(np.float32)
    seen = cv2.remap(image, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, dtype=np.uint8)


def _aside(camera: RectifiedStereo) -> float:
    return max(camera.cx_px, camera.image_width - 1 - camera.cx_px) / camera.fx_px


def _down(camera: RectifiedStereo) -> float:
    return max(camera.cy_px, camera.image_height - 1 - camera.cy_px) / camera.fy_px
