"""What a network with classes finds in labelled views, pixel by pixel.

    python -m benchmarks.training.evaluate --scenes DIR [--weights OTHER.onnx]

Thread counts within 2 px; needle and instrument by what answer and truth have in common, of what is either.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from jaxtyping import Int64, UInt8

from agents.perception.segmentation.classes import WEIGHTS, Kind, highest, scores_of
from benchmarks.training.scenes import View, views_in

NEAR_PX = 2.0
Classes = UInt8[np.ndarray, "h w"]


@dataclass(frozen=True)
class ClassFigures:
    """Counts of pixels.

    Fields:
        true, found: of thread, and of those the ones that have a given one within 2 px.
        given, right: held to be thread, and of those the ones that have a true one within 2 px.
        common, either: of each class, the pixels that are it in both, and in truth or answer.
    """

    true: int
    found: int
    given: int
    right: int
    common: Int64[np.ndarray, "4"]
    either: Int64[np.ndarray, "4"]


def class_figures(true: Classes, given: Classes) -> ClassFigures:
    """How far the classes of one view are what they should be."""
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * int(NEAR_PX) + 1, 2 * int(NEAR_PX) + 1))
    true_thread, given_thread = (part == Kind.THREAD for part in (true, given))
    near_true, near_given = (
        np.asarray(cv2.dilate(part.view(np.uint8), reach)).view(bool) for part in (true_thread, given_thread)
    )
    both = [((true == kind) & (given == kind)).sum() for kind in Kind]
    either = [((true == kind) | (given == kind)).sum() for kind in Kind]
    return ClassFigures(
        true=int(true_thread.sum()),
        found=int((true_thread & near_given).sum()),
        given=int(given_thread.sum()),
        right=int((given_thread & near_true).sum()),
        common=np.array(both, np.int64),
        either=np.array(either, np.int64),
    )


def true_classes(view: View) -> Classes:
    """The class that covers most of each pixel of a view."""
    none = np.zeros_like(view.coverage)
    covered = [none if part is None else part for part in (view.coverage, view.needle, view.instrument)]
    ground = 255 - np.minimum(sum(part.astype(np.int32) for part in covered), 255)
    return np.stack((ground, *covered), axis=2).argmax(axis=2).astype(np.uint8)


def class_line(name: str, found: Sequence[ClassFigures]) -> str:
    """One line of figures over some views, whose pixels are counted together."""
    true, given = sum(part.true for part in found), sum(part.given for part in found)
    recall = sum(part.found for part in found) / max(true, 1)
    precision = sum(part.right for part in found) / max(given, 1)
    common, either = (np.sum(part, axis=0) for part in ([f.common for f in found], [f.either for f in found]))
    shares = common / np.maximum(either, 1)
    empty = [part for part in found if part.true == 0]
    false = f"; thread in {sum(part.given > 0 for part in empty)} of {len(empty)} without" if empty else ""
    return (
        f"{name}: thread recall {recall:.2%}, precision {precision:.2%} within {NEAR_PX:.0f} px; in common: needle "
        f"{_share(shares, either, Kind.NEEDLE)}, instrument {_share(shares, either, Kind.INSTRUMENT)}{false}\n"
    )


def _share(shares: np.ndarray, either: np.ndarray, kind: Kind) -> str:
    return f"{shares[kind]:.2%}" if either[kind] else "none there"


@dataclass(frozen=True)
class Options:
    """What is judged, and by which weights."""

    scenes: tuple[Path, ...]
    """Folders of labelled views."""
    weights: Path = WEIGHTS
    """ONNX in place of the project's own."""
    each: bool = False
    """A line for each view as well."""


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line and print the figures; returns the exit status."""
    options = tyro.cli(Options, args=arguments, description=__doc__)
    found: list[ClassFigures] = []
    for view in views_in(options.scenes, classes=True):
        found.append(class_figures(true_classes(view), highest(scores_of(view.image, options.weights))))
        if options.each:
            sys.stdout.write(class_line(view.name, found[-1:]))
    sys.stdout.write(class_line(f"{options.weights.name}, {len(found)} views", found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
