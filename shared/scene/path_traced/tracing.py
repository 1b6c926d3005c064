"""Rays through a field: the light that reaches each pixel of an eye, and what each of its parts sees."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from schemas.messages import RectifiedStereo
from shared.scene.path_traced.engine import engine
from shared.scene.path_traced.field import Lamp
from shared.scene.path_traced.splines import arc_lengths
from shared.scene.path_traced.world import LAMP, shape_names

PARTS = 4
"""Each pixel is looked at in this many rows and columns, at a random place of each part."""

LEAST_SLANT = 0.25
RELIEF_MM = 0.05


@dataclass(frozen=True)
class Eye:
    """A pinhole that looks along z from (x_mm, 0, 0): focal length and size in px, its axis through the middle."""

    width: int
    height: int
    focal_px: float
    x_mm: float


@dataclass(frozen=True)
class Sight:
    """What every part of every pixel sees: an index into `names`, and the distance along its ray in mm."""

    names: list[str]
    index: Int32[np.ndarray, "H W"]
    distance_mm: Float32[np.ndarray, "H W"]

    def covers(self, kind: str) -> Bool[np.ndarray, "H W"]:
        """Which parts see a shape whose name begins so."""
        chosen = np.array([bool(name) and name.startswith(kind) for name in self.names])
        return chosen[self.index]


def eyes_of(camera: RectifiedStereo) -> tuple[Eye, Eye]:
    """Both eyes of a rectified camera whose axis goes through the middle of the image."""
    size = (camera.image_width, camera.image_height, camera.fx_px)
    return Eye(*size, 0.0), Eye(*size, camera.baseline)


def traced_light(scene: Any, lamps: list[Lamp], eye: Eye, samples: int, seed: int) -> Float32[np.ndarray, "h w 3"]:
    """Linear light, red first: each lamp on its own, with so many samples of each pixel, and their sum.

    A sample that had to choose among the lamps would make every half-shadow grainy.
    """
    mi = engine()
    integrator = mi.load_dict({"type": "direct", "emitter_samples": 1, "bsdf_samples": 0})
    parameters = mi.traverse(scene)
    total = np.zeros((eye.height, eye.width, 3), dtype=np.float32)
    for index, lamp in enumerate(lamps):
        parameters[f"{LAMP}.to_world"] = mi.Transform4f().translate(list(lamp.place_mm))
        parameters[f"{LAMP}.intensity.value"] = mi.Color3f(list(lamp.intensity))
        parameters.update()
        image = mi.render(scene, sensor=_sensor(eye, 1), integrator=integrator, spp=samples, seed=3 * seed + index)
        total += np.array(image, dtype=np.float32)[..., :3]
    return total


def sight(scene: Any, eye: Eye, seed: int, parts: int = PARTS) -> Sight:
    """What the parts of each pixel see."""
    mi = engine()
    integrator = mi.load_dict({"type": "aov", "aovs": "distance:depth,shape:shape_index"})
    values = np.array(mi.render(scene, sensor=_sensor(eye, parts), integrator=integrator, spp=1, seed=seed))
    # the last two channels are the two asked for; colour comes before them where the version adds it
    return Sight(shape_names(scene), np.rint(values[..., -1]).astype(np.int32), values[..., -2].astype(np.float32))


def coverage(seen: Bool[np.ndarray, "H W"], eye: Eye) -> Float32[np.ndarray, "h w"]:
    """The share of each pixel, from what its parts see."""
    parts = seen.shape[0] // eye.height
    return seen.reshape(eye.height, parts, eye.width, parts).mean(axis=(1, 3), dtype=np.float32)


def visible(
    seen: Sight, eye: Eye, name: str, points: Float64[np.ndarray, "n 3"], radius_mm: float
) -> Bool[np.ndarray, "n"]:
    """Whether the eye sees the strand at these points of its centreline, and not another stretch in front of them."""
    parts = seen.index.shape[0] // eye.height
    relative = points - (eye.x_mm, 0.0, 0.0)
    pixels = eye.focal_px * relative[:, :2] / relative[:, 2:] + 0.5 * np.array([eye.width, eye.height])
    column, row = np.floor(parts * pixels).astype(np.int64).T
    inside = (column >= 0) & (column < parts * eye.width) & (row >= 0) & (row < parts * eye.height)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    own = seen.covers(name)[row, column]
    distance = np.linalg.norm(relative, axis=1)
    along = np.gradient(points, axis=0)
    cosine = np.einsum("ij,ij->i", along, relative) / (np.linalg.norm(along, axis=1) * distance)
    # a ray to the axis enters a tube that it meets at a slant so much before
    ahead = radius_mm / np.sqrt(np.maximum(1.0 - cosine**2, LEAST_SLANT**2))
    gap = distance - ahead - seen.distance_mm[row, column]
    return inside & own & (np.abs(gap) < 0.5 * ahead + RELIEF_MM)


def offset_from_truth(
    cover: Float32[np.ndarray, "h w"],
    eye: Eye,
    points: Float64[np.ndarray, "n 3"],
    shown: Bool[np.ndarray, "n"],
    radius_mm: float,
) -> Float64[np.ndarray, "k"]:
    """Across the projected centreline, how far the middle of its mask lies from it, in px, at places a pixel apart.

    Only where all around is visible and no other strand is near, since elsewhere the middle means nothing.
    """
    relative = points - (eye.x_mm, 0.0, 0.0)
    pixels = eye.focal_px * relative[:, :2] / relative[:, 2:] + 0.5 * np.array([eye.width - 1, eye.height - 1])
    travelled = arc_lengths(np.column_stack((pixels, np.zeros(len(pixels)))))
    even = np.arange(12.0, travelled[-1] - 12.0)
    place = np.column_stack([np.interp(even, travelled, axis) for axis in pixels.T])
    ahead = np.column_stack([np.interp(even + 2.0, travelled, axis) for axis in pixels.T])
    along = ahead - place
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    normal = np.column_stack((-along[:, 1], along[:, 0]))
    reach = np.linspace(-12.0, 12.0, 193)
    where = place[:, None] + reach[:, None] * normal[:, None]
    profile = _bilinear(cover, where)
    whole = np.interp(even, travelled, shown.astype(np.float64))
    near = np.array([whole[max(k - 12, 0) : k + 13].min() for k in range(len(whole))]) > 0.999
    half = np.interp(even, travelled, eye.focal_px * radius_mm / relative[:, 2])
    aside = np.abs(reach) > half[:, None] + 1.5
    clear = near & (np.where(aside, profile, 0.0).max(axis=1, initial=0) == 0)
    weight = profile.sum(axis=1)
    kept = clear & (weight > 0)
    return (profile[kept] @ reach) / weight[kept]


def _bilinear(image: np.ndarray, where: np.ndarray) -> np.ndarray:
    u, v = where[..., 0].astype(np.float32), where[..., 1].astype(np.float32)
    parts = [
        cv2.remap(image, u[k : k + 8192], v[k : k + 8192], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        for k in range(0, len(u), 8192)
    ]
    return np.concatenate(parts).astype(np.float64) if parts else np.zeros(u.shape)


def _sensor(eye: Eye, parts: int) -> Any:
    mi = engine()
    # Mitsuba's camera looks along +z with +y up and +x to the left; this turns it into the OpenCV frame
    pose = np.diag([-1.0, -1.0, 1.0, 1.0])
    pose[0, 3] = eye.x_mm
    return mi.load_dict(
        {
            "type": "perspective",
            "fov_axis": "x",
            "fov": float(np.degrees(2.0 * np.arctan(0.5 * eye.width / eye.focal_px))),
            "near_clip": 0.01,
            "far_clip": 2000.0,
            "to_world": mi.ScalarTransform4f(pose),
            "film": {
                "type": "hdrfilm",
                "width": parts * eye.width,
                "height": parts * eye.height,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
            "sampler": {"type": "independent", "sample_count": 1},
        }
    )
