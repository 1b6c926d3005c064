"""What both eyes show across a thread at the same places, in numbers that a network is shown."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from agents.perception.both_eyes.same_places import APART_PX, SamePlaces, between
from agents.perception.centrelines.along import Pieces, blurred, gaussian
from agents.perception.centrelines.learned import (
    BEYOND_PX,
    GROUND_FROM_PX,
    LEAST_CONTRAST,
    has_plain_ground,
    reach_px,
    usual_width_px,
)
from agents.perception.centrelines.profiles import sample
from schemas.messages import Centrelines

Image = UInt8[np.ndarray, "h w 3"]
PLACES = np.linspace(-1.0, 1.0, 33, dtype=np.float32)
"""Where a profile is seen, as shares of its reach."""
ALONG = 1.0
"""Standard deviation, in places eight pixels apart, of the average along the thread."""
MOST_CONTRASTS = 3.0
USUAL_WIDTH_PX = 5.0
LEFT, RIGHT = 0, 1


@dataclass(frozen=True)
class Eye:
    """What one eye shows at n places.

    Fields:
        colour: across the line at t shares of the reach, averaged along it.
        width_px: hereabouts.
        log_deviation: the logarithm of what the middle may err, in pixels.
        normal: of the line; to the same side of the thread in both eyes.
    """

    colour: Float32[np.ndarray, "t n 3"]
    width_px: Float64[np.ndarray, "n"]
    log_deviation: Float64[np.ndarray, "n"]
    normal: Float64[np.ndarray, "n 2"]


@dataclass(frozen=True)
class Shown:
    """At n places of both eyes, left and right.

    Fields:
        seen: colours at PLACES about the middle, less the ground's, over the contrast that both eyes have in common.
        log_deviation: the logarithm of what each middle may err, in pixels.
        normal: of the left eye, or in a mirror the one that is the left one there.
        width_px: the mean of both.
    """

    seen: Float32[np.ndarray, "2 n t 3"]
    log_deviation: Float32[np.ndarray, "2 n"]
    normal: Float32[np.ndarray, "2 n 2"]
    width_px: Float32[np.ndarray, "n"]


def shown_in_both(
    images: tuple[Image, Image], lines: tuple[Centrelines, Centrelines], places: SamePlaces
) -> Shown | None:
    """What rectified images show about the same places of their centrelines; None over a plain ground.

    That casts no light on a thread and shows no edges but the thread's: nothing beats those.
    """
    left, right = eyes_of(images, lines, places)
    if any(has_plain_ground(eye.colour, eye.width_px, PLACES) for eye in (left, right)):
        return None
    return together(left, right)


def eyes_of(
    images: tuple[Image, Image],
    lines: tuple[Centrelines, Centrelines],
    places: SamePlaces,
    shares: Float32[np.ndarray, "t"] = PLACES,
) -> tuple[Eye, Eye]:
    """What the left and the right eye show across their lines, at shares of the reach."""
    left_at = places.left_at.astype(np.float64)
    return (
        _seen_by(images[LEFT], lines[LEFT], left_at, places.left_normal, places.stretches, shares),
        _seen_by(images[RIGHT], lines[RIGHT], places.right_at, places.right_normal, places.stretches, shares),
    )


def _seen_by(
    image: Image,
    line: Centrelines,
    at: Float64[np.ndarray, "n"],
    normal: Float64[np.ndarray, "n 2"],
    stretches: Pieces,
    shares: Float32[np.ndarray, "t"],
) -> Eye:
    values = between(np.column_stack((line.point_px, line.width_px, line.deviation_px)), at)
    width = usual_width_px(values[:, 2], stretches, APART_PX)
    seen = sample(image, values[:, :2], normal, shares[:, None] * reach_px(width), cv2.BORDER_REPLICATE)
    return Eye(blurred(seen, stretches, gaussian(ALONG)), width, np.log(values[:, 3]), normal)


def together(left: Eye, right: Eye) -> Shown:
    """What both eyes show at PLACES."""
    width = 0.5 * (left.width_px + right.width_px)
    return Shown(
        _in_contrasts(np.stack((left.colour.swapaxes(0, 1), right.colour.swapaxes(0, 1))), width),
        np.stack((left.log_deviation, right.log_deviation)).astype(np.float32),
        np.stack((left.normal, right.normal)).astype(np.float32),
        width.astype(np.float32),
    )


def _in_contrasts(
    colours: Float32[np.ndarray, "2 n t 3"], width_px: Float64[np.ndarray, "n"]
) -> Float32[np.ndarray, "2 n t 3"]:
    """Less the ground's colour and over the contrast that both eyes have in common: what they differ by stays."""
    off = np.abs(PLACES) * (width_px + BEYOND_PX)[:, None].astype(np.float32)
    beside = (off > (width_px / 2 + GROUND_FROM_PX)[:, None]).astype(np.float32)
    total = np.einsum("entc,nt->nc", colours, beside)
    ground = total / np.maximum(2 * beside.sum(axis=1, keepdims=True), 1)
    less = colours - ground[:, None]
    middle = 0.5 * (less[LEFT] + less[RIGHT])
    contrast = np.sqrt(np.square(middle, out=middle).mean(axis=(1, 2))) + np.float32(LEAST_CONTRAST)
    return np.clip(less / contrast[:, None, None], -MOST_CONTRASTS, MOST_CONTRASTS).astype(np.float32)


def numbers(shown: Shown) -> Float32[np.ndarray, "n f"]:
    """What a network is shown of each place."""
    seen, deviation, n = shown.seen, shown.log_deviation, len(shown.width_px)
    left, right = shown.normal
    parts = (
        (0.5 * (seen[LEFT] + seen[RIGHT])).reshape(n, -1),
        2 * (seen[LEFT] - seen[RIGHT]).reshape(n, -1),
        np.stack((deviation.sum(axis=0), deviation[LEFT] - deviation[RIGHT]), axis=1),
        np.log(shown.width_px / USUAL_WIDTH_PX)[:, None],
        0.5 * (left + right),
        5 * (left - right),
        left[:, :1] * shown.width_px[:, None] / USUAL_WIDTH_PX,
    )
    return np.concatenate(parts, axis=1, dtype=np.float32)


def from_other_side(shown: Shown) -> Shown:
    """Profiles read from their other side, with the normals turned round."""
    return Shown(shown.seen[:, :, ::-1], shown.log_deviation, -shown.normal, shown.width_px)
