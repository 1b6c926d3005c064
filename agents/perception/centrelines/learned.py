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
from jaxtyping import Float32, Float64

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
) -> Learned:
    """What the network says of profiles along the normals of a curve, as `straightened` gives them.

    Args:
        weights: of the network; the project's own, if they are None.
    """
    weights = weights or own_weights()
    across = np.tanh(seen @ weights["light"])
    n = normal.astype(np.float32)
    spread = n.T @ n / len(n) + LEAST_SPREAD * np.eye(2, dtype=np.float32)
    light = np.linalg.solve(spread, n.T @ across / len(n))
    state = np.maximum(seen @ weights["first"] + (n @ light) @ weights["from_light"] + weights["first_bias"], NOTHING)
    layers = sum(f"along{layer}" in weights for layer in range(len(DILATIONS)))
    for layer, dilation in enumerate(DILATIONS[:layers]):
        seen_along = _neighbours(state, pieces, dilation)
        state = state + np.maximum(seen_along @ weights[f"along{layer}"] + weights[f"along{layer}_bias"], NOTHING)
    offset, log_scale = (state @ weights["out"] + weights["out_bias"]).astype(np.float64).T
    return Learned(offset, DEVIATION_SHARE * np.exp(np.clip(log_scale, *LOG_SCALE)))


def _neighbours(state: Float32[np.ndarray, "n c"], pieces: Pieces, dilation: int) -> Float32[np.ndarray, "n k"]:
    """The states of five points of the piece, so many points apart, one after the other; the last goes on for ever."""
    first, last = pieces.first[pieces.number, None], pieces.last[pieces.number, None]
    places = np.arange(len(state))[:, None] + dilation * STEPS
    return state.take(np.minimum(np.maximum(places, first), last), axis=0).reshape(len(state), -1)


def weights_in(path: Path) -> Weights:
    """The weights that a file of NumPy's holds."""
    with np.load(path) as file:
        return {name: file[name].astype(np.float32) for name in file.files}


@functools.cache
def own_weights() -> Weights:
    """The project's own weights."""
    return weights_in(WEIGHTS)
