"""Laying a shaded tube and its shadow over an image, in display values (0 to 255, blue first)."""

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from schemas.messages import RectifiedStereo
from shared.rendering.backdrop_files import Light
from shared.rendering.centreline import NEAR_MM, Centreline
from shared.rendering.surface import Surface, depth_at_points
from shared.rendering.tissue import light_positions
from shared.rendering.tube import TubePixels

BRAID_PITCH_MM = 0.7
SHADOW_STRENGTH = 0.30
SHADOW_SIGMA_PX = 2.2
SHADOW_STEPS = 4
"""Every how many samples of the centreline cast a shadow: it is soft, so that corners do not show."""


def shade_tube(
    tube: TubePixels, bgr: tuple[float, float, float], light: Float64[np.ndarray, "n"] | float = 1.0
) -> Float64[np.ndarray, "n 3"]:
    """Colours of a tube lit from beside the camera: dark limbs, a braid, and a bright ridge where it lies flat.

    `light` scales all of it, as the vignette does at each pixel.
    """
    across = 0.92 * tube.across
    facing = np.sqrt(1.0 - across**2) * tube.slant
    turn = np.arcsin(across)
    phase = 2.0 * np.pi * tube.arc_mm / BRAID_PITCH_MM
    braid = 1.0 + 0.07 * np.cos(phase + turn) * np.cos(phase - turn)
    diffuse = (0.40 + 0.65 * facing) * braid
    gloss = 20.0 * np.exp(-0.5 * (across / 0.3) ** 2) * tube.slant**8
    ridge = gloss * (0.8 + 0.2 * np.cos(phase + 2.0 * turn))
    return (np.array(bgr) * diffuse[:, None] + ridge[:, None]) * np.reshape(light, (-1, 1))


def lay_over(image: UInt8[np.ndarray, "h w 3"], tube: TubePixels, colours: Float64[np.ndarray, "n 3"]) -> None:
    """Blend the tube's pixels into the image in place, farther strands before nearer ones."""
    pixels = image.reshape(-1, 3)
    for layer in layers_of(tube.flat):
        flat, cover = tube.flat[layer], tube.coverage[layer, None]
        below = pixels[flat]
        pixels[flat] = np.clip(np.rint(below + cover * (colours[layer] - below)), 0.0, 255.0).astype(np.uint8)


def layers_of(flat: Int64[np.ndarray, "n"]) -> list[Int64[np.ndarray, "m"]]:
    """Index lists within each of which no pixel comes twice, in the order in which they are to be laid."""
    new = np.concatenate(([True], np.diff(flat) != 0))[: len(flat)]
    rank = np.arange(len(flat)) - np.maximum.accumulate(np.where(new, np.arange(len(flat)), 0))
    return [np.flatnonzero(rank == layer) for layer in range(rank.max(initial=-1) + 1)]


def cast_shadow(
    image: UInt8[np.ndarray, "h w 3"],
    camera: RectifiedStereo,
    surface: Surface,
    centreline: Centreline,
    radius_mm: float,
    eye_x_mm: float,
    lights: tuple[Light, ...] = (),
) -> None:
    """Darken, in place, where the thread keeps a light from the surface; the centreline is in the left frame.

    Without `lights` it is the light renderer's two.
    """
    points = centreline.points_camera[::SHADOW_STEPS]
    points = points[points[:, 2] > NEAR_MM]
    if len(points) < 2:
        return
    dark = np.zeros(image.shape[:2], dtype=np.uint8)
    for light in lights or own_lights(camera):
        shadow = _thrown_on(surface, points, np.array(light.place_mm))
        one = np.zeros_like(dark)
        _draw(one, camera, shadow, radius_mm, eye_x_mm)
        dark = cv2.addWeighted(dark, 1.0, one, light.share, 0.0)
    box = _box_of(dark, round(4 * SHADOW_SIGMA_PX))
    soft = cv2.GaussianBlur(dark[box], (0, 0), SHADOW_SIGMA_PX)
    keep = cv2.merge([cv2.convertScaleAbs(soft, alpha=-2.0 * SHADOW_STRENGTH, beta=255.0)] * 3)
    image[box] = cv2.multiply(image[box], keep, scale=1.0 / 255.0)


def own_lights(camera: RectifiedStereo) -> tuple[Light, ...]:
    """The light renderer's bundles beside the lens, which are alike."""
    places = light_positions(camera).tolist()
    return tuple(Light((x, y, z), 1.0 / len(places)) for x, y, z in places)


def _thrown_on(
    surface: Surface, points: Float64[np.ndarray, "n 3"], source: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "n 3"]:
    """Where light from the source through each point meets the surface."""
    direction = points - source
    landed = points
    for _ in range(4):
        depth = depth_at_points(surface, landed[:, :2])
        landed = source + direction * ((depth - source[2]) / direction[:, 2])[:, None]
    return landed


def _draw(
    image: UInt8[np.ndarray, "h w"],
    camera: RectifiedStereo,
    points: Float64[np.ndarray, "n 3"],
    radius_mm: float,
    eye_x_mm: float,
) -> None:
    u = camera.fx_px * (points[:, 0] - eye_x_mm) / points[:, 2] + camera.cx_px
    v = camera.fy_px * points[:, 1] / points[:, 2] + camera.cy_px
    pixels = np.rint(16.0 * np.clip(np.column_stack((u, v)), -2000.0, 6000.0)).astype(np.int32)
    width = max(round(float(2.0 * radius_mm * camera.fx_px / np.median(points[:, 2]))), 1)
    cv2.polylines(image, [pixels.reshape(-1, 1, 2)], False, 255, width, cv2.LINE_8, 4)


def _box_of(mask: UInt8[np.ndarray, "h w"], margin: int) -> tuple[slice, slice]:
    left, top, width, height = cv2.boundingRect(mask)
    return (
        slice(max(top - margin, 0), min(top + height + margin, mask.shape[0])),
        slice(max(left - margin, 0), min(left + width + margin, mask.shape[1])),
    )
