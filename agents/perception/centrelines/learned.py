"""Where the middle of the thread lies, by what a small network has learned of how threads look across.

Light from one side shifts what looks like the middle, and no single profile tells for certain which side that is. So
the network looks along the thread, and at all of it: what is lopsided about profiles, as far as it follows a direction
in the image, is the light. With q the lopsided features of a point and n its normal, the A of q = A n by least squares
is the light's part, and A n what light does at each point. docs/model_card.md says what the network has learned from.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, Int64

from agents.perception.centrelines.along import Pieces

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
