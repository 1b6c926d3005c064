"""Weights to begin with: of an exported network, for classes where it has none, and for a wider network."""
# pyright: reportMissingImports=false, reportUntypedBaseClass=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import copy
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import torch
from torch import nn

from agents.perception.training.architecture import CHANNELS, CLASSES, PHASES, ThreadNet, network_of

RARE_LOGIT = -5.0
"""Of needle and instrument against ground, before anything is known of them."""
FIRST_AT = 0, 1, 3, 5
"""Which convolution is the first at a half, a quarter, an eighth and a sixteenth."""


class WeightsError(ValueError):
    """A file that holds no weights of this form; the text names it."""


def first_weights(start: Path | None, channels: Sequence[int] | None, classes: bool) -> ThreadNet:
    """New weights, or those of a `.pt` or `.onnx` file, with classes where they are wanted, and as wide as asked.

    Raises:
        WeightsError: where the file holds a network of another form, or a wider one.
    """
    if start is None:
        return ThreadNet(channels or CHANNELS, CLASSES if classes else 1)
    if start.suffix == ".onnx":
        network = of_onnx(start)
    else:
        network = network_of(torch.load(start, weights_only=True, map_location="cpu"))
    if classes and network.classes == 1:
        network = with_classes(network)
    if not classes and network.classes != 1:
        raise WeightsError(f"{start} holds a network with classes; train it on with --classes")
    return network if channels is None or list(channels) == network.channels else widened(network, channels)


def of_onnx(path: Path) -> ThreadNet:
    """The network of an exported file, whose convolutions hold what batch normalisation does.

    Raises:
        WeightsError: where it is no network of this form.
    """
    try:
        read = cv2.dnn.readNetFromONNX(str(path), cv2.dnn.ENGINE_CLASSIC)
    except cv2.error as error:
        raise WeightsError(f"{path} is no ONNX file that OpenCV reads") from error
    layers = [read.getLayer(read.getLayerId(name)) for name in read.getLayerNames()]
    blobs = [[torch.from_numpy(blob.copy()) for blob in layer.blobs] for layer in layers if layer.type == "Convolution"]
    of_another_form = WeightsError(f"{path} holds a network of another form")
    if len(blobs) <= max(FIRST_AT):
        raise of_another_form
    network = ThreadNet([len(blobs[place][0]) for place in FIRST_AT], len(blobs[-1][0]) // PHASES)
    convolutions = [module for module in network.modules() if isinstance(module, nn.Conv2d)]
    if [blob[0].shape for blob in blobs] != [convolution.weight.shape for convolution in convolutions]:
        raise of_another_form
    normalisations = iter([module for module in network.modules() if isinstance(module, nn.BatchNorm2d)])
    with torch.no_grad():
        for convolution, found in zip(convolutions, blobs, strict=True):
            convolution.weight.copy_(found[0])
            holder = next(normalisations) if convolution.bias is None else convolution
            holder.bias.copy_(found[1].reshape(-1))
            if isinstance(holder, nn.BatchNorm2d):
                # so that it divides by exactly 1
                holder.running_var.fill_(1 - holder.eps)
    return network


def with_classes(network: ThreadNet) -> ThreadNet:
    """The same network with the logit of thread as it is, of ground 0, and of needle and instrument low."""
    several = ThreadNet(network.channels, CLASSES)
    state = network.state_dict()
    weight, bias = several.coverage.weight.detach().clone(), several.coverage.bias.detach().clone()
    weight.zero_()
    for phase in range(PHASES):
        weight[phase * CLASSES + 1] = state["coverage.weight"][phase]
        bias[phase * CLASSES : (phase + 1) * CLASSES] = torch.tensor((0.0, 0.0, RARE_LOGIT, RARE_LOGIT))
        bias[phase * CLASSES + 1] = state["coverage.bias"][phase]
    several.load_state_dict({**state, "coverage.weight": weight, "coverage.bias": bias})
    return several


def widened(network: ThreadNet, channels: Sequence[int]) -> ThreadNet:
    """A network with more channels that gives what this one does: nothing listens to the new ones yet.

    Raises:
        WeightsError: where it would have fewer.
    """
    if any(new < old for new, old in zip(channels, network.channels, strict=True)):
        raise WeightsError(f"the network to start from has {network.channels} channels, which {channels} cannot hold")
    wide = ThreadNet(channels, network.classes)
    state = wide.state_dict()
    for name, old in network.state_dict().items():
        new = state[name]
        if old.ndim == 0:
            continue
        new[tuple(slice(length) for length in old.shape)] = old
        if old.ndim == 4:
            new[: old.shape[0], old.shape[1] :] = 0
    wide.load_state_dict(state)
    return wide


def settle(network: ThreadNet, batches: Iterable[torch.Tensor]) -> None:
    """Make batch normalisation hold the means and variances that these pixels have, without another answer.

    What `of_onnx` reads has none of them left, and normalising by those of a batch would undo what was learned.
    """
    normalisations = [module for module in network.modules() if isinstance(module, nn.BatchNorm2d)]
    sums = {module: torch.zeros(3, module.num_features, dtype=torch.float64) for module in normalisations}

    def seen(module: nn.Module, values: tuple[torch.Tensor, ...]) -> None:
        given = values[0].detach().double()
        count = torch.full((given.shape[1],), given.numel() / given.shape[1], dtype=torch.float64)
        sums[module] += torch.stack((count, given.sum(dim=(0, 2, 3)).cpu(), given.square().sum(dim=(0, 2, 3)).cpu()))

    hooks = [module.register_forward_pre_hook(seen) for module in normalisations]
    was_training = network.training
    network.eval()
    with torch.no_grad():
        for pixels in batches:
            network(pixels)
        for module in normalisations:
            count, total, squares = sums[module]
            mean = total / count
            variance = torch.clamp(squares / count - mean**2, min=1e-6)
            _normalise_by(module, mean.float(), variance.float())
    for hook in hooks:
        hook.remove()
    network.train(was_training)


def _normalise_by(module: nn.BatchNorm2d, mean: torch.Tensor, variance: torch.Tensor) -> None:
    old = copy.deepcopy(module)
    mean, variance = mean.to(old.weight.device), variance.to(old.weight.device)
    scale = old.weight / torch.sqrt(old.running_var + old.eps)
    shift = old.bias - scale * old.running_mean
    module.running_mean.copy_(mean)
    module.running_var.copy_(variance)
    module.weight.copy_(scale * torch.sqrt(variance + module.eps))
    module.bias.copy_(shift + scale * mean)
