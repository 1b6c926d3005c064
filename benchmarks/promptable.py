"""What a crop costs segmenter `promptable`: around the network, and with a network of one's own, in it.

    python -m benchmarks.promptable
    python -m benchmarks.promptable --encoder hq_encoder.onnx --decoder hq_decoder.onnx

Without files the tests' tiny network is run, which has learnt nothing and costs next to nothing: what is printed then
is what preparing a crop, handing it over, choosing a mask and fusing it cost at least. Times are medians, of the
processor, and so the sum over its cores; `waited` is by the clock on the wall.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from agents.perception.prompt import meant_at, meant_like
from agents.perception.segmentation.promptable import PromptableSegmenter, crop_side
from agents.perception.segmentation.promptable_model import Embedded, PromptableFiles, PromptableModel
from shared.clock import Stopwatch, processor_s
from shared.scene.__main__ import make_scene
from shared.scene.render import RenderedPair, render
from tests.agents.perception.tiny_promptable import write_tiny

SCENES = (("easy", 3), ("medium", 7), ("crossing", 2))


class Timed:
    """A network, and how long each of its answers took."""

    def __init__(self, network: PromptableModel) -> None:
        self._network = network
        self.spent_ms: dict[str, list[float]] = {"encode": [], "decode": []}

    def embed(self, crop: np.ndarray) -> Embedded:
        """As the network does."""
        began = processor_s()
        found = self._network.embed(crop)
        self.spent_ms["encode"].append(1e3 * (processor_s() - began))
        return found

    def masks(self, embedded: Embedded, point_px: np.ndarray, is_thread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As the network does."""
        began = processor_s()
        found = self._network.masks(embedded, point_px, is_thread)
        self.spent_ms["decode"].append(1e3 * (processor_s() - began))
        return found


def clicked(pair: RenderedPair) -> np.ndarray:
    """A pixel on the left image's thread."""
    v, u = np.nonzero(pair.coverage_left == pair.coverage_left.max())
    return np.array([u[len(u) // 2], v[len(v) // 2]], float)


def both_eyes(segment: PromptableSegmenter, pair: RenderedPair) -> tuple[np.ndarray, np.ndarray]:
    """Coverage of both images by the thread at a click."""
    left = segment(pair.left_bgr, None, meant_at(clicked(pair), pair.left_bgr.shape))
    return left, segment(pair.right_bgr, None, meant_like(pair.left_bgr, left, pair.right_bgr))


def found_shares(coverage: tuple[np.ndarray, np.ndarray], pair: RenderedPair) -> list[float]:
    """Of each eye's thread pixels, how many were found."""
    true = pair.coverage_left > 127, pair.coverage_right > 127
    return [float((found[thread] > 0).mean()) for found, thread in zip(coverage, true, strict=True)]


def measured(work: Callable[[], tuple[np.ndarray, np.ndarray]]) -> tuple[tuple[np.ndarray, np.ndarray], float, float]:
    """What some work gives, and milliseconds of the processor and of the clock on the wall."""
    watch, began = Stopwatch("all"), processor_s()
    with watch.step("all"):
        found = work()
    return found, 1e3 * (processor_s() - began), watch.ms["all"]


def main(files: PromptableFiles, name: str) -> None:
    """Print a line for each scene, and one for a crop."""
    network = Timed(PromptableModel(files))
    segment = PromptableSegmenter(network)
    print(f"network: {name}")
    heading = f"{'scene':10} {'size':>9} {'crop px':>8} {'crops':>6} {'cpu ms':>9} {'waited ms':>10}"
    print(f"{heading} {'found left, right':>18}")
    around: list[float] = []
    for config, seed in SCENES:
        pair = render(make_scene(config, "tissue", seed))
        before = len(network.spent_ms["encode"]), sum(map(sum, network.spent_ms.values()))
        coverage, cpu_ms, wall_ms = measured(lambda pair=pair: both_eyes(segment, pair))
        crops = len(network.spent_ms["encode"]) - before[0]
        around.append((cpu_ms - sum(map(sum, network.spent_ms.values())) + before[1]) / max(1, crops))
        height, width = pair.left_bgr.shape[:2]
        shares = ", ".join(f"{share:.1%}" for share in found_shares(coverage, pair))
        size = f"{width}x{height}"
        side = crop_side(pair.left_bgr.shape)
        print(f"{config:10} {size:>9} {side:8} {crops:6} {cpu_ms:9.0f} {wall_ms:10.0f} {shares:>18}")
    encode, decode = (float(np.median(spent)) for spent in network.spent_ms.values())
    print(f"a crop, cpu ms: encode {encode:.0f}, decode {decode:.0f}, all around them {np.median(around):.0f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--encoder", type=Path)
    parser.add_argument("--decoder", type=Path)
    given = parser.parse_args()
    if given.encoder is not None and given.decoder is not None:
        main(PromptableFiles(given.encoder, given.decoder), f"{given.encoder.name}, {given.decoder.name}")
    else:
        with tempfile.TemporaryDirectory() as folder:
            main(write_tiny(Path(folder), hq=True), "the tests' tiny one, with the signature of HQ-SAM")
