"""The look of wet tissue, and its image in either camera.

Colour is made once on the surface's grid and looked up through each camera's own rays, so that the two images
differ as geometry has it; what depends on the eye (gloss) is computed for each. Light comes from two bundles beside
the lens. Values are linear until `to_display`.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from schemas.messages import RectifiedStereo
from shared.rendering.surface import (
    Surface,
    meet_rays,
    ray_tangents,
    rough_field,
    sample_grid,
    smooth_field,
    smooth_step,
)

RED, PALE, DARK = (0.070, 0.120, 0.46), (0.20, 0.29, 0.62), (0.025, 0.04, 0.22)
FAT, ARTERY, VEIN = (0.18, 0.42, 0.58), (0.03, 0.03, 0.25), (0.07, 0.05, 0.16)
"""Linear albedo, blue first."""

LIGHTS_MM = ((-4.5, 1.5, 0.0), (4.5, 1.5, 0.0))
"""Where the light bundles sit, relative to the middle between the cameras."""

GLOSS_EXPONENT = 1500.0
PLAIN_GREY = 206
GAMMA = 1.0 / 2.2


@dataclass(frozen=True)
class Texture:
    """Linear albedo, small-scale slopes (∂z/∂x, ∂z/∂y) and wetness (0 to 1) on the surface's grid."""

    albedo: Float32[np.ndarray, "h w 3"]
    slopes: Float32[np.ndarray, "h w 2"]
    wetness: Float32[np.ndarray, "h w"]


def tissue_texture(surface: Surface, seed: int) -> Texture:
    """Flesh with fat, vessels, fibres and a wet film."""
    rng = np.random.default_rng([seed, 2])
    shape = surface.depth_mm.shape
    mm = 1.0 / surface.step_mm
    albedo = _flesh(rng, shape, mm)
    fat = _fat(rng, shape, mm)
    lobules = 1.0 + 0.10 * smooth_field(rng, shape, 1.2 * mm)
    albedo += fat[..., None] * (np.array(FAT, dtype=np.float32) * lobules[..., None] - albedo)
    for colour, width_mm, count, strength in ((ARTERY, 0.3, 4, 0.55), (VEIN, 0.7, 3, 0.45), (ARTERY, 0.12, 9, 0.4)):
        cover = strength * _vessels(rng, shape, mm, width_mm, count) * (1.0 - 0.75 * fat)
        albedo += cover[..., None] * (np.array(colour, dtype=np.float32) - albedo)
    bumps = 0.28 * smooth_field(rng, shape, 4.5 * mm) + 0.10 * smooth_field(rng, shape, 1.6 * mm)
    bumps += 0.016 * smooth_field(rng, shape, 0.7 * mm) + 0.05 * fat * lobules
    depth = surface.depth_mm + bumps
    slopes = np.dstack((np.gradient(depth, axis=1), np.gradient(depth, axis=0))) / surface.step_mm
    wetness = smooth_step(rough_field(rng, shape, 14.0 * mm, 3), -0.6, 1.2)
    return Texture(np.clip(albedo, 0.0, 1.0), slopes.astype(np.float32), wetness)


def tissue_view(
    camera: RectifiedStereo, surface: Surface, texture: Texture, eye_x_mm: float
) -> tuple[UInt8[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"]]:
    """The image without noise in a camera at (eye_x_mm, 0, 0), and its depth map in mm."""
    p, q = ray_tangents(camera)
    z = meet_rays(surface, p, q, eye_x_mm)
    x, y = eye_x_mm + p * z, q * z
    albedo = sample_grid(texture.albedo, surface, x, y)
    slopes = sample_grid(texture.slopes, surface, x, y)
    diffuse, gloss = _lighting(camera, np.dstack((x, y, z)), slopes, eye_x_mm)
    gloss *= 9.0 * sample_grid(texture.wetness, surface, x, y)
    light = albedo * diffuse[..., None] + np.minimum(gloss, 3.0)[..., None]
    light += 0.12 * cv2.GaussianBlur(np.minimum(light, 2.0), (0, 0), 6.0)
    return to_display(light * vignette(camera, p, q)[..., None]), z


def light_positions(camera: RectifiedStereo) -> Float64[np.ndarray, "l 3"]:
    """The light bundles in the left camera's frame, in mm."""
    return np.add(LIGHTS_MM, (0.5 * camera.baseline, 0.0, 0.0))


def to_display(light: Float32[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Grey levels for linear light: a gamma curve whose highlights roll off softly."""
    value = np.power(np.maximum(light, 0.0), GAMMA)
    knee = 0.8
    rolled = knee + (1.0 - knee) * np.tanh((value - knee) / (1.0 - knee))
    return np.rint(255.0 * np.where(value > knee, rolled, value)).astype(np.uint8)


def vignette(
    camera: RectifiedStereo, p: Float32[np.ndarray, "..."], q: Float32[np.ndarray, "..."]
) -> Float32[np.ndarray, "..."]:
    """How much of the light reaches the image at ray tangents (p, q): falls off towards the corners."""
    corner = (0.5 * camera.image_width / camera.fx_px) ** 2 + (0.5 * camera.image_height / camera.fy_px) ** 2
    return (1.0 - 0.5 * (p * p + q * q) / corner).astype(np.float32)


def _lighting(
    camera: RectifiedStereo,
    points: Float32[np.ndarray, "h w 3"],
    slopes: Float32[np.ndarray, "h w 2"],
    eye_x_mm: float,
) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Diffuse and glossy light of both bundles; brightness is relative to the middle of the scene."""
    normal = np.dstack((slopes, np.full(slopes.shape[:2], -1.0, dtype=np.float32)))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    to_eye = np.array([eye_x_mm, 0.0, 0.0], dtype=np.float32) - points
    to_eye /= np.linalg.norm(to_eye, axis=2, keepdims=True)
    reference = float(np.median(points[..., 2])) ** 2
    diffuse = np.full(points.shape[:2], 0.06, dtype=np.float32)
    gloss = np.zeros(points.shape[:2], dtype=np.float32)
    for light in light_positions(camera):
        to_light = light.astype(np.float32) - points
        square = (to_light**2).sum(axis=2)
        to_light /= np.sqrt(square)[..., None]
        facing = np.maximum((normal * to_light).sum(axis=2), 0.0) * reference / square
        half = to_light + to_eye
        half /= np.linalg.norm(half, axis=2, keepdims=True)
        diffuse += 0.62 * facing
        gloss += 0.5 * np.maximum((normal * half).sum(axis=2), 0.0) ** GLOSS_EXPONENT
    return diffuse, gloss


def _flesh(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Float32[np.ndarray, "h w 3"]:
    """Red that turns pale and dark in patches, with a mottle and faint fibres."""
    pale = smooth_step(rough_field(rng, shape, 22.0 * mm, 4), -0.9, 1.6)[..., None]
    dark = 0.75 * smooth_step(rough_field(rng, shape, 16.0 * mm, 4), 0.5, 2.2)[..., None]
    red, light, deep = (np.array(colour, dtype=np.float32) for colour in (RED, PALE, DARK))
    albedo = red + pale * (light - red)
    albedo += dark * (deep - albedo)
    mottle = 0.09 * rough_field(rng, shape, 3.0 * mm, 4) + 0.06 * smooth_field(rng, shape, 0.3 * mm)
    return albedo * np.maximum(1.0 + mottle, 0.3)[..., None]


def _fat(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Float32[np.ndarray, "h w"]:
    """Cover by patches of fat with ragged edges."""
    field = rough_field(rng, shape, 20.0 * mm, 5)
    return 0.85 * smooth_step(field, 1.05, 1.35)


def _vessels(
    rng: np.random.Generator, shape: tuple[int, int], mm: float, width_mm: float, count: int
) -> Float32[np.ndarray, "h w"]:
    """Cover by wandering vessels that thin out and sometimes branch."""
    image = np.zeros(shape, dtype=np.uint8)
    for _ in range(count):
        start = rng.uniform(0.0, 1.0, 2) * (shape[1], shape[0])
        heading = rng.uniform(0.0, 2.0 * np.pi)
        path = _wander(rng, start, heading, 0.5 * mm)
        _draw_vessel(image, path, width_mm * mm)
        for fork in rng.integers(10, len(path), 2):
            branch = _wander(rng, path[fork], heading + rng.choice((-0.8, 0.8)), 0.5 * mm)
            _draw_vessel(image, branch[: len(branch) // 2], 0.6 * width_mm * mm)
    return cv2.GaussianBlur(image.astype(np.float32) / 255.0, (0, 0), 0.25 * width_mm * mm + 0.6)


def _wander(rng: np.random.Generator, start: np.ndarray, heading: float, step: float) -> np.ndarray:
    turn = cv2.GaussianBlur(rng.normal(0.0, 1.0, (1, 150)), (0, 0), 4.0).ravel() * 0.28
    headings = heading + np.cumsum(turn)
    return start + step * np.cumsum(np.column_stack((np.cos(headings), np.sin(headings))), axis=0)


def _draw_vessel(image: np.ndarray, path: np.ndarray, width: float) -> None:
    """Draw in thirds, each thinner than the one before, since a polyline has one thickness."""
    for third, part in enumerate(np.array_split(np.arange(len(path)), 3)):
        piece = np.rint(path[max(part[0] - 1, 0) : part[-1] + 1] * 16.0).astype(np.int32)
        thickness = max(round(width * (1.0 - 0.25 * third)), 1)
        cv2.polylines(image, [piece.reshape(-1, 1, 2)], False, 255, thickness, cv2.LINE_AA, 4)
