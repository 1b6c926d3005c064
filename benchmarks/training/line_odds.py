"""What speaks for a line and for its end: python -m benchmarks.training.line_odds --scenes DIR --judged DIR.

Lines of scenes with known truth (`segmentation.network.lines_in`), and their ends that look like metal
(`segmentation.line_ends`), seen as they are and through worse cameras, are told thread from none by logistic
regression. What it finds is printed, and then, of scenes that it was not fitted to, how many of each probability are
thread: a fit that is calibrated has as many as it says.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from jaxtyping import Bool, Float64, Int64, UInt8
from scipy.optimize import minimize

from agents.perception.segmentation import line_ends, network
from agents.perception.segmentation.boxes import extents
from agents.perception.segmentation.classes import ThreadScore, as_usual, thread_score
from benchmarks.training.scenes import View, views_in

Image = UInt8[np.ndarray, "h w 3"]
Parts = tuple[Float64[np.ndarray, "n k"], Int64[np.ndarray, "p"], Int64[np.ndarray, "p"]]
"""What each part of an image shows, the indices of the parts' pixels, and which part each of these belongs to."""
Judged = tuple[Float64[np.ndarray, "n k"], Bool[np.ndarray, "n"], Float64[np.ndarray, "n"]]
"""What each part shows, whether most of it is thread, and its length in pixels."""
AS_IT_IS = 0.2
"""Of the views; the others are seen through a worse camera."""
COVERED, BESIDE_PX = 60, 3
"""Coverage from which a pixel shows thread, 0 to 255, and how far beside it a line may lie."""
SHORTEST_PX, WHOLE_PX = 8, 200
"""Shorter lines are left out, and a line counts by its length, up to so much of it."""
RIDGE = 0.05
BINS = 0, 0.1, 0.3, 0.5, 0.7, 0.9, 1


@dataclass(frozen=True)
class Options:
    """What is fitted, and judged."""

    scenes: tuple[Path, ...]
    """Folders of scenes to fit to."""
    judged: tuple[Path, ...] = ()
    """Folders of other scenes."""
    seed: int = 5
    """Of the worse cameras."""


def main() -> None:
    """Fit and judge."""
    options = tyro.cli(Options, description=__doc__)
    for name, parts_of, weights in (("ends", _ends, line_ends.WEIGHTS), ("lines", _lines, network.WEIGHTS)):
        shown, is_thread, length = _parts(options.scenes, np.random.default_rng(options.seed), parts_of)
        fitted = _fitted(shown, is_thread, np.minimum(length, WHOLE_PX) / WHOLE_PX)
        print(f"{len(length)} {name}, {is_thread.mean():.0%} of them thread: {np.round(fitted, 2).tolist()}")
        if options.judged:
            _print_judged(*_parts(options.judged, np.random.default_rng(options.seed + 1), parts_of), weights)


def worse(image: Image, rng: np.random.Generator) -> Image:
    """As a worse camera shows it: paler, in other light, out of focus, noisy, compressed; each at times."""
    seen = image.astype(np.float64) / 255
    grey = seen.mean(axis=2, keepdims=True)
    if rng.random() < 0.5:
        seen = grey + (seen - grey) * np.exp(rng.normal(0, 0.4))
    gain, gamma = np.exp(rng.normal(0, 0.15) + rng.normal(0, 0.1, 3)), np.exp(rng.normal(0, 0.22))
    seen = np.clip(gain * np.clip(seen, 0, 1) ** gamma + rng.uniform(-0.04, 0.06), 0, 1)
    if rng.random() < 0.6:
        seen = np.asarray(cv2.GaussianBlur(seen, (0, 0), rng.uniform(0.3, 1.4)))
    if rng.random() < 0.6:
        read, shot = rng.uniform(0, 6) / 255, rng.uniform(0, 9) / 255
        seen = seen + np.sqrt(read**2 + shot**2 * seen) * rng.normal(size=seen.shape)
    pixels = np.clip(255 * seen, 0, 255).astype(np.uint8)
    if rng.random() < 0.4:
        data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(40, 95))])[1]
        pixels = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)
    return pixels


def _lines(score: ThreadScore) -> Parts:
    lines = network.lines_in(score)
    return network.evidence(lines), lines.pixel, lines.line.astype(np.int64)


def _ends(score: ThreadScore) -> Parts:
    ends = line_ends.ends_of(score, network.higher_than_around(score))
    return ends.evidence, ends.pixel, ends.end


def _parts(folders: Sequence[Path], rng: np.random.Generator, parts_of: Callable[[ThreadScore], Parts]) -> Judged:
    """The parts of all views in these folders."""
    shown, is_thread, length = zip(*_of_views(views_in(folders), rng, parts_of), strict=True)
    return np.concatenate(shown), np.concatenate(is_thread), np.concatenate(length)


def _of_views(
    views: list[View], rng: np.random.Generator, parts_of: Callable[[ThreadScore], Parts]
) -> Iterator[Judged]:
    for view in views:
        image = as_usual(view.image if rng.random() < AS_IT_IS else worse(view.image, rng))
        shown, pixel, part = parts_of(thread_score(image))
        coverage = cv2.resize(view.coverage, image.shape[1::-1], interpolation=cv2.INTER_AREA)
        side = 2 * BESIDE_PX + 1
        thread = np.asarray(cv2.dilate(coverage, np.ones((side, side), np.uint8))) >= COVERED
        count = len(shown)
        share = np.bincount(part, thread.ravel()[pixel], count) / np.maximum(np.bincount(part, minlength=count), 1)
        length = extents(part.astype(np.int32), pixel, image.shape[1], count)
        long = length >= SHORTEST_PX
        yield shown[long], share[long] > 0.5, length[long]


def _fitted(
    shown: Float64[np.ndarray, "n k"], is_thread: Bool[np.ndarray, "n"], counts: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "k"]:
    """The weights of what lines show, the last of which is always 1."""

    def loss(weights: Float64[np.ndarray, "k"]) -> float:
        odds = shown @ weights
        return float((counts * (np.logaddexp(0, odds) - is_thread * odds)).sum() + RIDGE * (weights[:-1] ** 2).sum())

    return np.asarray(minimize(loss, np.zeros(shown.shape[1])).x)


def _print_judged(
    shown: Float64[np.ndarray, "n k"],
    is_thread: Bool[np.ndarray, "n"],
    length: Float64[np.ndarray, "n"],
    weights: tuple[float, ...],
) -> None:
    """By the weights in use, in bins of probability: parts, what they are said to be, what they are; by length."""
    said = 1 / (1 + np.exp(-shown @ weights))
    for low, high in itertools.pairwise(BINS):
        here = (said >= low) & (said <= high)
        if here.any():
            told, true = (np.average(each[here], weights=length[here]) for each in (said, is_thread))
            print(f"{low:.1f} to {high:.1f}: {here.sum()}, said {told:.2f}, thread {true:.2f}")


if __name__ == "__main__":
    main()
