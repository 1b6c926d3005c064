"""Rays through a field: the light that reaches each pixel of an eye, and what each of its parts sees.

Mitsuba traces a plain pinhole. An eye that is none is traced through a finer pinhole that sees all that it sees, and
sampled from that along its own rays.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from shared.rendering.path_traced.engine import engine
from shared.rendering.path_traced.eyes import Eye
from shared.rendering.path_traced.field import Lamp
from shared.rendering.path_traced.world import LAMP, shape_names

SEEDS = 2**32
"""Of Mitsuba; a scene's own seed may be any."""
FINEST_PX = 3840
MOST_PARTS, LEAST_PARTS = 4, 3
"""Each pixel is looked at in so many rows and columns, at a random place of each part; fewer in large images."""

FINER_LENS = 2
RAYS_AT_ONCE = 5_000_000
LEAST_SLANT = 0.25
LAB_DEPTH = 3
BRIGHTEST, SPARK = 8.0, 1.5
"""Of light where a white card returns one; how much brighter than all but one of its neighbours a pixel can be."""
RELIEF_MM = 0.05


@dataclass(frozen=True)
class Sight:
    """What every part of every pixel sees: the number of a shape in `names`, or 0, and how far away it is in mm."""

    names: dict[int, str]
    index: Int32[np.ndarray, "H W"]
    distance_mm: Float32[np.ndarray, "H W"]

    def covers(self, kind: str) -> Bool[np.ndarray, "H W"]:
        """Which parts see a shape whose name begins so."""
        chosen = np.zeros(1 + max(int(self.index.max()), *self.names), dtype=bool)
        chosen[[number for number, name in self.names.items() if name.startswith(kind)]] = True
        return chosen[self.index]


def traced_light(scene: Any, lamps: list[Lamp], eye: Eye, samples: int, seed: int) -> Float32[np.ndarray, "h w 3"]:
    """Linear light, red first: each lamp on its own, with so many samples of each pixel, and their sum.

    A sample that had to choose among the lamps would make every half-shadow grainy.
    """
    mi = engine()
    integrator = mi.load_dict({"type": "direct", "emitter_samples": 1, "bsdf_samples": 0})
    parameters = mi.traverse(scene)
    lens, parts = (eye, 1) if eye.is_plain else (_covering(eye), 2)
    turns = _turns(max(samples // parts, 1), parts**2 * lens.width * lens.height)
    total = np.zeros((parts * lens.height, parts * lens.width, 3), dtype=np.float32)
    for index, lamp in enumerate(lamps):
        parameters[f"{LAMP}.to_world"] = mi.Transform4f().translate(list(lamp.place_mm))
        parameters[f"{LAMP}.intensity.value"] = mi.Color3f(list(lamp.intensity))
        parameters.update()
        for turn, spp in enumerate(turns):
            number = len(turns) * (len(lamps) * seed + index) + turn
            image = mi.render(scene, sensor=_sensor(lens, parts), integrator=integrator, spp=spp, seed=number % SEEDS)
            total += np.float32(spp / sum(turns)) * np.array(image, dtype=np.float32)[..., :3]
    return _seen_by(eye, lens, parts, total)


def traced_lab_light(scene: Any, eye: Eye, samples: int, seed: int) -> Float32[np.ndarray, "h w 3"]:
    """Linear light, red first, of all lamps of a lab at once, reflected once more by whatever it meets."""
    mi = engine()
    integrator = mi.load_dict({"type": "path", "max_depth": LAB_DEPTH, "hide_emitters": True})
    lens, parts = (eye, 1) if eye.is_plain else (_covering(eye), 2)
    turns = _turns(max(samples // parts**2, 1), parts**2 * lens.width * lens.height)
    total = np.zeros((parts * lens.height, parts * lens.width, 3), dtype=np.float32)
    for turn, spp in enumerate(turns):
        image = mi.render(
            scene, sensor=_sensor(lens, parts), integrator=integrator, spp=spp, seed=(len(turns) * seed + turn) % SEEDS
        )
        total += np.float32(spp / sum(turns)) * np.minimum(np.array(image, dtype=np.float32)[..., :3], BRIGHTEST)
    return _seen_by(eye, lens, parts, without_sparks(total))


def without_sparks(light: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    """The same without lone bright pixels, which are rays that met a lamp by way of steel: too few to be a picture."""
    grey = cv2.copyMakeBorder(light.mean(axis=2), 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    rows, columns = light.shape[:2]
    shifts = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    around = np.stack([grey[i : i + rows, j : j + columns] for i, j in shifts])
    # two neighbours as bright make a line, which stays
    second = np.partition(around, -2, axis=0)[-2]
    limit = SPARK * second + 0.02
    factor = np.minimum(limit / np.maximum(grey[1:-1, 1:-1], 1e-6), 1.0)
    return (light * factor[..., None]).astype(np.float32)


def _seen_by(eye: Eye, lens: Eye, parts: int, total: Float32[np.ndarray, "H W 3"]) -> Float32[np.ndarray, "h w 3"]:
    """What was traced through a lens, as the eye sees it."""
    if eye.is_plain:
        return total
    u, v = _where(eye, parts, lens, parts)
    sampled = cv2.remap(total, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return cv2.resize(sampled, (eye.width, eye.height), interpolation=cv2.INTER_AREA).astype(np.float32)


def _turns(samples: int, pixels: int) -> list[int]:
    """Samples in as many turns as keep few enough rays in memory at once."""
    most = max(RAYS_AT_ONCE // pixels, 1)
    return [min(most, samples - begun) for begun in range(0, samples, most)]


def sight(scene: Any, eye: Eye, seed: int) -> Sight:
    """What the parts of each pixel see."""
    mi = engine()
    parts = int(np.clip(FINEST_PX // eye.width, LEAST_PARTS, MOST_PARTS))
    lens, lens_parts = (eye, parts) if eye.is_plain else (_covering(eye), parts + FINER_LENS)
    integrator = mi.load_dict({"type": "aov", "aovs": "distance:depth,shape:shape_index"})
    rows, columns = lens_parts * lens.height, lens_parts * lens.width
    distance, index = np.empty((2, rows, columns), dtype=np.float32)
    band = max(RAYS_AT_ONCE // columns, 1)
    for first in range(0, rows, band):
        height = min(band, rows - first)
        sensor = _sensor(lens, lens_parts, first, height)
        number = (rows * seed + first) % SEEDS
        values = np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=1, seed=number))
        # the last two channels are the two asked for; colour comes before them where the version adds it
        distance[first : first + height], index[first : first + height] = values[..., -2], values[..., -1]
    if not eye.is_plain:
        u, v = _where(eye, parts, lens, lens_parts)
        distance, index = (
            cv2.remap(channel, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
            for channel in (distance, index)
        )
    return Sight(shape_names(scene), np.rint(index).astype(np.int32), distance)


def coverage(seen: Bool[np.ndarray, "H W"], eye: Eye) -> Float32[np.ndarray, "h w"]:
    """The share of each pixel, from what its parts see."""
    parts = seen.shape[0] // eye.height
    return seen.reshape(eye.height, parts, eye.width, parts).mean(axis=(1, 3), dtype=np.float32)


def visible(
    seen: Sight, eye: Eye, name: str, points: Float64[np.ndarray, "n 3"], radius_mm: float | Float64[np.ndarray, "n"]
) -> Bool[np.ndarray, "n"]:
    """Whether the eye sees the strand at these points of its centreline, and not another stretch in front of them."""
    parts = seen.index.shape[0] // eye.height
    own_frame = eye.seen_from(points)
    column, row = np.floor(parts * (eye.project(points) + 0.5)).astype(np.int64).T
    inside = (column >= 0) & (column < parts * eye.width) & (row >= 0) & (row < parts * eye.height)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    own = seen.covers(name)[row, column]
    distance = np.linalg.norm(own_frame, axis=1)
    along = np.gradient(own_frame, axis=0)
    cosine = np.einsum("ij,ij->i", along, own_frame) / (np.linalg.norm(along, axis=1) * distance)
    # a ray to the axis enters a tube that it meets at a slant so much before
    ahead = radius_mm / np.sqrt(np.maximum(1.0 - cosine**2, LEAST_SLANT**2))
    gap = distance - ahead - seen.distance_mm[row, column]
    return inside & own & (np.abs(gap) < 0.5 * ahead + RELIEF_MM)


def _covering(eye: Eye) -> Eye:
    """A plain pinhole at the same place that sees all that the eye sees, about as finely."""
    aside, down = np.abs(eye.ray_slopes).reshape(-1, 2).max(axis=0)
    focal = float(max(eye.K[0, 0], eye.K[1, 1]))
    width, height = (2 * int(np.ceil(focal * reach + 2.0)) for reach in (aside, down))
    K = np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
    return Eye(width, height, K, R_eye_left=eye.R_eye_left, t_eye_left=eye.t_eye_left)


def _where(
    eye: Eye, parts: int, lens: Eye, lens_parts: int
) -> tuple[Float32[np.ndarray, "H W"], Float32[np.ndarray, "H W"]]:
    """Column and row, in the parts of the lens's image, of the middle of every part of the eye's pixels."""
    slopes = eye.ray_slopes
    # slopes change smoothly, so that what lies between pixel centres is interpolated; borders go on straight
    padded = cv2.copyMakeBorder(slopes, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    padded[0], padded[-1] = 2 * padded[1] - padded[2], 2 * padded[-2] - padded[-3]
    padded[:, 0], padded[:, -1] = 2 * padded[:, 1] - padded[:, 2], 2 * padded[:, -2] - padded[:, -3]
    fine = cv2.resize(padded, None, fx=parts, fy=parts, interpolation=cv2.INTER_LINEAR)[parts:-parts, parts:-parts]
    u = lens_parts * (lens.focal_px * fine[..., 0] + 0.5 * lens.width) - 0.5
    v = lens_parts * (lens.focal_px * fine[..., 1] + 0.5 * lens.height) - 0.5
    return u.astype(np.float32), v.astype(np.float32)


def _sensor(eye: Eye, parts: int, first_row: int = 0, rows: int | None = None) -> Any:
    mi = engine()
    # Mitsuba's camera looks along +z with +y up and +x to the left; this turns it into the OpenCV frame
    pose = np.eye(4)
    pose[:3, :3] = eye.R_eye_left.T @ np.diag([-1.0, -1.0, 1.0])
    pose[:3, 3] = -eye.R_eye_left.T @ eye.t_eye_left
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
                "crop_offset_x": 0,
                "crop_offset_y": first_row,
                "crop_width": parts * eye.width,
                "crop_height": parts * eye.height if rows is None else rows,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
            "sampler": {"type": "independent", "sample_count": 1},
        }
    )
