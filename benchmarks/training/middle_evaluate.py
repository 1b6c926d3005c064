"""How far the middle between the edges and the learned one lie from the true one, in rendered views that are held out.

python -m benchmarks.training.middle_evaluate --scenes DIR [--weights OTHER.npz] [--all] [--each]
"""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from jaxtyping import Float64, Int64
from scipy.spatial import cKDTree

from agents.perception.centrelines.learned import Weights, learned_middles, own_weights, weights_in
from benchmarks.training.middle_crops import ALIKE_MM, eye_pairs, profiles_of
from benchmarks.training.middle_views import MiddleView, middle_views

WINDOW_POINTS = 60
"""Over so many points errors are averaged, to tell what neighbours share: that bends a curve, the rest averages out."""
NORMAL = 0.6745
"""Of a standard deviation lie half of all errors within."""


@dataclass(frozen=True)
class Figures:
    """Of one view, in pixels: errors, those that neighbours share, and the mean across to the right, before and after.

    Fields:
        inside: share of points within the deviation that is said.
    """

    off: tuple[float, float]
    shared: tuple[float, float]
    aside: tuple[float, float]
    inside: float


def figures_of(view: MiddleView, weights: Weights) -> Figures | None:
    """The errors in one view; None where too little of its truth is known."""
    offset, deviation = said(view, weights)
    known = view.known
    if known.sum() < WINDOW_POINTS:
        return None
    before, after = view.offset_px[known].astype(np.float64), (view.offset_px - offset)[known]
    rightwards = view.normal[known, 0]
    return Figures(
        (_robust(before), _robust(after)),
        (_shared(before), _shared(after)),
        (abs(float(np.mean(before * rightwards))), abs(float(np.mean(after * rightwards)))),
        float((np.abs(after) < deviation[known]).mean()),
    )


def said(view: MiddleView, weights: Weights) -> tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """Offset and deviation at every point of a view."""
    shown, some, pieces = profiles_of(view)
    found = learned_middles(shown, view.normal[some], pieces, weights)
    everywhere = np.arange(len(view.width_px))
    offset, deviation = (np.interp(everywhere, some, part) for part in (found.offset_px, found.deviation_px))
    return offset, deviation


def same_points(left: MiddleView, right: MiddleView) -> tuple[Int64[np.ndarray, "k"], Int64[np.ndarray, "k"]]:
    """Indices of points of both eyes that show the same places of a thread; none where either shows too few."""
    ours, others = (np.flatnonzero(view.known & ~np.isnan(view.along_mm)) for view in (left, right))
    if min(len(ours), len(others)) < WINDOW_POINTS:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    distance, nearest = cKDTree(right.along_mm[others, None]).query(left.along_mm[ours, None])
    both = np.asarray(distance) < ALIKE_MM
    return ours[both], others[np.asarray(nearest)[both]]


def apart_px(left: MiddleView, right: MiddleView, errors: Sequence[Float64[np.ndarray, "_"]]) -> float | None:
    """By how much more to the right neighbours of a pair lie in the left eye than in the right one: that is depth.

    Across the thread, times the normal's share along the row; None where both eyes show too little of the same thread.
    """
    ours, others = same_points(left, right)
    if len(ours) < WINDOW_POINTS:
        return None
    rightwards = [error * np.sign(view.normal[:, 0]) for error, view in zip(errors, (left, right), strict=True)]
    return _shared((rightwards[0][ours] - rightwards[1][others]) * np.abs(left.normal[ours, 0]))


def _apart(views: Iterable[MiddleView], weights: Weights) -> str:
    """The medians over pairs of eyes, before and after, in words."""
    found: list[tuple[float, float]] = []
    for pair in eye_pairs(views):
        before = [view.offset_px.astype(np.float64) for view in pair]
        after = [offset - said(view, weights)[0] for offset, view in zip(before, pair, strict=True)]
        if (first := apart_px(*pair, before)) is not None and (then := apart_px(*pair, after)) is not None:
            found.append((first, then))
    if not found:
        return ""
    before, after = np.median(found, axis=0)
    return f"apart in {len(found)} pairs of eyes {before:.3f}, {after:.3f} px; "


def line_of(name: str, views: Iterable[MiddleView], weights: Weights) -> str:
    """One line of medians over views, and over pairs of eyes where both are among them."""
    views = list(views)
    found = [figures for view in views if (figures := figures_of(view, weights)) is not None]
    if not found:
        return f"{name}: nothing is known of any view\n"
    off, shared, aside = (
        np.median([getattr(one, what) for one in found], axis=0) for what in ("off", "shared", "aside")
    )
    inside = float(np.median([one.inside for one in found]))
    return (
        f"{name}, {len(found)} views: off {off[0]:.3f} px before, {off[1]:.3f} px after; "
        f"shared by {WINDOW_POINTS} points {shared[0]:.3f}, {shared[1]:.3f} px; "
        f"to one side {aside[0]:.3f}, {aside[1]:.3f} px; "
        f"{_apart(views, weights)}"
        f"{inside:.0%} within the deviation\n"
    )


def _robust(error: Float64[np.ndarray, "n"]) -> float:
    return float(np.median(np.abs(error)) / NORMAL)


def _shared(error: Float64[np.ndarray, "n"]) -> float:
    windows = len(error) // WINDOW_POINTS
    mean = error[: windows * WINDOW_POINTS].reshape(windows, -1).mean(axis=1)
    return float(np.sqrt(np.mean(mean**2)))


@dataclass(frozen=True)
class Options:
    """What is judged, and by which weights."""

    scenes: tuple[Path, ...]
    """Folders of rendered scenes."""
    weights: Path | None = None
    """In place of the project's own."""
    all: bool = False
    """All views, where none of the folders was learned from."""
    each: bool = False
    """A line for each view as well."""


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line and print the figures; returns the exit status."""
    options = tyro.cli(Options, args=arguments, description=__doc__)
    weights = own_weights() if options.weights is None else weights_in(options.weights)
    views = middle_views(options.scenes, held_out=True)
    if options.all:
        views += middle_views(options.scenes, held_out=False, scaled=False)
    for view in views if options.each else []:
        sys.stdout.write(line_of(view.name, [view], weights))
    sys.stdout.write(line_of("all", views, weights))
    return 0


if __name__ == "__main__":
    sys.exit(main())
