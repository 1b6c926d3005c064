"""Learn where a thread's middle lies: python -m benchmarks.training.middle --scenes DIR --output learned.npz.

Prints, for views that are held out, how far the middle between the edges and the learned one lie from the true one.
"""
# pyright: reportMissingImports=false, reportUntypedBaseClass=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from jaxtyping import Float16

from agents.perception.centrelines.learned import LOG_SCALE, weights_in
from benchmarks.training.middle_crops import ALONE, batches
from benchmarks.training.middle_evaluate import line_of
from benchmarks.training.middle_network import STATES, MiddleNet, started_from, weights_of
from benchmarks.training.middle_views import MiddleView, middle_views
from benchmarks.training.train import step_share

STEPS_BETWEEN_REPORTS = 1000
WEIGHT_DECAY, MOVING_AVERAGE = 3e-2, 0.998
WINDOW = 48
"""Points, of every second pixel: errors that so many share bend the curve, while others average out: they count too."""
SHARED_WEIGHT, MOST_SHARED_PX, LEAST_SHARE = 5.0, 0.6, 0.75
APART_WEIGHT = 5.0
"""What the errors of both eyes differ by is depth; and what both see, shading and all, is nearly the same."""


@dataclass(frozen=True)
class Options:
    """From what is learned, and how."""

    scenes: tuple[Path, ...]
    """Folders of rendered scenes."""
    output: Path
    """Where the weights go, as NumPy keeps them."""
    steps: int = 24_000
    """Of 64 stretches each."""
    seed: int = 1
    steepest: float = 4e-3
    """The greatest step size."""
    states: int = STATES
    """Of each layer."""
    apart: float = APART_WEIGHT
    """How much differences between eyes count."""
    device: str = "cpu"
    """Of PyTorch's: cpu, cuda."""
    workers: int = 0
    """Processes that make batches, besides the one that trains."""
    start: Path | None = None
    """Weights to learn on from, whose states count then."""


def train(views: list[MiddleView], held_out: list[MiddleView], options: Options) -> MiddleNet:
    """The network after so many steps; weights are a moving average."""
    torch.manual_seed(options.seed)
    torch.set_num_threads(1)
    network = MiddleNet(options.states) if options.start is None else started_from(weights_in(options.start))
    network = network.to(options.device)
    kept = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(MOVING_AVERAGE)
    )
    optimiser = torch.optim.AdamW(network.parameters(), options.steepest, weight_decay=WEIGHT_DECAY)
    for step, batch in zip(range(options.steps), prepared(views, options.seed, options.workers), strict=False):
        for group in optimiser.param_groups:
            group["lr"] = options.steepest * step_share(step / options.steps)
        loss = _loss(network, *(part.to(options.device) for part in batch), apart_weight=options.apart)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimiser.step()
        kept.update_parameters(network)
        if (step + 1) % STEPS_BETWEEN_REPORTS == 0 or step + 1 == options.steps:
            np.savez(options.output, allow_pickle=False, **_short(kept.module))
            sys.stdout.write(line_of(f"{step + 1} steps", held_out, weights_of(kept.module)))
            sys.stdout.flush()
    return kept.module


class _Stream(torch.utils.data.IterableDataset):
    """Batches without end, other ones in each process."""

    def __init__(self, views: list[MiddleView], seed: int) -> None:
        super().__init__()
        self.views, self.seed = views, seed

    def __iter__(self) -> Iterator[list[torch.Tensor]]:
        worker = torch.utils.data.get_worker_info()
        for batch in batches(self.views, [self.seed, 0 if worker is None else worker.id]):
            yield [torch.from_numpy(np.ascontiguousarray(part)) for part in batch]


def prepared(views: list[MiddleView], seed: int, workers: int) -> Iterable[list[torch.Tensor]]:
    """Batches made in so many processes, in this one if it is 0."""
    return torch.utils.data.DataLoader(_Stream(views, seed), batch_size=None, num_workers=workers)


def _loss(
    network: MiddleNet,
    shown: torch.Tensor,
    offset: torch.Tensor,
    normal: torch.Tensor,
    known: torch.Tensor,
    same: torch.Tensor,
    apart_weight: float = APART_WEIGHT,
) -> torch.Tensor:
    """How unlikely the true offsets are, by a Laplace distribution; what neighbours err together; and eyes apart."""
    said, log_scale = network(shown, normal)
    log_scale = log_scale.clamp(*LOG_SCALE)
    error = offset - said
    unlikely = ((error.abs() / log_scale.exp() + log_scale) * known).sum() / known.sum()
    error = error.clamp(-MOST_SHARED_PX, MOST_SHARED_PX)
    return unlikely + SHARED_WEIGHT * shared(error, known) + apart_weight * shared(*apart(error, normal, same))


def shared(error: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """What the points of a window err together, where enough of them are known."""
    error, known = (part.unflatten(2, (-1, WINDOW)) for part in (error, known))
    count = known.sum(dim=3)
    common = (error * known).sum(dim=3) / count.clamp(min=1)
    whole = count > LEAST_SHARE * WINDOW
    return (torch.sqrt(common**2 + 1e-4) * whole).sum() / whole.sum().clamp(min=1)


def apart(error: torch.Tensor, normal: torch.Tensor, same: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """By how much more the left eye errs to the right than the right one, across the thread, where both see a point."""
    along_row = normal[..., 0]
    rightwards = error * along_row.sign()
    left, right, which = rightwards[ALONE::2], rightwards[ALONE + 1 :: 2], same[ALONE::2]
    difference = (left - right.gather(2, which.clamp(min=0))) * along_row[ALONE::2].abs()
    return difference, which >= 0


def _short(network: MiddleNet) -> dict[str, Float16[np.ndarray, "..."]]:
    return {name: value.astype(np.float16) for name, value in weights_of(network).items()}


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, train, write the weights; returns the exit status."""
    options = tyro.cli(Options, args=arguments, description=__doc__)
    views, held_out = (middle_views(options.scenes, held_out=held) for held in (False, True))
    train(views, held_out, options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
