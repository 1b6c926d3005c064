"""What training makes small: cross-entropy of all classes, and Dice of each but the ground."""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import torch
from torch.nn import functional

from benchmarks.training.architecture import CLASSES, PHASES

WEIGHTS = 1.0, 3.0, 1.5, 1.0
"""Of pixels with ground, thread, needle, instrument in the cross-entropy: the greatest that a pixel has."""
OVERLAP_WEIGHTS = 1.5, 0.5, 0.7
"""Of thread, needle, instrument: drawn scenes hold more needles than a field does."""
ENTROPY_WEIGHT = 10.0
"""Ground is so common that the mean of cross-entropy is small."""


def dice(given: torch.Tensor, coverage: torch.Tensor) -> torch.Tensor:
    """1 less the overlap of both, over the whole batch, so that crops without thread count too."""
    overlap = 2 * (given * coverage).sum() + 1
    return 1 - overlap / (given.square().sum() + coverage.square().sum() + 1)


def class_loss(logit: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Cross-entropy of all classes and Dice of each but the ground; both (n, 4 classes, r, c), class after class.

    Where a pixel shows several, its least lies where the network gives each its share.
    """
    given = functional.log_softmax(_by_class(logit), dim=2)
    true = _by_class(truth)
    weights = torch.tensor(WEIGHTS, device=true.device)
    shown = (true > 0) * weights[:, None, None]
    entropy = -(true * given).sum(dim=2) * shown.amax(dim=2)
    share = given.exp()
    overlaps = [dice(share[:, :, kind], true[:, :, kind]) for kind in range(1, CLASSES)]
    return ENTROPY_WEIGHT * entropy.mean() + sum(
        weight * overlap for weight, overlap in zip(OVERLAP_WEIGHTS, overlaps, strict=True)
    )


def _by_class(values: torch.Tensor) -> torch.Tensor:
    """(n, 4, classes, r, c)."""
    count, _, rows, columns = values.shape
    return values.reshape(count, PHASES, CLASSES, rows, columns)
