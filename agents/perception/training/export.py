"""Trained weights as ONNX: python -m agents.perception.training.export WEIGHTS.pt OUT.onnx."""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import argparse
import sys
import warnings
from pathlib import Path

import torch

from agents.perception.training.architecture import COLOURS, PHASES, ThreadNet, network_of

OPSET = 13
ROWS, COLUMNS = 272, 480
"""Half of 544 x 960, a usual image whose sides were made multiples of 16; OpenCV takes other sizes as well."""


def export(weights: Path, output: Path) -> None:
    """Write the network, batch normalisation folded in.

    Pixels go in; coverage of 0 to 1 comes out, by a sigmoid at its end, or the logits of classes as they are.
    """
    export_network(network_of(torch.load(weights, weights_only=True, map_location="cpu")), output)


def export_network(network: ThreadNet, output: Path) -> None:
    """As `export`, of a network at hand."""
    end = torch.nn.Sigmoid() if network.classes == 1 else torch.nn.Identity()
    whole = torch.nn.Sequential(network, end).eval()
    pixels = torch.zeros(1, PHASES * COLOURS, ROWS, COLUMNS)
    with warnings.catch_warnings():
        # the newer exporter needs further packages, and writes a form that OpenCV reads no better
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            whole,
            (pixels,),
            str(output),
            opset_version=OPSET,
            dynamo=False,
            input_names=["pixels"],
            output_names=["coverage" if network.classes == 1 else "logits"],
        )


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line and export; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m agents.perception.training.export", description=__doc__)
    parser.add_argument("weights", type=Path)
    parser.add_argument("output", type=Path)
    chosen = parser.parse_args(arguments)
    export(chosen.weights, chosen.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
