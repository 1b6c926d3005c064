"""Train the network: python -m benchmarks.training.train --scenes DIR... --output classes.pt [--device cuda].

It begins with the encoder's weights (--encoder) or goes on from those of an earlier training (--start).
"""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from benchmarks.training.architecture import ClassNet, WeightsError, network_of, unfolded
from benchmarks.training.crops import Pixels, batches_of, pixels_of
from benchmarks.training.export import convolutions, export
from benchmarks.training.losses import class_loss
from benchmarks.training.prefetch import made_ahead
from benchmarks.training.scenes import SceneFolderError, View, views_in
from shared.clock import monotonic_s

WARM_UP_SHARE = 0.05
"""Of the whole training, in which the steps grow to the steepest; then they shrink to nothing along a cosine."""
WEIGHT_DECAY = 1e-4
ENCODER_SHARE = 0.25
"""Of the step size, for the encoder, which knows most of what it needs."""
STEPS_BETWEEN_REPORTS = 100
REPORTS_BETWEEN_CHECKPOINTS = 10
MOVING_AVERAGE = 0.997
"""Of the weights of one step before, in the moving average that is kept: it is steadier than any of its steps."""


@dataclass(frozen=True)
class Options:
    """From what is learned, and how."""

    scenes: tuple[Path, ...]
    """Folders of rendered scenes, each drawn from alike, and twice where named twice."""
    output: Path
    """Where the weights go, as PyTorch keeps them."""
    steps: int = 4000
    """Of one batch each."""
    minutes: float = 1e9
    """After which training ends in any case; the step size follows whichever is further."""
    seed: int = 1
    steepest: float = 3e-3
    """The greatest step size."""
    start: Path | None = None
    """Weights to go on from, .pt or .onnx."""
    encoder: Path | None = None
    """Weights of EfficientNet-Lite0, .pth, to begin with."""
    batch: int = 8
    """Crops of one step."""
    red_share: float = 0.5
    """Of the colours in which thread is dyed anew."""
    mistaken_by: Path | None = None
    """ONNX of a network whose mistakes are learned from more often."""
    device: str = "cpu"
    """As PyTorch names it, such as cuda; none is needed."""
    threads: int = 1
    """Of the processor; one of several makes crops ahead."""
    float32: bool = False
    """Convolutions take 32-bit floats, not 16-bit ones."""


def train(folders: list[list[View]], options: Options) -> ClassNet:
    """The network after so many steps or minutes on varied crops of the views in folders; checkpoints on the way."""
    return train_on(pixels_of(folders, torch.device(options.device), options.seed), options)


def train_on(views: Pixels, options: Options) -> ClassNet:
    """As `train`, on views whose pixels lie on the device already."""
    torch.manual_seed(options.seed)
    torch.set_num_threads(max(1, options.threads - 1))
    device = torch.device(options.device)
    losses = list[torch.Tensor]()
    drawn = batches_of(views, options.batch, options.seed, options.red_share)
    network = _first_weights(options, drawn).to(device, memory_format=torch.channels_last).train()
    if options.threads > 1:
        drawn = made_ahead(drawn)
    kept = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(MOVING_AVERAGE), use_buffers=True
    )
    optimiser = torch.optim.AdamW(_groups(network), lr=options.steepest, weight_decay=WEIGHT_DECAY)
    began, step = monotonic_s(), 0
    for step, (pixels, truth) in enumerate(drawn):
        done = max(step / options.steps, (monotonic_s() - began) / 60 / options.minutes)
        if done >= 1:
            break
        for group in optimiser.param_groups:
            group["lr"] = options.steepest * group["share"] * step_share(done)
        with torch.autocast(device.type, torch.bfloat16, enabled=not options.float32):
            logit = network(pixels.contiguous(memory_format=torch.channels_last))
        loss = class_loss(logit.float(), truth)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        kept.update_parameters(network)
        losses.append(loss.detach())
        if (step + 1) % STEPS_BETWEEN_REPORTS == 0:
            _report(step + 1, done, losses, began)
            losses.clear()
        if (step + 1) % (STEPS_BETWEEN_REPORTS * REPORTS_BETWEEN_CHECKPOINTS) == 0:
            torch.save(kept.module.state_dict(), options.output)
    if losses:
        _report(step, 1.0, losses, began)
    trained = kept.module.to("cpu")
    torch.save(trained.state_dict(), options.output)
    return trained


def _first_weights(options: Options, drawn: Iterator[tuple[torch.Tensor, torch.Tensor]]) -> ClassNet:
    """Those to go on from, or new ones about an encoder's.

    Raises:
        WeightsError: where a file holds others, or none is given.
    """
    if options.start is not None and options.start.suffix == ".onnx":
        network, (pixels, _) = ClassNet(), next(drawn)
        unfolded(network, convolutions(options.start), pixels.to("cpu"))
        return network
    if options.start is not None:
        return network_of(torch.load(options.start, weights_only=True, map_location="cpu"))
    if options.encoder is None:
        raise WeightsError("name the weights of EfficientNet-Lite0 by --encoder, or those to go on from by --start")
    network = ClassNet()
    network.encoder.load(options.encoder)
    return network


def _groups(network: ClassNet) -> list[dict[str, Any]]:
    """The weights that are trained, of the encoder and of the rest, with how steep their steps are."""
    of_encoder = [weights for weights in network.encoder.parameters() if weights.requires_grad]
    known = {id(weights) for weights in network.encoder.parameters()}
    rest = [weights for weights in network.parameters() if weights.requires_grad and id(weights) not in known]
    return [{"params": rest, "share": 1.0}, {"params": of_encoder, "share": ENCODER_SHARE}]


def _report(steps: int, done: float, losses: list[torch.Tensor], began: float) -> None:
    """A line of what was learned lately; asking for a loss waits for the device."""
    mean, rate = float(torch.stack(losses).mean()), steps / (monotonic_s() - began)
    sys.stdout.write(f"{steps} steps, {done:.0%}: loss {mean:.4f}, {rate:.2f} steps a second\n")
    sys.stdout.flush()


def _pixels_in(options: Options) -> Pixels:
    """The views of all folders, which nothing else holds once they lie on the device."""
    views = {folder: views_in([folder], classes=True) for folder in options.scenes}
    every = [views[folder] for folder in options.scenes]
    return pixels_of(every, torch.device(options.device), options.seed, options.mistaken_by)


def step_share(done: float) -> float:
    """How steep the steps are after a share of the training, against the steepest."""
    if done < WARM_UP_SHARE:
        return done / WARM_UP_SHARE
    return 0.5 * (1 + float(np.cos(np.pi * (done - WARM_UP_SHARE) / (1 - WARM_UP_SHARE))))


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, train, keep the weights, also as ONNX; returns the exit status."""
    options = tyro.cli(Options, args=arguments, description=__doc__)
    try:
        train_on(_pixels_in(options), options)
    except (SceneFolderError, WeightsError) as error:
        print(error, file=sys.stderr)
        raise SystemExit(2) from None
    export(options.output, options.output.with_suffix(".onnx"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
