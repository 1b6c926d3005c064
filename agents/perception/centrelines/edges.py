"""The thread's two edges in the image itself, for masks that say which pixels are thread but not how much of each.

Shading and glints make the brightness across a round thread lopsided, so its own centroid is of no use. Its colour
against the ground's is told by Fisher's linear discriminant, which suppresses what varies along the thread anyway, and
in that one channel an edge is the centre of squared gradients of the right sign near the mask's border.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

COLOUR_NOISE = 5.0
"""Grey levels; keeps the discriminant from trusting colours that hardly vary, as in grey images."""
GAP_PX, BAND_PX = 2, 8
"""The ground is what lies farther than the one, and within the other, from the mask."""
REACH_PX = 3.5
"""How far from where it was looked for an edge may draw, with a weight that falls to zero there."""
ROUNDS = 3
WEAK = 1.0
"""Squared grey levels; an edge of less stays where the mask puts it."""


@dataclass(frozen=True)
class Edges:
    """Where the thread begins and ends on each profile, in pixels from the curve along the normal."""

    near_px: Float64[np.ndarray, "n"]
    far_px: Float64[np.ndarray, "n"]


def contrast_channel(image: UInt8[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """The image near the mask in the one channel that tells thread from ground best, in which the thread is higher."""
    band = _grown(mask, BAND_PX)
    ground = band & ~_grown(mask, GAP_PX)
    fewer = np.s_[::2, ::2]
    thread_colours, ground_colours = image[fewer][mask[fewer]], image[fewer][ground[fewer]]
    direction = _discriminant(thread_colours, ground_colours)
    level = ground_colours.mean(axis=0) @ direction if len(ground_colours) else 0.0
    # no profile reaches beyond the band, so that the ground's level does there
    channel = np.full(mask.size, level, np.float32)
    index = np.flatnonzero(band)
    channel[index] = image.reshape(-1, 3)[index].astype(np.float32) @ direction.astype(np.float32)
    return channel.reshape(mask.shape)


def _discriminant(thread: UInt8[np.ndarray, "p 3"], ground: UInt8[np.ndarray, "q 3"]) -> Float64[np.ndarray, "3"]:
    """The unit direction among colours in which thread and ground lie apart most, against how they vary."""
    if len(thread) < 2 or len(ground) < 2:
        return np.zeros(3)
    apart = thread.mean(axis=0) - ground.mean(axis=0)
    scatter = np.cov(thread.T) + np.cov(ground.T) + COLOUR_NOISE**2 * np.eye(3)
    direction = np.linalg.solve(scatter, apart)
    return direction / max(float(np.linalg.norm(direction)), 1e-9)


def find_edges(
    profile: Float32[np.ndarray, "n t"],
    at: Float64[np.ndarray, "t"],
    middle_px: Float64[np.ndarray, "n"],
    width_px: Float64[np.ndarray, "n"],
) -> Edges:
    """Both edges on profiles of the contrast channel, looked for where the mask ends."""
    gradient = np.gradient(profile, axis=1) * _sign(profile, at, middle_px, width_px)[:, None]
    near, far = middle_px - width_px / 2, middle_px + width_px / 2
    rising, falling = np.maximum(gradient, 0) ** 2, np.maximum(-gradient, 0) ** 2
    return Edges(_settled(rising, at, near), _settled(falling, at, far))


def _sign(
    profile: Float32[np.ndarray, "n t"],
    at: Float64[np.ndarray, "t"],
    middle_px: Float64[np.ndarray, "n"],
    width_px: Float64[np.ndarray, "n"],
) -> Float32[np.ndarray, "n"]:
    """1 where the thread is brighter than the ground beside it in the channel, −1 where it is darker."""
    distance = np.abs(at.astype(np.float32) - middle_px.astype(np.float32)[:, None])
    half = np.maximum(0.5, width_px / 2).astype(np.float32)[:, None]
    inside, outside = distance <= half, distance > half + 1
    contrast = (profile * inside).sum(axis=1) / np.maximum(inside.sum(axis=1), 1)
    contrast -= (profile * outside).sum(axis=1) / np.maximum(outside.sum(axis=1), 1)
    return np.where(contrast < 0, np.float32(-1), np.float32(1))


def _settled(
    energy: Float32[np.ndarray, "n t"], at: Float64[np.ndarray, "t"], start: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "n"]:
    edge, steps = start, at.astype(np.float32)
    for _ in range(ROUNDS):
        distance = (steps - edge.astype(np.float32)[:, None]) * np.float32(1 / REACH_PX)
        weight = np.square(np.maximum(1 - distance * distance, 0)) * energy
        total = weight.sum(axis=1, dtype=np.float64)
        edge = (weight @ steps + WEAK * start) / (total + WEAK)
    return np.clip(edge, start - REACH_PX, start + REACH_PX)


def _grown(mask: Bool[np.ndarray, "h w"], radius: int) -> Bool[np.ndarray, "h w"]:
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return np.asarray(cv2.dilate(mask.astype(np.uint8), kernel)) > 0
