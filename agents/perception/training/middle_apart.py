"""Learn by how much more the left middle of a thread errs than the right one, from the profiles of both eyes.

python -m agents.perception.training.middle_apart --scenes DIR [DIR ...] --held-out DIR [DIR ...] --output apart.npz

Learns from pairs of the first folders, and prints for each of the others what share of the variance is told, and the
errors' rms before and after. docs/model_card.md says what the project's own weights have learned from.
"""
# pyright: reportMissingImports=false, reportUntypedBaseClass=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import argparse
import itertools
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float16
from torch import nn

from agents.perception.both_eyes.apart import DILATIONS
from agents.perception.centrelines.learned import LOG_SCALE, STEPS
from agents.perception.training.middle_pairs import WINDOW, PairProfiles, explained, features, pair_profiles
from agents.perception.training.train import step_share

STATES, TAPS = 48, len(STEPS)
DROPPED, DROPPED_ALONG, BLURRED = 0.2, 0.1, 0.05
BATCH, LENGTH, SHORTEST, MOST_WEIGHT = 32, 40, 6, 100
"""Stretches of a batch, their places (every eighth pixel), the least that counts, and how often a long one is drawn."""
STEEPEST, WEIGHT_DECAY, MOST_NORM, SHARED_WEIGHT, SHARED_POINTS = 2e-3, 5e-2, 2.0, 5.0, 4
MIRRORS = tuple(itertools.product((False, True), repeat=3))
REPORTS = 5


class ApartNet(nn.Module):
    """Points (b, n, f) of stretches to what middles err apart, and the logarithm of its mean error, both (b, n)."""

    def __init__(self, shown: int) -> None:
        super().__init__()
        self.first, self.of_all = nn.Linear(shown, STATES), nn.Linear(STATES, STATES)
        self.along = nn.ModuleList(
            [
                nn.Conv1d(STATES, STATES, TAPS, dilation=d, padding=d * (TAPS - 1) // 2, padding_mode="replicate")
                for d in DILATIONS
            ]
        )
        self.out = nn.Linear(STATES, 2)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, shown: torch.Tensor, there: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        state = nn.functional.dropout(torch.relu(self.first(shown)), DROPPED, self.training)
        mean = (state * there[..., None]).sum(1, keepdim=True) / there.sum(1)[:, None, None].clamp(min=1)
        state = (state + torch.relu(self.of_all(mean))).transpose(1, 2)
        for layer in self.along:
            state = state + nn.functional.dropout(torch.relu(layer(state)), DROPPED_ALONG, self.training)
        offset, log_scale = self.out(state.transpose(1, 2)).unbind(-1)
        return offset, log_scale.clamp(*LOG_SCALE)


def batches(pairs: Sequence[PairProfiles], seed: int) -> Iterator[list[torch.Tensor]]:
    """What is shown, what is to be said, where there is a place, and where its truth is known.

    Without end, the same for the same seed.
    """
    rng = np.random.default_rng([seed, 23])
    shown = [[features(pair, *mirrors) for mirrors in MIRRORS] for pair in pairs]
    stretches = [
        (k, int(first), int(last - first + 1))
        for k, pair in enumerate(pairs)
        for first, last in zip(pair.pieces.first, pair.pieces.last, strict=True)
        if last - first + 1 >= SHORTEST
    ]
    weight = np.minimum([count for _, _, count in stretches], MOST_WEIGHT).astype(np.float64)
    while True:
        some = np.zeros((BATCH, LENGTH, shown[0][0][0].shape[1]), np.float32)
        apart, there, known = np.zeros((3, BATCH, LENGTH), np.float32)
        for row, index in enumerate(rng.choice(len(stretches), BATCH, p=weight / weight.sum())):
            k, first, count = stretches[index]
            seen, off = shown[k][rng.integers(len(MIRRORS))]
            start, n = first + rng.integers(max(1, count - LENGTH + 1)), min(count, LENGTH)
            way = slice(None, None, -1 if rng.uniform() < 0.5 else 1)
            here = slice(start, start + n)
            some[row, :n], apart[row, :n], there[row, :n] = seen[here][way], off[here][way], 1
            known[row, :n] = pairs[k].known[here][way]
        some += rng.normal(0, BLURRED, some.shape).astype(np.float32)
        yield [torch.from_numpy(part) for part in (some, apart, there, known)]


def train(pairs: Sequence[PairProfiles], held_out: dict[str, list[PairProfiles]], steps: int, seed: int) -> ApartNet:
    """The network after so many steps; what it tells is printed now and then."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    network = ApartNet(features(pairs[0])[0].shape[1])
    optimiser = torch.optim.AdamW(network.parameters(), STEEPEST, weight_decay=WEIGHT_DECAY)
    for step, (shown, apart, there, known) in zip(range(steps), batches(pairs, seed), strict=False):
        for group in optimiser.param_groups:
            group["lr"] = STEEPEST * step_share(step / steps)
        said, log_scale = network(shown, there)
        error = apart - said
        unlikely = ((error.abs() / log_scale.exp() + log_scale) * known).sum() / known.sum()
        shared = (error * known).unflatten(1, (-1, SHARED_POINTS)).mean(2)
        optimiser.zero_grad()
        (unlikely + SHARED_WEIGHT * torch.sqrt(shared**2 + 1e-4).mean()).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), MOST_NORM)
        optimiser.step()
        if (step + 1) % max(1, steps // REPORTS) == 0:
            for name, others in held_out.items():
                share, before, after = explained(others, [told(network, pair) for pair in others])
                sys.stdout.write(
                    f"{step + 1} steps, {name}, {len(others)} pairs: {share:.1%} of the variance; "
                    f"rms over {8 * WINDOW} px {before:.3f}, {after:.3f} px\n"
                )
            sys.stdout.flush()
    return network


def told(network: ApartNet, pair: PairProfiles) -> np.ndarray:
    """What the network says of each point, and of its image in a mirror."""
    network.eval()
    both = [np.zeros(len(pair.apart_px)) for _ in range(2)]
    with torch.no_grad():
        for mirrored, said in enumerate(both):
            shown = features(pair, mirrored=bool(mirrored))[0]
            for first, last in zip(pair.pieces.first, pair.pieces.last, strict=True):
                here = torch.from_numpy(shown[first : last + 1])[None]
                said[first : last + 1] = network(here, torch.ones(here.shape[:2]))[0][0].numpy()
    network.train()
    return (both[0] - both[1]) / 2


def weights_of(network: ApartNet) -> dict[str, Float16[np.ndarray, "..."]]:
    """The network's weights as they are kept, by the names that are used at run time."""
    layers = {"first": network.first, "of_all": network.of_all, "out": network.out}
    weights = {name: layer.weight.T for name, layer in layers.items()}
    weights |= {f"{name}_bias": layer.bias for name, layer in layers.items()}
    for number, layer in enumerate(network.along):
        # the states of five places, one after the other
        weights[f"along{number}"] = layer.weight.permute(2, 1, 0).flatten(0, 1)
        weights[f"along{number}_bias"] = layer.bias
    return {name: value.detach().numpy().astype(np.float16) for name, value in weights.items()}


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, train, print, write the weights; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m agents.perception.training.middle_apart", description=__doc__)
    parser.add_argument("--scenes", type=Path, nargs="+", required=True, help="folders of rendered pairs to learn from")
    parser.add_argument("--held-out", type=Path, nargs="+", required=True, help="folders that are only looked at")
    parser.add_argument("--output", type=Path, required=True, help="where the weights go, as NumPy keeps them")
    parser.add_argument("--steps", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pairs", type=int, default=None, help="learn from so many alone, drawn by the seed")
    chosen = parser.parse_args(arguments)
    pairs = pair_profiles(chosen.scenes)
    if chosen.pairs is not None:
        drawn = np.random.default_rng(chosen.seed).permutation(len(pairs))[: chosen.pairs]
        pairs = [pairs[index] for index in drawn]
    sys.stdout.write(f"{len(pairs)} pairs to learn from\n")
    held_out = {str(folder): pair_profiles([folder]) for folder in chosen.held_out}
    np.savez(chosen.output, allow_pickle=False, **weights_of(train(pairs, held_out, chosen.steps, chosen.seed)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
