"""Learn where a thread's middle lies: python -m agents.perception.training.middle --scenes DIR --output learned.npz.

Prints, for views that are held out, how far the middle between the edges and the learned one lie from the true one.
"""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float16

from agents.perception.centrelines.learned import LOG_SCALE
from agents.perception.training.middle_crops import batches
from agents.perception.training.middle_evaluate import line_of
from agents.perception.training.middle_network import MiddleNet, weights_of
from agents.perception.training.middle_views import MiddleView, middle_views
from agents.perception.training.train import step_share

STEPS_BETWEEN_REPORTS = 500
WEIGHT_DECAY, MOVING_AVERAGE = 3e-2, 0.995
STRETCH_WEIGHT, STRETCH_MOST_PX, STRETCH_LEAST_SHARE = 5.0, 0.6, 0.75
"""Errors that a whole stretch shares bend the curve, while others average out: they count on their own."""


@dataclass(frozen=True)
class Chosen:
    """What the command line says; `steepest` is the greatest step size."""

    scenes: list[Path]
    output: Path
    steps: int
    seed: int
    steepest: float


def train(views: list[MiddleView], held_out: list[MiddleView], chosen: Chosen) -> MiddleNet:
    """The network after so many steps; weights are a moving average."""
    torch.manual_seed(chosen.seed)
    torch.set_num_threads(1)
    network = MiddleNet()
    kept = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(MOVING_AVERAGE)
    )
    optimiser = torch.optim.AdamW(network.parameters(), chosen.steepest, weight_decay=WEIGHT_DECAY)
    for step, batch in zip(range(chosen.steps), batches(views, chosen.seed), strict=False):
        for group in optimiser.param_groups:
            group["lr"] = chosen.steepest * step_share(step / chosen.steps)
        loss = _loss(network, *(torch.from_numpy(np.ascontiguousarray(part)) for part in batch))
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimiser.step()
        kept.update_parameters(network)
        if (step + 1) % STEPS_BETWEEN_REPORTS == 0 or step + 1 == chosen.steps:
            np.savez(chosen.output, allow_pickle=False, **_short(kept.module))
            sys.stdout.write(line_of(f"{step + 1} steps", held_out, weights_of(kept.module)))
            sys.stdout.flush()
    return kept.module


def _loss(
    network: MiddleNet, shown: torch.Tensor, offset: torch.Tensor, normal: torch.Tensor, known: torch.Tensor
) -> torch.Tensor:
    """How unlikely the true offsets are, by a Laplace distribution; and what stretches err as a whole."""
    said, log_scale = network(shown, normal)
    log_scale = log_scale.clamp(*LOG_SCALE)
    error = offset - said
    unlikely = ((error.abs() / log_scale.exp() + log_scale) * known).sum() / known.sum()
    count = known.sum(dim=2)
    common = (error.clamp(-STRETCH_MOST_PX, STRETCH_MOST_PX) * known).sum(dim=2) / count.clamp(min=1)
    whole = count > STRETCH_LEAST_SHARE * known.shape[2]
    shared = (torch.sqrt(common**2 + 1e-4) * whole).sum() / whole.sum().clamp(min=1)
    return unlikely + STRETCH_WEIGHT * shared


def _short(network: MiddleNet) -> dict[str, Float16[np.ndarray, "..."]]:
    return {name: value.astype(np.float16) for name, value in weights_of(network).items()}


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, train, write the weights; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m agents.perception.training.middle", description=__doc__)
    parser.add_argument("--scenes", type=Path, nargs="+", required=True, help="folders of rendered scenes")
    parser.add_argument("--output", type=Path, required=True, help="where the weights go, as NumPy keeps them")
    parser.add_argument("--steps", type=int, default=24_000, help="of 64 stretches each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--steepest", type=float, default=4e-3, help="the greatest step size")
    chosen = Chosen(**vars(parser.parse_args(arguments)))
    views, held_out = (middle_views(chosen.scenes, held_out=held) for held in (False, True))
    train(views, held_out, chosen)
    return 0


if __name__ == "__main__":
    sys.exit(main())
