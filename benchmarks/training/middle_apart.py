"""Learn by how much more the left middle of a thread errs than the right one, from the profiles of both eyes.

python -m benchmarks.training.middle_apart --scenes DIR [DIR ...] --held-out DIR [DIR ...] --output apart.npz

Learns from pairs of the first folders, and prints for each of the others what share of the variance is told, and the
errors' rms before and after. docs/model_card.md says what the project's own weights have learned from.
"""
# pyright: reportMissingImports=false, reportUntypedBaseClass=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from jaxtyping import Float16, Float64
from torch import nn

from agents.perception.both_eyes.apart import DILATIONS
from agents.perception.centrelines.along import Pieces
from agents.perception.centrelines.learned import LOG_SCALE, STEPS
from benchmarks.training.middle_pairs import WINDOW, PairProfiles, explained, features, pair_profiles
from benchmarks.training.train import step_share

STATES = 48
DROPPED, DROPPED_ALONG, BLURRED = 0.2, 0.1, 0.05
BATCH, MOST_WEIGHT = 12, 150
"""Pairs of a batch, and how often, by its places, a long one is drawn."""
ASIDE_PX, ASIDE_EVERY, ASIDE_ALIKE, ASIDE_OTHERWISE = 0.12, (4, 12, 40), 0.6, 0.8
"""Standard deviation by which lines are drawn aside, at places so far apart; shares of both eyes alike, and of each."""
STEEPEST, WEIGHT_DECAY, MOST_NORM, SHARED_WEIGHT, SHARED_PLACES = 2e-3, 5e-2, 2.0, 5.0, (4, 16)
REPORTS = 5


@dataclass(frozen=True)
class Batch:
    """Pairs one after the other: what is shown, what is to be said and whether that is known, and their stretches."""

    shown: torch.Tensor
    apart: torch.Tensor
    known: torch.Tensor
    stretches: Pieces


class ApartNet(nn.Module):
    """Places (n, f) of stretches to what middles err apart there, and the logarithm of its mean error, both (n)."""

    def __init__(self, shown: int) -> None:
        super().__init__()
        self.first, self.of_all = nn.Linear(shown, STATES), nn.Linear(STATES, STATES)
        self.along = nn.ModuleList([nn.Linear(len(STEPS) * STATES, STATES) for _ in DILATIONS])
        self.out = nn.Linear(STATES, 2)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, shown: torch.Tensor, stretches: Pieces) -> tuple[torch.Tensor, torch.Tensor]:
        number = torch.from_numpy(stretches.number)
        state = nn.functional.dropout(torch.relu(self.first(shown)), DROPPED, self.training)
        total = torch.zeros(len(stretches.first), STATES).index_add(0, number, state)
        mean = total / torch.bincount(number)[:, None]
        state = state + torch.relu(self.of_all(mean))[number]
        first, last = (some[stretches.number, None] for some in (stretches.first, stretches.last))
        for layer, dilation in zip(self.along, DILATIONS, strict=True):
            # the last place of a stretch goes on for ever
            beside = torch.from_numpy(np.clip(np.arange(len(shown))[:, None] + dilation * STEPS, first, last))
            along = torch.relu(layer(state[beside].flatten(1)))
            state = state + nn.functional.dropout(along, DROPPED_ALONG, self.training)
        offset, log_scale = self.out(state).unbind(-1)
        return offset, log_scale.clamp(*LOG_SCALE)


def batches(pairs: Sequence[PairProfiles], seed: int) -> Iterator[Batch]:
    """Pairs drawn by their length, each in mirrors and with its lines drawn aside; without end, the same for a seed."""
    rng = np.random.default_rng([seed, 23])
    weight = np.minimum([len(pair.known) for pair in pairs], MOST_WEIGHT).astype(np.float64)
    while True:
        some = [pairs[k] for k in rng.choice(len(pairs), BATCH, p=weight / weight.sum())]
        mirrors = rng.integers(0, 2, (BATCH, 3)).astype(bool)
        seen = [
            features(pair, *way, aside_px=aside_px(len(pair.known), rng))
            for pair, way in zip(some, mirrors, strict=True)
        ]
        shown = np.concatenate([part for part, _ in seen])
        yield Batch(
            torch.from_numpy(shown + rng.normal(0, BLURRED, shown.shape).astype(np.float32)),
            torch.from_numpy(np.concatenate([part for _, part in seen])),
            torch.from_numpy(np.concatenate([pair.known for pair in some]).astype(np.float32)),
            one_after_the_other([pair.pieces for pair in some]),
        )


def aside_px(count: int, rng: np.random.Generator) -> Float64[np.ndarray, "2 n"]:
    """By how much the lines of both eyes are drawn aside, as a drift along them that is partly the same in both."""
    every = int(rng.choice(ASIDE_EVERY))
    at = np.arange(count) / every + rng.uniform()
    knots = count // every + 3
    drift = ASIDE_OTHERWISE * rng.normal(0, 1, (2, knots)) + ASIDE_ALIKE * rng.normal(0, 1, (1, knots))
    return ASIDE_PX * np.stack([np.interp(at, np.arange(knots), some) for some in drift])


def one_after_the_other(pieces: Sequence[Pieces]) -> Pieces:
    """The pieces of several pairs, numbered on."""
    before = np.cumsum([0, *(len(some.first) for some in pieces)])
    return Pieces(np.concatenate([some.number + count for some, count in zip(pieces, before, strict=False)]))


def train(pairs: Sequence[PairProfiles], held_out: dict[str, list[PairProfiles]], steps: int, seed: int) -> ApartNet:
    """The network after so many steps; what it tells is printed now and then."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    network = ApartNet(features(pairs[0])[0].shape[1])
    optimiser = torch.optim.AdamW(network.parameters(), STEEPEST, weight_decay=WEIGHT_DECAY)
    for step, batch in zip(range(steps), batches(pairs, seed), strict=False):
        for group in optimiser.param_groups:
            group["lr"] = STEEPEST * step_share(step / steps)
        said, log_scale = network(batch.shown, batch.stretches)
        error = batch.apart - said
        loss = ((error.abs() / log_scale.exp() + log_scale) * batch.known).sum() / batch.known.sum()
        for places in SHARED_PLACES:
            alike = shared(error * batch.known, batch.stretches, places)
            loss = loss + SHARED_WEIGHT * torch.sqrt(alike**2 + 1e-4).mean()
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), MOST_NORM)
        optimiser.step()
        if (step + 1) % max(1, steps // REPORTS) == 0:
            for name, others in held_out.items():
                sys.stdout.write(f"{step + 1} steps, {_said_of(name, others, [network])}\n")
            sys.stdout.flush()
    return network


def _said_of(name: str, pairs: list[PairProfiles], networks: Sequence[ApartNet]) -> str:
    share, before, after = explained(pairs, [told(networks, pair) for pair in pairs])
    return (
        f"{name}, {len(pairs)} pairs: {share:.1%} of the variance; "
        f"rms over {8 * WINDOW} px {before:.3f}, {after:.3f} px"
    )


def shared(error: torch.Tensor, stretches: Pieces, places: int) -> torch.Tensor:
    """What neighbours err by together: sums over so many places of a stretch, over that number."""
    block = stretches.before // places + len(error) * stretches.number
    number = torch.from_numpy(np.unique(block, return_inverse=True)[1])
    return torch.zeros(int(number[-1]) + 1).index_add(0, number, error) / places


def told(networks: Sequence[ApartNet], pair: PairProfiles) -> np.ndarray:
    """What networks say of each place, and of its image in a mirror: the mean."""
    said: list[np.ndarray] = []
    for mirrored, sign in ((False, 1), (True, -1)):
        shown = torch.from_numpy(features(pair, mirrored=mirrored)[0])
        for network in networks:
            network.eval()
            with torch.no_grad():
                said.append(sign * network(shown, pair.pieces)[0].numpy())
            network.train()
    return np.mean(said, axis=0)


def weights_of(network: ApartNet) -> dict[str, Float16[np.ndarray, "..."]]:
    """The network's weights as they are kept, by the names that are used at run time."""
    layers = {"first": network.first, "of_all": network.of_all, "out": network.out}
    layers |= {f"along{number}": layer for number, layer in enumerate(network.along)}
    weights = {name: layer.weight.T for name, layer in layers.items()}
    weights |= {f"{name}_bias": layer.bias for name, layer in layers.items()}
    return {name: value.detach().numpy().astype(np.float16) for name, value in weights.items()}


@dataclass(frozen=True)
class Options:
    """From what is learned, and for how long."""

    scenes: tuple[Path, ...]
    """Folders of rendered pairs to learn from."""
    held_out: tuple[Path, ...]
    """Folders that are only looked at."""
    output: Path
    """Where the weights go, as NumPy keeps them."""
    steps: int = 8000
    seed: int = 1
    networks: int = 2
    """Whose mean is used at run time; seeds follow each other."""
    pairs: int | None = None
    """Learn from so many alone, drawn by the seed."""


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, train, print, write the weights; returns the exit status."""
    options = tyro.cli(Options, args=arguments, description=__doc__)
    pairs = pair_profiles(options.scenes)
    if options.pairs is not None:
        drawn = np.random.default_rng(options.seed).permutation(len(pairs))[: options.pairs]
        pairs = [pairs[index] for index in drawn]
    sys.stdout.write(f"{len(pairs)} pairs to learn from\n")
    held_out = {str(folder): pair_profiles([folder]) for folder in options.held_out}
    networks = [train(pairs, held_out, options.steps, options.seed + k) for k in range(options.networks)]
    for name, others in held_out.items():
        sys.stdout.write(f"all together, {_said_of(name, others, networks)}\n")
    weights = [weights_of(network) for network in networks]
    stacked = {name: np.stack([some[name] for some in weights]) for name in weights[0]}
    np.savez(options.output, allow_pickle=False, **stacked)
    return 0


if __name__ == "__main__":
    sys.exit(main())
