"""Trained weights as ONNX: python -m benchmarks.training.export WEIGHTS.pt OUT.onnx [--began EARLIER.pt].

With --began a share of the weights that the training went on from is kept: the mean of both is at home with what
either has learned (Wortsman et al., Robust fine-tuning of zero-shot models, CVPR 2022).
"""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import io
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import onnx
import torch
import tyro
from onnx import TensorProto, helper, numpy_helper

from benchmarks.training.architecture import COLOURS, PHASES, ClassNet, network_of

OPSET = 13
SMALL = 64
"""A tensor of fewer numbers stays as it is."""
ROWS, COLUMNS = 272, 480
"""Half of 544 x 960, a usual image whose sides were made multiples of 32; OpenCV takes other sizes as well."""


def between(began: Path, weights: Path, share: float) -> ClassNet:
    """The network whose weights lie so far on the way from those that a training went on from to its own."""
    first, last = (torch.load(path, weights_only=True, map_location="cpu") for path in (began, weights))
    return network_of(
        {
            name: torch.lerp(first[name], value, share) if value.is_floating_point() else value
            for name, value in last.items()
        }
    )


def export(weights: Path, output: Path) -> None:
    """Write the network, batch normalisation folded in: pixels go in, the logits of classes come out.

    Large tensors are kept as 16-bit floats, which halves the file; OpenCV computes with 32 bits.
    """
    export_network(network_of(torch.load(weights, weights_only=True, map_location="cpu")), output)


def export_network(network: ClassNet, output: Path) -> None:
    """As `export`, of a network at hand."""
    written = io.BytesIO()
    with warnings.catch_warnings():
        # the newer exporter needs further packages, and writes a form that OpenCV reads no better
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            network.eval(),
            (torch.zeros(1, PHASES * COLOURS, ROWS, COLUMNS),),
            written,
            opset_version=OPSET,
            dynamo=False,
            input_names=["pixels"],
            output_names=["logits"],
        )
    model = onnx.load_from_string(written.getvalue())
    _halve(model.graph)
    onnx.save(model, output)


def convolutions(exported: Path) -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
    """Kernel and bias of each convolution of an exported network, by its name there (`architecture.unfolded`)."""
    graph = onnx.load(exported).graph
    stored = {tensor.name: numpy_helper.to_array(tensor).astype(np.float32) for tensor in graph.initializer}
    stored |= {node.output[0]: stored[node.input[0]] for node in graph.node if node.op_type == "Cast"}
    found = dict[str, tuple[torch.Tensor, torch.Tensor]]()
    for node in graph.node:
        if node.op_type == "Conv":
            kernel, bias = (torch.from_numpy(stored[name]) for name in node.input[1:])
            found[_module_name(node.name)] = kernel, bias
    return found


def _module_name(node: str) -> str:
    """Of a node: `/to_half/to_half.0/Conv` is `to_half.0`, each part being named with those that hold it in a list."""
    parts = list[str]()
    for part in node.strip("/").split("/")[:-1]:
        if parts and part.startswith(f"{parts[-1]}."):
            parts.pop()
        parts.append(part)
    return ".".join(parts)


def _halve(graph: onnx.GraphProto) -> None:
    """Keep large tensors as 16-bit floats, and widen them before they are used."""
    kept, widened = [], []
    for tensor in graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.size > SMALL:
            narrow = f"{tensor.name}_16"
            widened.append(helper.make_node("Cast", [narrow], [tensor.name], to=TensorProto.FLOAT))
            kept.append(numpy_helper.from_array(values.astype(np.float16), narrow))
        else:
            kept.append(tensor)
    nodes = list(graph.node)
    del graph.initializer[:], graph.node[:]
    graph.initializer.extend(kept)
    graph.node.extend([*widened, *nodes])


@dataclass(frozen=True)
class Options:
    """From which weights to which file."""

    weights: Annotated[Path, tyro.conf.Positional]
    output: Annotated[Path, tyro.conf.Positional]
    began: Path | None = None
    """Weights that the training went on from."""
    share: float = 0.75
    """Of the way from those to WEIGHTS."""


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line and export; returns the exit status."""
    options = tyro.cli(Options, args=arguments, description=__doc__)
    if options.began is None:
        export(options.weights, options.output)
    else:
        export_network(between(options.began, options.weights, options.share), options.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
