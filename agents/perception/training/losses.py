"""What training makes small: cross-entropy alone, with Dice, or with Dice and soft-clDice for thin structures.

soft-clDice: Shit et al., clDice, a novel topology-preserving loss function for tubular structure segmentation, 2021.
"""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

from collections.abc import Callable

import torch
from torch.nn import functional

from agents.perception.training.architecture import CLASSES, PHASES

SKELETON_ROUNDS = 2
"""Half the width of what still shrinks to a line, in pixels at half resolution: there it costs an eighth."""
CLDICE_WEIGHT = 0.4
THREAD_WEIGHT = 3.0
"""Of pixels with thread in cross-entropy, at full coverage, against one without."""
RARE_WEIGHT = 3.0
"""Of pixels with thread or needle in the cross-entropy of classes."""
Loss = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]


def cross_entropy(logit: torch.Tensor, coverage: torch.Tensor) -> torch.Tensor:
    """The mean over pixels; with coverage between 0 and 1 its least lies where the network says that coverage."""
    weight = 1 + (THREAD_WEIGHT - 1) * (coverage > 0)
    return functional.binary_cross_entropy_with_logits(logit, coverage, weight)


def dice(given: torch.Tensor, coverage: torch.Tensor) -> torch.Tensor:
    """1 less the overlap of both, over the whole batch, so that crops without thread count too."""
    overlap = 2 * (given * coverage).sum() + 1
    return 1 - overlap / (given.square().sum() + coverage.square().sum() + 1)


def soft_cldice(given: torch.Tensor, coverage: torch.Tensor) -> torch.Tensor:
    """1 less the harmonic mean of how much of each one's skeleton lies in the other; images of one channel."""
    given_line, true_line = soft_skeleton(given), soft_skeleton(coverage)
    precision = ((given_line * coverage).sum() + 1) / (given_line.sum() + 1)
    recall = ((true_line * given).sum() + 1) / (true_line.sum() + 1)
    return 1 - 2 * precision * recall / (precision + recall)


def soft_skeleton(image: torch.Tensor) -> torch.Tensor:
    """What opening takes away, at every depth of erosion: lines stay lines, and gradients pass."""
    skeleton = functional.relu(image - _opened(image))
    for _ in range(SKELETON_ROUNDS):
        image = _eroded(image)
        here = functional.relu(image - _opened(image))
        skeleton = skeleton + functional.relu(here - skeleton * here)
    return skeleton


def _eroded(image: torch.Tensor) -> torch.Tensor:
    across = -functional.max_pool2d(-image, (3, 1), (1, 1), (1, 0))
    along = -functional.max_pool2d(-image, (1, 3), (1, 1), (0, 1))
    return torch.minimum(across, along)


def _opened(image: torch.Tensor) -> torch.Tensor:
    return functional.max_pool2d(_eroded(image), 3, 1, 1)


def bce(logit: torch.Tensor, coverage: torch.Tensor) -> torch.Tensor:
    """Cross-entropy alone."""
    return cross_entropy(logit, coverage)


def bce_dice(logit: torch.Tensor, coverage: torch.Tensor) -> torch.Tensor:
    """Cross-entropy, scaled to the size of Dice, and Dice."""
    return BCE_WEIGHT * cross_entropy(logit, coverage) + dice(torch.sigmoid(logit), coverage)


def bce_dice_cldice(logit: torch.Tensor, coverage: torch.Tensor) -> torch.Tensor:
    """Both, and soft-clDice at half resolution."""
    given, true = (part.mean(dim=1, keepdim=True) for part in (torch.sigmoid(logit), coverage))
    return bce_dice(logit, coverage) + CLDICE_WEIGHT * soft_cldice(given, true)


BCE_WEIGHT = 10.0
"""Thread is so rare that the mean of cross-entropy is small."""
LOSSES: dict[str, Loss] = {"bce": bce, "bce+dice": bce_dice, "bce+dice+cldice": bce_dice_cldice}


def class_loss(logit: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Cross-entropy of all classes and Dice of each but the ground; both (n, 4 classes, r, c), class after class.

    Where a pixel shows several, its least lies where the network gives each its share.
    """
    given = functional.log_softmax(_by_class(logit), dim=2)
    true = _by_class(truth)
    rare = (true[:, :, 1:3] > 0).any(dim=2)
    entropy = -(true * given).sum(dim=2) * (1 + (RARE_WEIGHT - 1) * rare)
    share = given.exp()
    overlaps = sum(dice(share[:, :, kind], true[:, :, kind]) for kind in range(1, CLASSES))
    return BCE_WEIGHT * entropy.mean() + overlaps


def _by_class(values: torch.Tensor) -> torch.Tensor:
    """(n, 4, classes, r, c)."""
    count, _, rows, columns = values.shape
    return values.reshape(count, PHASES, CLASSES, rows, columns)
