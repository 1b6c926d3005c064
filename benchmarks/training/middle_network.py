"""The network of `centrelines/learned.py` as it is trained, and its weights as NumPy takes them."""
# pyright: reportMissingImports=false, reportUntypedBaseClass=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float32
from torch import nn

from agents.perception.centrelines.learned import DILATIONS, LEAST_SPREAD, PLACES

STATES, LIGHTS, TAPS = 64, 6, 5
DROPPED = 0.1
"""Of the first states, while it learns."""
CHANNELS, NUMBERS = 6, 9
"""Of each place of a profile, and of a profile as a whole, as `learned.straightened` gives them."""
FEATURES = CHANNELS * len(PLACES) + NUMBERS


class MiddleNet(nn.Module):
    """Profiles (v, k, n, c) of stretches of views and their normals (v, k, n, 2) to offsets and logarithms of scale."""

    def __init__(self, states: int = STATES, dilations: Sequence[int] = DILATIONS) -> None:
        super().__init__()
        self.dilations = dilations
        self.first = nn.Linear(FEATURES, states)
        # what is lopsided: the difference of both sides, which changes its sign with the direction of the curve
        self.register_buffer("sides", torch.from_numpy(_difference_of_sides()))
        self.light = nn.Linear(len(_difference_of_sides()), LIGHTS, bias=False)
        self.from_light = nn.Linear(LIGHTS, states, bias=False)
        self.along = nn.ModuleList([nn.Conv1d(states, states, TAPS, dilation=d) for d in dilations])
        self.out = nn.Conv1d(states, 2, 1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, shown: torch.Tensor, normal: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Offset of the middle in pixels, and the logarithm of its mean error, both (v, k, n)."""
        views, stretches, points, _ = shown.shape
        light = self._light(shown.flatten(1, 2), normal.flatten(1, 2))
        of_light = torch.einsum("vknd,vdm->vknm", normal, light)
        state = torch.relu(self.first(shown) + self.from_light(of_light))
        state = nn.functional.dropout(state, DROPPED, self.training)
        state = state.reshape(views * stretches, points, -1).transpose(1, 2)
        for layer, dilation in zip(self.along, self.dilations, strict=True):
            beyond = dilation * (TAPS - 1) // 2
            state = state + torch.relu(layer(nn.functional.pad(state, (beyond, beyond), mode="replicate")))
        offset, scale = self.out(state).reshape(views, stretches, 2, points).unbind(2)
        return offset, scale

    def _light(self, shown: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
        """What is lopsided of each view as far as it follows a direction, by least squares."""
        across = torch.tanh(self.light(shown @ self.sides.T))
        count = normal.shape[1]
        spread = torch.einsum("vnd,vne->vde", normal, normal) / count + LEAST_SPREAD * torch.eye(
            2, device=normal.device
        )
        return torch.linalg.solve(spread, torch.einsum("vnd,vnm->vdm", normal, across) / count)


def weights_of(network: MiddleNet) -> dict[str, Float32[np.ndarray, "..."]]:
    """The weights as `learned_middles` takes them."""
    state = network.state_dict()
    weights = {
        "first": state["first.weight"].T,
        "first_bias": state["first.bias"],
        "light": (state["light.weight"] @ state["sides"]).T,
        "from_light": state["from_light.weight"].T,
        "out": state["out.weight"][:, :, 0].T,
        "out_bias": state["out.bias"],
    }
    for index in range(len(network.along)):
        weights[f"along{index}"] = state[f"along.{index}.weight"].permute(2, 1, 0).flatten(0, 1)
        weights[f"along{index}_bias"] = state[f"along.{index}.bias"]
    return {name: value.cpu().numpy() for name, value in weights.items()}


def started_from(weights: Mapping[str, np.ndarray]) -> MiddleNet:
    """The network that says what these weights say, to learn on from."""
    layers = sum(name.startswith("along") and not name.endswith("_bias") for name in weights)
    network = MiddleNet(weights["first"].shape[1], DILATIONS[:layers])
    given = {name: torch.tensor(np.asarray(value, np.float32)) for name, value in weights.items()}
    state = network.state_dict()
    state["first.weight"], state["first.bias"] = given["first"].T, given["first_bias"]
    state["light.weight"] = given["light"].T @ torch.linalg.pinv(state["sides"])
    state["from_light.weight"] = given["from_light"].T
    state["out.weight"], state["out.bias"] = given["out"].T[:, :, None], given["out_bias"]
    for index in range(layers):
        taps = given[f"along{index}"].unflatten(0, (TAPS, -1))
        state[f"along.{index}.weight"] = taps.permute(2, 1, 0)
        state[f"along.{index}.bias"] = given[f"along{index}_bias"]
    network.load_state_dict(state)
    return network


def _difference_of_sides() -> np.ndarray:
    half = len(PLACES) // 2
    sides = np.zeros((half * CHANNELS, FEATURES), np.float32)
    row = np.arange(half * CHANNELS)
    place, channel = np.divmod(row, CHANNELS)
    sides[row, row] = 1
    sides[row, (len(PLACES) - 1 - place) * CHANNELS + channel] = -1
    return sides
