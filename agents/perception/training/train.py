"""Train the network: python -m agents.perception.training.train --scenes DIR... --output network.pt [--device cuda]."""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from agents.perception.training.architecture import CHANNELS, ThreadNet, network_of
from agents.perception.training.crops import batches
from agents.perception.training.export import export
from agents.perception.training.losses import LOSSES
from agents.perception.training.scenes import View, views_in
from shared.clock import monotonic_s

WARM_UP_SHARE = 0.05
"""Of the whole training, in which the steps grow to the steepest; then they shrink to nothing along a cosine."""
WEIGHT_DECAY = 1e-4
STEPS_BETWEEN_REPORTS = 100
REPORTS_BETWEEN_CHECKPOINTS = 10
MOVING_AVERAGE = 0.995
"""Of the weights of one step before, in the moving average that is kept: it is steadier than any of its steps."""


@dataclass(frozen=True)
class Chosen:
    """What the command line says.

    Fields:
        minutes: after which training ends, whatever steps are left; the step size follows whichever is further.
        steepest: the greatest step size.
        start: a checkpoint to go on from, which then says how wide the network is; new weights, if it is None.
    """

    scenes: list[Path]
    output: Path
    loss: str = "bce+dice"
    steps: int = 4000
    minutes: float = 1e9
    seed: int = 1
    steepest: float = 3e-3
    start: Path | None = None
    batch: int = 8
    channels: tuple[int, ...] = CHANNELS
    red_share: float = 0.5
    device: str = "cpu"


def train(folders: list[list[View]], chosen: Chosen) -> ThreadNet:
    """The network after so many steps or minutes on varied crops of the views in folders; checkpoints on the way."""
    torch.manual_seed(chosen.seed)
    torch.set_num_threads(1)
    device = torch.device(chosen.device)
    network = _first_weights(chosen).to(device, memory_format=torch.channels_last)
    kept = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(MOVING_AVERAGE), use_buffers=True
    )
    optimiser = torch.optim.AdamW(network.parameters(), lr=chosen.steepest, weight_decay=WEIGHT_DECAY)
    loss_of, losses = LOSSES[chosen.loss], []
    began = monotonic_s()
    for step, (pixels, coverage) in enumerate(batches(folders, chosen.batch, chosen.seed, device, chosen.red_share)):
        done = max(step / chosen.steps, (monotonic_s() - began) / 60 / chosen.minutes)
        if done >= 1:
            break
        for group in optimiser.param_groups:
            group["lr"] = chosen.steepest * step_share(done)
        with torch.autocast(device.type, torch.bfloat16):
            logit = network(pixels.contiguous(memory_format=torch.channels_last))
        loss = loss_of(logit.float(), coverage)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        kept.update_parameters(network)
        losses.append(loss.detach())
        if (step + 1) % STEPS_BETWEEN_REPORTS == 0:
            # asking for one loss waits for the device
            sys.stdout.write(f"{step + 1} steps, {done:.0%}: loss {float(torch.stack(losses).mean()):.4f}\n")
            sys.stdout.flush()
            losses.clear()
        if (step + 1) % (STEPS_BETWEEN_REPORTS * REPORTS_BETWEEN_CHECKPOINTS) == 0:
            torch.save(kept.module.state_dict(), chosen.output)
    trained = kept.module.to("cpu")
    torch.save(trained.state_dict(), chosen.output)
    return trained


def _first_weights(chosen: Chosen) -> ThreadNet:
    if chosen.start is None:
        return ThreadNet(chosen.channels)
    return network_of(torch.load(chosen.start, weights_only=True, map_location="cpu"))


def step_share(done: float) -> float:
    """How steep the steps are after a share of the training, against the steepest."""
    if done < WARM_UP_SHARE:
        return done / WARM_UP_SHARE
    return 0.5 * (1 + float(np.cos(np.pi * (done - WARM_UP_SHARE) / (1 - WARM_UP_SHARE))))


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, train, keep the weights, also as ONNX; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m agents.perception.training.train", description=__doc__)
    parser.add_argument(
        "--scenes",
        type=Path,
        nargs="+",
        required=True,
        help="folders of rendered scenes, each drawn from alike, and twice where named twice",
    )
    parser.add_argument("--output", type=Path, required=True, help="where the weights go, as PyTorch keeps them")
    parser.add_argument("--loss", choices=sorted(LOSSES), default="bce+dice")
    parser.add_argument("--steps", type=int, default=4000, help="of one batch each")
    parser.add_argument("--minutes", type=float, default=1e9, help="after which training ends in any case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--steepest", type=float, default=3e-3, help="the greatest step size")
    parser.add_argument("--start", type=Path, default=None, help="weights to go on from")
    parser.add_argument("--batch", type=int, default=8, help="crops of one step")
    parser.add_argument("--channels", type=int, nargs=4, default=CHANNELS, help="of new weights, at each resolution")
    parser.add_argument("--red-share", type=float, default=0.5, help="of the colours in which thread is dyed anew")
    parser.add_argument("--device", default="cpu", help="as PyTorch names it, such as cuda; none is needed")
    chosen = Chosen(**vars(parser.parse_args(arguments)))
    views = {folder: views_in([folder]) for folder in chosen.scenes}
    train([views[folder] for folder in chosen.scenes], chosen)
    export(chosen.output, chosen.output.with_suffix(".onnx"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
