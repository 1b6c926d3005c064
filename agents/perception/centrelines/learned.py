"""Where the middle of the thread lies, by what a small network has learned of how threads look across.

Light from one side shifts what looks like the middle, and no single profile tells for certain which side that is. So
the network looks along the thread, and at all of it: what is lopsided about profiles, as far as it follows a direction
in the image, is the light. With q the lopsided features of a point and n its normal, the A of q = A n by least squares
is the light's part, and A n what light does at each point. docs/model_card.md says what the network has learned from.

What it sees is the thread straightened: what the image shows across points of a curve, in units that all threads share.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from agents.perception.centrelines.along import Pieces, gaussian, smoothed
from agents.perception.centrelines.mixture import mean_colour, mixture_weights, weighted
from agents.perception.centrelines.profiles import by_channel, sample

WEIGHTS = Path(__file__).with_name("learned.npz")
DILATIONS = 1, 2, 4, 8, 16
"""Of layers, each of which looks at five points. The project's own network has the first four of them, and looks at 31
points to either side; one that is trained now has them all."""
STEPS = np.arange(-2, 3)
NOTHING = np.float32(0)
LOG_SCALE, DEVIATION_SHARE = (-4.0, 2.0), 1.35
"""The network says the mean error of a Laplace distribution, of which 68 % lie within 1.15 times that. But neighbours
err alike, and with them a whole scene: with this share curves of held-out scenes are as likely as with 1.15, and in the
worst of them more of the truth lies where it is said to."""
LEAST_SPREAD = 0.05
"""Of directions: with fewer, the light across the missing one is not known."""
Weights = Mapping[str, Float32[np.ndarray, "..."]]


@dataclass(frozen=True)
class Learned:
    """Where the middle lies on each profile, in pixels along the normal, and its standard deviation."""

    offset_px: Float64[np.ndarray, "n"]
    deviation_px: Float64[np.ndarray, "n"]


def learned_middles(
    seen: Float32[np.ndarray, "n c"],
    normal: Float64[np.ndarray, "n 2"],
    pieces: Pieces,
    weights: Weights | None = None,
    every_second: bool = False,
) -> Learned:
    """What the network says of profiles along the normals of a curve, as `straightened` gives them.

    Args:
        weights: of the network; the project's own, if they are None.
        every_second: of every second point of each piece, and its last one, alone. All layers but the first look at
            such points in any case, so that it is the same for half of the work.
    """
    weights = weights or own_weights()
    across = np.tanh(seen @ weights["light"])
    n = normal.astype(np.float32)
    spread = n.T @ n / len(n) + LEAST_SPREAD * np.eye(2, dtype=np.float32)
    light = np.linalg.solve(spread, n.T @ across / len(n))
    state = seen @ weights["first"]
    state += (n @ light) @ weights["from_light"]
    state = _positive(state, weights["first_bias"])
    layers = sum(f"along{layer}" in weights for layer in range(len(DILATIONS)))
    for layer, dilation in enumerate(DILATIONS[:layers]):
        some, told, here = np.arange(len(state)), pieces, state
        if every_second and layer == 0:
            some, told = pieces.every_second
            here = state[some]
        step = dilation // 2 if every_second and layer > 0 else dilation
        seen_along = _neighbours(state, pieces, some, step) @ weights[f"along{layer}"]
        state, pieces = _positive(seen_along, weights[f"along{layer}_bias"]), told
        state += here
    offset, log_scale = (state @ weights["out"] + weights["out_bias"]).astype(np.float64).T
    return Learned(offset, DEVIATION_SHARE * np.exp(np.clip(log_scale, *LOG_SCALE)))


def _positive(total: Float32[np.ndarray, "n k"], bias: Float32[np.ndarray, "k"]) -> Float32[np.ndarray, "n k"]:
    """What a layer says of sums, which are overwritten."""
    total += bias
    return np.maximum(total, NOTHING, out=total)


def _neighbours(
    state: Float32[np.ndarray, "n c"], pieces: Pieces, some: Int64[np.ndarray, "m"], dilation: int
) -> Float32[np.ndarray, "m k"]:
    """About some points, the states of five of the piece, so many points apart; the last goes on for ever."""
    number = pieces.number[some]
    first, last = pieces.first[number, None], pieces.last[number, None]
    places = some[:, None] + dilation * STEPS
    return state.take(np.minimum(np.maximum(places, first), last), axis=0).reshape(len(some), -1)


def weights_in(path: Path) -> Weights:
    """The weights that a file of NumPy's holds."""
    with np.load(path) as file:
        return {name: file[name].astype(np.float32) for name in file.files}


@functools.cache
def own_weights() -> Weights:
    """The project's own weights."""
    return weights_in(WEIGHTS)


PLACES = np.linspace(-1.0, 1.0, 25, dtype=np.float32)
"""Where a profile is seen, as shares of its reach."""
BEYOND_PX = 3.0
"""A profile reaches a width and so much to either side: blur is in pixels however thin the thread is."""
GROUND_FROM_PX, THREAD_SHARE, THREAD_PX = 1.5, 0.25, 0.25
"""The ground is what lies farther from the edges; the thread's colour is that of its middle half, and a bit."""
PLAIN, PLAIN_STRIDE = 3.0, 8
"""Grey levels: half of a plain ground differs by less from its median, and half of any tissue by twice as much.

Of the points at which it is seen, one in eight tells."""
ALONG = 4.0
"""Standard deviation, in points, of the average along the thread in which both colours are seen."""
WIDTH_ALONG_PX = 8.0
LEAST_WIDTH, MOST_WIDTH = 0.6, 1.5
"""Of the whole thread's: what is narrower or wider was misjudged."""
NARROWEST_PX, WIDEST_PX = 1.0, 40.0
LEAST_SHARE, MOST_SHARE = -4.0, 4.0
LEAST_CONTRAST = 8.0
USUAL_WIDTH_PX, USUAL_CONTRAST, USUAL_LEVEL = 5.0, 30.0, 100.0


def usual_width_px(
    width_px: Float64[np.ndarray, "n"], pieces: Pieces, apart_px: float = 1.0
) -> Float64[np.ndarray, "n"]:
    """The thread's width hereabouts, whatever single profiles say.

    Args:
        apart_px: how far points lie from each other.
    """
    typical = np.median(width_px)
    clipped = np.clip(width_px, LEAST_WIDTH * typical, MOST_WIDTH * typical)[:, None]
    return smoothed(clipped, pieces, gaussian(WIDTH_ALONG_PX / apart_px))[:, 0].clip(NARROWEST_PX, WIDEST_PX)


def reach_px(width_px: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """How far a profile of a thread of that width reaches to either side."""
    return width_px + BEYOND_PX


def seen_across(
    image: UInt8[np.ndarray, "h w 3"],
    point: Float64[np.ndarray, "n 2"],
    normal: Float64[np.ndarray, "n 2"],
    reach: Float64[np.ndarray, "n"],
    places: Float32[np.ndarray, "t"] = PLACES,
) -> UInt8[np.ndarray, "t n 3"]:
    """Colours across each point, from -reach to reach along its normal."""
    return sample(image, point, normal, places[:, None] * reach, cv2.BORDER_REPLICATE)


def has_plain_ground(
    colour: Float32[np.ndarray, "t n 3"],
    width_px: Float64[np.ndarray, "n"],
    places: Float32[np.ndarray, "t"] = PLACES,
) -> bool:
    """Whether the ground is of one colour everywhere beside the thread."""
    some, width = colour[:, ::PLAIN_STRIDE], width_px[::PLAIN_STRIDE]
    ground = some[np.abs(places)[:, None] * reach_px(width) > width / 2 + GROUND_FROM_PX]
    channels = np.ascontiguousarray(ground.T)
    usual = np.array([np.median(channel) for channel in channels])
    away = np.abs(channels - usual[:, None])
    return float(np.median(away.mean(axis=0))) < PLAIN


def straightened(
    colour: Float32[np.ndarray, "t n 3"], width_px: Float64[np.ndarray, "n"], pieces: Pieces
) -> Float32[np.ndarray, "n c"]:
    """Profiles in units that all threads share; their reach is that of their width.

    Of each place: its colour less the ground's, over the contrast; its brightness against the ground's; and how much of
    the thread's colour and of the ground's it shows. Then both colours and their contrast, and the width.
    """
    width, channels = width_px.astype(np.float32), by_channel(colour)
    off = np.abs(PLACES)[:, None] * (width + np.float32(BEYOND_PX))
    ground = mean_colour(channels, off > width / 2 + GROUND_FROM_PX, pieces, ALONG)
    thread = mean_colour(channels, off < width * THREAD_SHARE + THREAD_PX, pieces, ALONG)
    contrast = np.sqrt(np.square(thread - ground).mean(axis=0)) + LEAST_CONTRAST
    colours = [(channel - of_ground) * (1 / contrast) for channel, of_ground in zip(channels, ground, strict=True)]
    brightness = 1 / (ground.sum(axis=0) + 3 * LEAST_CONTRAST)
    against_ground = np.stack((brightness, brightness, brightness, np.full_like(brightness, -1)))
    mixtures = [weighted(channels, weights) for weights in (against_ground, *mixture_weights(thread, ground))]
    places = np.stack((*colours, *mixtures), axis=1).clip(LEAST_SHARE, MOST_SHARE)
    of_ground = ground.mean(axis=0)
    seen = np.concatenate(
        (
            places.reshape(-1, len(width)),
            np.log(width / USUAL_WIDTH_PX)[None],
            np.log(contrast / USUAL_CONTRAST)[None],
            (thread - ground) / contrast,
            ground / (of_ground + LEAST_CONTRAST) - 1,
            of_ground[None] / USUAL_LEVEL - 1,
        )
    )
    return seen.T
