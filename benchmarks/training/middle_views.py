"""Views for learning where the middle of a thread lies: profiles across its rough course, and its true middle on each.

The rough course is what the segmenter and the edges in the image give. The truth is the projected centreline of a
path-traced scene (NAME.npy, NAME.json), or where there is none, what the true coverage of a light scene says.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8
from scipy.spatial import cKDTree

from agents.perception.centrelines import thread_centrelines
from agents.perception.centrelines.along import Pieces, directions, gaussian
from agents.perception.centrelines.centrelines import SEGMENTED_COVERAGE, followed
from agents.perception.centrelines.learned import reach_px, seen_across, usual_width_px
from agents.perception.centrelines.profiles import normals
from agents.perception.centrelines.refine import tangent_sigma
from agents.perception.segmentation.network import segment_network
from benchmarks.training.scenes import EYES, Coverage, Image, View, views_in

WIDE_PLACES = np.linspace(-1.5, 1.5, 61, dtype=np.float32)
"""Wider and finer than the network looks, so that profiles can be drawn aside and made wider or narrower."""
DENSE_PX = 0.1
SCALED_EVERY = 3
"""One in so many views that are learned from is also shown smaller or larger, in another number of pixels."""
SMALLER, LARGER, SMALLER_SHARE = (0.5, 0.85), (1.25, 1.7), 0.6
FARTHEST_PX, FARTHEST_SHARE = 1.5, 0.5
"""A rough point farther from the truth, in pixels or widths, is on no thread, and nothing is learned there."""
LEAST_COSINE, LEAST_POINTS, MOST_POINTS = 0.9, 150, 30_000
SURE_PX = 0.08
"""Of the centreline that coverage gives, only what is so sure counts as true."""
APART_MM = 10_000.0
HELD_OUT, OF = 7, 8
"""Seeds that leave the one when divided by the other are not learned from."""


@dataclass(frozen=True)
class Truth:
    """Points of true middles, their directions, whether the thread is seen there, and where along it that is, in mm.

    Threads follow each other at APART_MM; the place is NaN where it is not known.
    """

    point: Float64[np.ndarray, "n 2"]
    tangent: Float64[np.ndarray, "n 2"]
    visible: Bool[np.ndarray, "n"]
    along_mm: Float64[np.ndarray, "n"]


@dataclass(frozen=True)
class MiddleView:
    """Profiles across the rough course of the threads in one view.

    Fields:
        colour: at WIDE_PLACES of the reach.
        offset_px: of the true middle from the rough one along the normal; 0 where it is not known.
        known: whether it is.
        along_mm: where along the true thread that is, the same in both eyes; NaN where that is not known.
    """

    name: str
    pieces: Pieces
    normal: Float64[np.ndarray, "n 2"]
    width_px: Float64[np.ndarray, "n"]
    colour: UInt8[np.ndarray, "n t 3"]
    offset_px: Float32[np.ndarray, "n"]
    known: Bool[np.ndarray, "n"]
    along_mm: Float32[np.ndarray, "n"]


def middle_views(folders: Iterable[Path], held_out: bool, scaled: bool = True) -> list[MiddleView]:
    """The views of scenes in folders: those that are held out, or those that are learned from, some of them scaled too.

    Raises:
        SceneFolderError: where a folder has no scenes.
    """
    rng = np.random.default_rng(21)
    found: list[MiddleView] = []
    for folder in folders:
        for index, view in enumerate(views_in([folder])):
            if _is_held_out(folder, view.name) != held_out or not view.coverage.any():
                continue
            truth = truth_of(folder, view)
            found += _view(view.name, view.image, truth)
            if scaled and not held_out and index % SCALED_EVERY == 0:
                found += _view(f"{view.name}_scaled", *_scaled(view.image, truth, rng))
    return found


def _is_held_out(folder: Path, name: str) -> bool:
    document = _document(folder, name)
    return document is not None and int(document["seed"]) % OF == HELD_OUT


def _document(folder: Path, name: str) -> dict[str, Any] | None:
    path = next(folder.rglob(f"{name.rpartition('_')[0]}.json"), None)
    return None if path is None else json.loads(path.read_text())


def truth_of(folder: Path, view: View) -> Truth:
    """The true middles in a view: projected from files beside it, or what its true coverage says."""
    name, _, eye = view.name.rpartition("_")
    files = sorted([*folder.rglob(f"{name}.npy"), *folder.rglob(f"{name}_thread*.npy")])
    document = _document(folder, view.name)
    if document is None or not files:
        return _covered(view.image, view.coverage)
    samples = [np.load(file).astype(np.float64) for file in files]
    parts = [
        _projected(some, document, EYES.index(eye), APART_MM * number)
        for number, some in enumerate(samples)
        if len(some)
    ]
    return _together([part for part in parts if len(part.point)])


def _projected(samples: Float64[np.ndarray, "n 6"], document: dict[str, Any], eye: int, begins_mm: float) -> Truth:
    """A sampled centreline (x, y, z, arc length, visible in the left, in the right) as one eye sees it."""
    K, x = np.array(document["K"]), samples[:, 0] - eye * document["baseline_mm"]
    u, v = K[0, 0] * x / samples[:, 2] + K[0, 2], K[1, 1] * samples[:, 1] / samples[:, 2] + K[1, 2]
    travelled = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(u), np.diff(v)))))
    even = np.arange(0.0, travelled[-1], DENSE_PX)
    point = np.column_stack([np.interp(even, travelled, part) for part in (u, v)])
    tangent = np.gradient(point, axis=0) / DENSE_PX if len(point) > 1 else np.zeros_like(point)
    visible, along_mm = (np.interp(even, travelled, samples[:, column]) for column in (4 + eye, 3))
    return Truth(point, tangent, visible > 0.5, begins_mm + along_mm)


def _covered(image: Image, coverage: Coverage) -> Truth:
    """The centreline that true, graded coverage gives, where it is sure of it."""
    line = thread_centrelines(image, coverage)
    pieces = Pieces(line.piece)
    ahead = line.point_px[np.minimum(np.arange(len(line.piece)) + 1, pieces.last[line.piece])]
    share = np.arange(0.0, 1.0, DENSE_PX)[:, None, None]
    tangent = directions(line.point_px, pieces, gaussian(2.0))
    point = (line.point_px * (1 - share) + ahead * share).reshape(-1, 2)
    sure = np.tile(line.deviation_px < SURE_PX, len(share))
    return Truth(point, np.tile(tangent, (len(share), 1)), sure, np.full(len(point), np.nan))


def _together(parts: list[Truth]) -> Truth:
    return Truth(
        np.concatenate([part.point for part in parts]),
        np.concatenate([part.tangent for part in parts]),
        np.concatenate([part.visible for part in parts]),
        np.concatenate([part.along_mm for part in parts]),
    )


def _scaled(image: Image, truth: Truth, rng: np.random.Generator) -> tuple[Image, Truth]:
    scale = float(np.exp(rng.uniform(*np.log(SMALLER if rng.uniform() < SMALLER_SHARE else LARGER))))
    if scale < 1:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.3 / scale), np.uint8)
    move = np.array([[scale, 0, (scale - 1) / 2], [0, scale, (scale - 1) / 2]])
    size = int(scale * image.shape[1]), int(scale * image.shape[0])
    shown = cv2.warpAffine(image, move, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(shown, np.uint8), replace(truth, point=(truth.point + 0.5) * scale - 0.5)


def _view(name: str, image: Image, truth: Truth) -> list[MiddleView]:
    """The view, or none where too little thread is found in it."""
    coverage = segment_network(image)
    rough = followed(image, coverage.astype(np.float32), coverage >= SEGMENTED_COVERAGE) if coverage.any() else None
    if rough is None or not LEAST_POINTS < len(rough.curves.point) < MOST_POINTS or len(truth.point) == 0:
        return []
    point, pieces = rough.curves.point, rough.curves.pieces
    width_px = usual_width_px(rough.seen.width_px, pieces)
    tangent = directions(point, pieces, gaussian(tangent_sigma(rough.width)))
    normal = normals(tangent)
    colour = seen_across(image, point, normal, reach_px(width_px), WIDE_PLACES).swapaxes(0, 1)
    offset_px, known, along_mm = offsets_to(truth, point, tangent)
    known &= np.abs(offset_px) < np.maximum(FARTHEST_PX, FARTHEST_SHARE * width_px)
    offset_px, along_mm = offset_px.astype(np.float32), along_mm.astype(np.float32)
    return [MiddleView(name, pieces, normal, width_px, colour.astype(np.uint8), offset_px, known, along_mm)]


def offsets_to(
    truth: Truth, point: Float64[np.ndarray, "n 2"], tangent: Float64[np.ndarray, "n 2"]
) -> tuple[Float64[np.ndarray, "n"], Bool[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """How far the truth lies from points, across it and to the side of their normals; whether that is known; where."""
    _, nearest = cKDTree(truth.point).query(point)
    along = truth.tangent[nearest] * np.where((truth.tangent[nearest] * tangent).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    apart = truth.point[nearest] - point
    beyond = np.abs((apart * along).sum(axis=1)) > 1.0
    alike = (along * tangent).sum(axis=1) > LEAST_COSINE
    known = truth.visible[nearest] & ~beyond & alike
    return (apart * normals(along)).sum(axis=1), known, truth.along_mm[nearest]
