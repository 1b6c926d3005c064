"""Train the network: python -m agents.perception.training.train --scenes DIR --held-out DIR --output network.pt."""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from agents.perception.training.architecture import ThreadNet
from agents.perception.training.crops import batches
from agents.perception.training.losses import LOSSES
from agents.perception.training.scenes import View, views_in
from shared.clock import monotonic_s

BATCH = 8
WARM_UP_SHARE = 0.05
"""Of the whole training, in which the steps grow to the steepest; then they shrink to nothing along a cosine."""
WEIGHT_DECAY = 1e-4
STEPS_BETWEEN_REPORTS = 100
MOVING_AVERAGE = 0.995
"""Of the weights of one step before, in the moving average that is kept: it is steadier than any of its steps."""


@dataclass(frozen=True)
class Chosen:
    """What the command line says.

    Fields:
        minutes: after which training ends, whatever steps are left; the step size follows whichever is further.
        steepest: the greatest step size.
        start: a checkpoint to go on from; new weights, if it is None.
    """

    scenes: list[Path]
    output: Path
    loss: str
    steps: int
    minutes: float
    seed: int
    steepest: float
    start: Path | None


def train(folders: list[list[View]], chosen: Chosen) -> ThreadNet:
    """The network after so many steps or minutes on varied crops of the views in folders; checkpoints on the way."""
    torch.manual_seed(chosen.seed)
    torch.set_num_threads(1)
    network = ThreadNet()
    if chosen.start is not None:
        network.load_state_dict(torch.load(chosen.start, weights_only=True))
    network = network.to(memory_format=torch.channels_last)
    kept = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(MOVING_AVERAGE), use_buffers=True
    )
    optimiser = torch.optim.AdamW(network.parameters(), lr=chosen.steepest, weight_decay=WEIGHT_DECAY)
    loss_of, losses = LOSSES[chosen.loss], []
    began = monotonic_s()
    for step, (pixels, coverage) in enumerate(batches(folders, BATCH, chosen.seed)):
        done = max(step / chosen.steps, (monotonic_s() - began) / 60 / chosen.minutes)
        if done >= 1:
            break
        for group in optimiser.param_groups:
            group["lr"] = chosen.steepest * step_share(done)
        seen = torch.from_numpy(pixels).to(memory_format=torch.channels_last)
        with torch.autocast("cpu", torch.bfloat16):
            logit = network(seen)
        loss = loss_of(logit.float(), torch.from_numpy(coverage))
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        kept.update_parameters(network)
        losses.append(float(loss.detach()))
        if (step + 1) % STEPS_BETWEEN_REPORTS == 0:
            sys.stdout.write(f"{step + 1} steps, {done:.0%}: loss {np.mean(losses[-STEPS_BETWEEN_REPORTS:]):.4f}\n")
            sys.stdout.flush()
            torch.save(kept.module.state_dict(), chosen.output)
    torch.save(kept.module.state_dict(), chosen.output)
    return kept.module


def step_share(done: float) -> float:
    """How steep the steps are after a share of the training, against the steepest."""
    if done < WARM_UP_SHARE:
        return done / WARM_UP_SHARE
    return 0.5 * (1 + float(np.cos(np.pi * (done - WARM_UP_SHARE) / (1 - WARM_UP_SHARE))))


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, train, keep the weights; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m agents.perception.training.train", description=__doc__)
    parser.add_argument(
        "--scenes", type=Path, nargs="+", required=True, help="folders of rendered scenes, each drawn from alike"
    )
    parser.add_argument("--output", type=Path, required=True, help="where the weights go, as PyTorch keeps them")
    parser.add_argument("--loss", choices=sorted(LOSSES), default="bce+dice")
    parser.add_argument("--steps", type=int, default=4000, help="of eight crops each")
    parser.add_argument("--minutes", type=float, default=1e9, help="after which training ends in any case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--steepest", type=float, default=3e-3, help="the greatest step size")
    parser.add_argument("--start", type=Path, default=None, help="weights to go on from")
    chosen = Chosen(**vars(parser.parse_args(arguments)))
    train([views_in([folder]) for folder in chosen.scenes], chosen)
    return 0


if __name__ == "__main__":
    sys.exit(main())
