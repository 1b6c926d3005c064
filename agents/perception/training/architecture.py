"""A small U-Net at half resolution: four pixels go in at each of its own, and their coverages or classes come out."""
# pyright: reportMissingImports=false, reportUntypedBaseClass=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

from collections.abc import Mapping, Sequence

import torch
from torch import nn

PHASES, COLOURS = 4, 3
CHANNELS = 12, 24, 48, 64
"""At a half, a quarter, an eighth and a sixteenth of the image's resolution."""
DEEPEST_LAYERS = 3
CLASSES = 4
"""Ground, thread, needle, instrument."""
FIRST_LOGITS = {1: (-4.0,), CLASSES: (0.0, -4.0, -5.0, -2.0)}
"""Of new weights, for each count of classes: thread is rare, and without this training first learns that nothing is."""


class ThreadNet(nn.Module):
    """Pixels (n, 12, h/2, w/2), 0 to 1, to the logit of coverage (n, 4, h/2, w/2); sides are multiples of 8.

    With classes it gives (n, 4 classes, h/2, w/2): the logits of all classes of the first pixel, then of the next.
    """

    def __init__(self, channels: Sequence[int] = CHANNELS, classes: int = 1) -> None:
        super().__init__()
        self.channels, self.classes = list(channels), classes
        first, second, third, fourth = channels
        self.at_half = _layer(PHASES * COLOURS, first)
        self.at_quarter = nn.Sequential(_layer(first, second, stride=2), _layer(second, second))
        self.at_eighth = nn.Sequential(_layer(second, third, stride=2), _layer(third, third))
        deepest = [_layer(fourth, fourth) for _ in range(DEEPEST_LAYERS - 1)]
        self.at_sixteenth = nn.Sequential(_layer(third, fourth, stride=2), *deepest)
        self.to_eighth, self.again_at_eighth = _enlarging(fourth, third), _layer(third, third)
        self.to_quarter, self.again_at_quarter = _enlarging(third, second), _layer(second, second)
        self.to_half, self.again_at_half = _enlarging(second, first), _layer(first, first)
        self.coverage = nn.Conv2d(first, PHASES * classes, 1)
        with torch.no_grad():
            self.coverage.bias.copy_(torch.tensor(FIRST_LOGITS[classes] * PHASES))

    def forward(self, pixels: torch.Tensor) -> torch.Tensor:
        """The logit of coverage."""
        half = self.at_half(pixels)
        quarter = self.at_quarter(half)
        eighth = self.at_eighth(quarter)
        deepest = self.at_sixteenth(eighth)
        eighth = self.again_at_eighth(self.to_eighth(deepest) + eighth)
        quarter = self.again_at_quarter(self.to_quarter(eighth) + quarter)
        half = self.again_at_half(self.to_half(quarter) + half)
        return self.coverage(half)


def network_of(state: Mapping[str, torch.Tensor]) -> ThreadNet:
    """The network whose weights these are, as wide as they say, and with as many classes."""
    convolutions = "at_half.0", "at_quarter.0.0", "at_eighth.0.0", "at_sixteenth.0.0"
    channels = [len(state[f"{name}.weight"]) for name in convolutions]
    network = ThreadNet(channels, len(state["coverage.bias"]) // PHASES)
    network.load_state_dict(state)
    return network


def _layer(inputs: int, outputs: int, stride: int = 1) -> nn.Module:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU()
    )


def _enlarging(inputs: int, outputs: int) -> nn.Module:
    # fewer channels first: enlarging copies pixels, so it comes to the same and costs a quarter
    return nn.Sequential(nn.Conv2d(inputs, outputs, 1), nn.Upsample(scale_factor=2, mode="nearest"))
