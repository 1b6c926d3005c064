"""Tools painted in front of a render, so that they hide a stretch of its thread in both images as one body would.

A tool is a straight shaft with a round tip that comes in from outside the image, flat and parallel to the image plane,
nearer than any of the thread. So it has one disparity, larger than all of the thread's, and hides other places in the
right image than in the left one.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.cli.reconstruct.pipeline import Pair
from schemas.messages import RectifiedStereo
from shared.camera import project

LEAST_HIDDEN, MOST_HIDDEN = 0.30, 0.45
"""Share of the thread that either image misses."""
END_SHARE = 0.05
"""Of the thread at either end, which stays visible: nobody can know how far a thread goes on behind a tool."""
NEARER = 0.92
"""Depth of the tool as a share of the thread's nearest."""
TRIES, CANDIDATES = 2000, 4
REACH_PX = 4000.0
EDGE_PX = 1.0
"""Half the width over which the tool's border blends with what lies behind it."""


@dataclass(frozen=True)
class Shaft:
    """A tool in pixels of the left image; in the right image it lies `disparity_px` further left."""

    tip: Float64[np.ndarray, "2"]
    direction: Float64[np.ndarray, "2"]
    half_width_px: float
    disparity_px: float

    def distance(self, px: Float64[np.ndarray, "n 2"], eye: int) -> Float64[np.ndarray, "n"]:
        """How far pixels of an image lie from the shaft's axis."""
        offset = px - self.tip + (eye * self.disparity_px, 0.0)
        along = np.clip(offset @ self.direction, 0.0, REACH_PX)
        return np.linalg.norm(offset - along[:, None] * self.direction, axis=1)

    def hides(self, camera: RectifiedStereo, points: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n 2"]:
        """Which points the tool hides from the left and from the right camera."""
        distance = [self.distance(px, eye) for eye, px in enumerate(project(camera, points))]
        return np.column_stack(distance) < self.half_width_px

    def paint(
        self, image: UInt8[np.ndarray, "h w 3"], mask: UInt8[np.ndarray, "h w"], eye: int
    ) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w"]]:
        """The image with the tool in it, and the mask without what it hides."""
        height, width = mask.shape
        v, u = np.mgrid[:height, :width].astype(np.float64)
        distance = self.distance(np.column_stack((u.ravel(), v.ravel())), eye).reshape(height, width)
        cover = np.clip(0.5 + 0.5 * (self.half_width_px - distance) / EDGE_PX, 0.0, 1.0)
        # a metal cylinder, lit from the front: bright along its axis, dark at its borders
        shade = 40.0 + 150.0 * np.sqrt(np.clip(1.0 - (distance / self.half_width_px) ** 2, 0.0, 1.0))
        metal = shade[..., None] * (1.0, 0.97, 0.94)
        blended = cover[..., None] * metal + (1.0 - cover[..., None]) * image
        return np.rint(blended).astype(np.uint8), np.rint((1.0 - cover) * mask).astype(np.uint8)

    def painted(self, images: Pair, masks: Pair) -> tuple[Pair, Pair]:
        """Both images with the tool in them, and the masks without what it hides."""
        left, right = (self.paint(*of, eye) for eye, of in enumerate(zip(images, masks, strict=True)))
        return (left[0], right[0]), (left[1], right[1])


def hiding_shaft(
    camera: RectifiedStereo, truth: Float64[np.ndarray, "n 3"], visible: Bool[np.ndarray, "n 2"], seed: int
) -> Shaft:
    """A tool that hides 30 to 45 % of a thread from either camera, and no end of it.

    Each tool drawn from the seed has just the width that hides enough; of the first few that do, the thinnest is taken.

    Raises:
        ValueError: where none of them leaves both ends in sight.
    """
    random = np.random.default_rng(seed)
    pixels = project(camera, truth)
    disparity = camera.fx_px * camera.baseline / (NEARER * float(truth[:, 2].min()))
    end = max(1, round(END_SHARE * len(truth)))
    found: list[Shaft] = []
    for _ in range(TRIES):
        angle, over = random.uniform(0.0, 2.0 * np.pi), random.uniform(0.0, 60.0)
        direction = np.array([np.cos(angle), np.sin(angle)])
        passes = pixels[0][int(random.uniform(0.2, 0.8) * len(truth))]
        axis = Shaft(passes - over * direction, direction, 1.0, disparity)
        distance = np.column_stack([axis.distance(px, eye) for eye, px in enumerate(pixels)])
        half_width = float(np.quantile(np.where(visible, distance, -1.0), LEAST_HIDDEN, axis=0).max()) + EDGE_PX
        shaft = Shaft(axis.tip, direction, half_width, disparity)
        covered = distance < half_width
        missed = (covered | ~visible).mean(axis=0)
        if (missed <= MOST_HIDDEN).all() and not (covered[:end].any() or covered[-end:].any()):
            found.append(shaft)
        if len(found) == CANDIDATES:
            break
    if not found:
        raise ValueError("no tool hides enough of this thread and leaves both ends in sight")
    return min(found, key=lambda shaft: shaft.half_width_px)
