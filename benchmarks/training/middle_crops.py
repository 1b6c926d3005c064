"""Varied profiles across threads to learn their middle from: drawn aside, in other light, mirrored and turned round.

Mirroring hides nothing here, as it does from a network that sees whole images: how the middle follows from what is
seen is learned, and in a mirror it follows alike. Which side the light is on must be told by the profiles themselves.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from agents.perception.centrelines.along import STRIDE, Pieces, blurred, gaussian
from agents.perception.centrelines.learned import BEYOND_PX, PLACES, straightened
from benchmarks.training.middle_drawn import SHADOW_WIDTHS, drawn_view, shadow_band
from benchmarks.training.middle_views import WIDE_PLACES, MiddleView

VIEWS, STRETCHES, LENGTH = 14, 8, 192
"""Of a batch: stretches of so many points from each of so many views, since the light is that of the whole view."""
ALONE = 4
"""Of the views of a batch, the first so many are drawn or of one eye; the rest are left and right eyes in turn."""
ALIKE_MM = 0.15
"""Points of both eyes that lie so near each other along the thread are the same."""
NONE = -1
ASIDE_PX, JITTER_PX, MOST_ASIDE_PX = 0.4, 0.08, 1.2
"""Standard deviations of how far a rough middle is drawn aside, at most, over long and within short distances."""
KNOT_POINTS = 16
ALONG_PX = 1.0
"""Standard deviation of the average along the thread, of which every second profile counts."""
WIDTH_SPREAD = 0.06
MORE_LIGHT, SHADOW_SHARE, MORE_SHADOW, BLUR_SHARE = 0.12, 0.4, 0.4, 0.25
"""Of light across the thread; of views that get another shadow; how deep that is at most; of views that are blurred."""
DRAWN, NEWLY_DRAWN_SHARE = 48, 0.1
"""One view of each batch is drawn; the last so many are kept, and so often there is another."""
Batch = tuple[
    Float32[np.ndarray, "v k n c"],
    Float32[np.ndarray, "v k n"],
    Float32[np.ndarray, "v k n 2"],
    Bool[np.ndarray, "v k n"],
    Int64[np.ndarray, "v k n"],
]
"""Profiles, offset of the middle in pixels, normal, whether the offset is known, and for points of left eyes which one
of the same stretch of the next view, its right eye, is the same; NONE where none is."""


@dataclass(frozen=True)
class _Stretches:
    """Of one view, as they are shown to the network, and where along the thread their points lie."""

    shown: Float32[np.ndarray, "k n c"]
    offset: Float64[np.ndarray, "k n"]
    normal: Float64[np.ndarray, "k n 2"]
    known: Bool[np.ndarray, "k n"]
    along_mm: Float64[np.ndarray, "k n"]


def batches(views: Sequence[MiddleView], seed: int | list[int]) -> Iterator[Batch]:
    """Batches without end, the same for the same seed."""
    rng = np.random.default_rng([*np.atleast_1d(seed), 22])
    usable = [view for view in views if len(_starts(view))]
    pairs = eye_pairs(usable)
    paired = {view.name for pair in pairs for view in pair}
    lone = [view for view in usable if view.name not in paired] or usable
    drawn: list[MiddleView] = []
    while True:
        if not drawn or rng.uniform() < NEWLY_DRAWN_SHARE:
            drawn = [*drawn[1 - DRAWN :], drawn_view(rng)]
        alone = [drawn[rng.integers(len(drawn))], *(lone[k] for k in rng.integers(len(lone), size=ALONE - 1))]
        parts = [_varied(view, rng.choice(_starts(view), STRETCHES), rng, rng) for view in alone]
        for _ in range((VIEWS - ALONE) // 2):
            left, right = pairs[rng.integers(len(pairs))] if pairs else (usable[rng.integers(len(usable))],) * 2
            at_left, light = rng.choice(_starts(left), STRETCHES), int(rng.integers(2**31))
            # both eyes are seen in one light, but their rough middles lie aside by themselves
            parts += [
                _varied(view, at, rng, np.random.default_rng(light))
                for view, at in ((left, at_left), (right, _same_place(left, at_left, right, rng)))
            ]
        shown, offset, normal, known = (
            np.stack([getattr(part, what) for part in parts]) for what in ("shown", "offset", "normal", "known")
        )
        yield shown, offset.astype(np.float32), normal.astype(np.float32), known, _same_points(parts)


def eye_pairs(views: Iterable[MiddleView]) -> list[tuple[MiddleView, MiddleView]]:
    """Left and right views of the same scenes, where it is known which of their points are the same."""
    by_name = {view.name: view for view in views if not np.isnan(view.along_mm).all()}
    left = [name.removesuffix("_left") for name in by_name if name.endswith("_left")]
    return [(by_name[f"{name}_left"], by_name[f"{name}_right"]) for name in left if f"{name}_right" in by_name]


def _same_place(
    left: MiddleView, at: Int64[np.ndarray, "k"], right: MiddleView, rng: np.random.Generator
) -> Int64[np.ndarray, "k"]:
    """Where stretches of the right eye begin, so that their middles show what those of the left one show."""
    starts = _starts(right)
    middle = left.along_mm[at + LENGTH // 2]
    seen = right.along_mm[starts + LENGTH // 2]
    apart = np.abs(np.where(np.isnan(seen), np.inf, seen) - middle[:, None])
    apart = np.where(np.isnan(apart), np.inf, apart)
    nearest = apart.argmin(axis=1)
    found = apart[np.arange(len(at)), nearest] < LENGTH
    return np.where(found, starts[nearest], rng.choice(starts, len(at)))


def _same_points(parts: Sequence[_Stretches]) -> Int64[np.ndarray, "v k n"]:
    same = np.full((len(parts), *parts[0].known.shape), NONE)
    for index in range(ALONE, len(parts), 2):
        left, right = parts[index], parts[index + 1]
        seen = np.where(right.known & ~np.isnan(right.along_mm), right.along_mm, np.inf)
        apart = np.abs(left.along_mm[:, :, None] - seen[:, None])
        nearest = apart.argmin(axis=2)
        near = np.take_along_axis(apart, nearest[:, :, None], axis=2)[:, :, 0] < ALIKE_MM
        same[index] = np.where(near & left.known, nearest, NONE)
    return same


def profiles_of(view: MiddleView) -> tuple[Float32[np.ndarray, "m c"], np.ndarray, Pieces]:
    """What the network takes of a whole view as it is, of which points, and their pieces."""
    n, pieces = len(view.width_px), view.pieces
    colour = resampled(view.colour, np.broadcast_to(PLACES, (n, len(PLACES))))
    colour = _averaged(colour, pieces)
    some, thinned = pieces.every_second
    return straightened(_across(colour[some]), view.width_px[some], thinned), some, thinned


def _starts(view: MiddleView) -> np.ndarray:
    return np.flatnonzero(view.pieces.after >= LENGTH - 1)


def _varied(view: MiddleView, start: np.ndarray, rng: np.random.Generator, light: np.random.Generator) -> _Stretches:
    """Stretches of a view drawn aside, and in another light, which may be that of the other eye too."""
    at = (start[:, None] + np.arange(LENGTH)).ravel()
    width = view.width_px[at]
    taken_for = width * np.exp(rng.normal(0, WIDTH_SPREAD))
    aside = _drawn_aside(rng)
    places = (PLACES * (taken_for + BEYOND_PX)[:, None] + aside[:, None]) / (width + BEYOND_PX)[:, None]
    colour = _averaged(resampled(view.colour[at], places), _stretches(LENGTH))[::STRIDE]
    at, aside, width = (part[::STRIDE] for part in (at, aside, taken_for))
    offset, known, normal, along_mm = view.offset_px[at] - aside, view.known[at], view.normal[at], view.along_mm[at]
    colour = _noisy(_relit(_shaded(colour, offset, width, normal, light), light), rng)
    if light.uniform() < 0.5:
        colour, offset, normal = colour[:, ::-1], -offset, normal * [-1.0, 1.0]
    each = STRETCHES, LENGTH // STRIDE
    if rng.uniform() < 0.5:
        back = np.arange(len(at)).reshape(each)[:, ::-1].ravel()
        colour, offset, normal = colour[back, ::-1], -offset[back], -normal[back]
        known, width, along_mm = known[back], width[back], along_mm[back]
    shown = straightened(_across(colour), width, _stretches(each[1]))
    return _Stretches(
        shown.reshape(*each, -1),
        offset.reshape(each),
        normal.reshape(*each, 2),
        known.reshape(each),
        along_mm.astype(np.float64).reshape(each),
    )


def _stretches(length: int) -> Pieces:
    return Pieces(np.repeat(np.arange(STRETCHES), length))


def _averaged(colour: Float32[np.ndarray, "n t 3"], pieces: Pieces) -> Float32[np.ndarray, "n t 3"]:
    return blurred(_across(colour), pieces, gaussian(ALONG_PX)).swapaxes(0, 1)


def _across(colour: np.ndarray) -> Float32[np.ndarray, "t n 3"]:
    return np.ascontiguousarray(colour.swapaxes(0, 1), np.float32)


def resampled(colour: np.ndarray, places: Float64[np.ndarray, "n t"]) -> Float32[np.ndarray, "n t 3"]:
    """Profiles that were seen at WIDE_PLACES, at others."""
    step = float(WIDE_PLACES[1] - WIDE_PLACES[0])
    where = np.clip((places - float(WIDE_PLACES[0])) / step, 0, len(WIDE_PLACES) - 1.001)
    before = where.astype(np.int64)
    share = (where - before)[..., None].astype(np.float32)
    flat = colour.astype(np.float32).reshape(-1, 3)
    before += np.arange(len(colour))[:, None] * len(WIDE_PLACES)
    return flat[before] * (1 - share) + flat[before + 1] * share


def _drawn_aside(rng: np.random.Generator) -> Float64[np.ndarray, "n"]:
    knots = rng.normal(0, 0.5 * ASIDE_PX * rng.uniform(0, 2), (STRETCHES, LENGTH // KNOT_POINTS + 1))
    x = np.arange(LENGTH) / KNOT_POINTS
    before = x.astype(np.int64)
    share = x - before
    share = share * share * (3 - 2 * share)
    aside = knots[:, before] * (1 - share) + knots[:, before + 1] * share
    aside += rng.normal(0, rng.uniform(0, JITTER_PX), aside.shape)
    return np.clip(aside, -MOST_ASIDE_PX, MOST_ASIDE_PX).ravel()


def _shaded(
    colour: Float32[np.ndarray, "n t 3"],
    offset: Float64[np.ndarray, "n"],
    width: Float64[np.ndarray, "n"],
    normal: Float64[np.ndarray, "n 2"],
    rng: np.random.Generator,
) -> Float32[np.ndarray, "n t 3"]:
    """More light from one side, at times a shadow beside the thread, at times more blur across it."""
    towards = rng.uniform(0, 2 * np.pi)
    across = normal @ np.array([np.cos(towards), np.sin(towards)])
    x = (PLACES * (width + BEYOND_PX)[:, None] - offset[:, None]) / (width[:, None] / 2)
    light = 1 + rng.normal(0, MORE_LIGHT) * across[:, None] * np.tanh(x)
    if rng.uniform() < SHADOW_SHARE:
        aside = across * np.exp(rng.uniform(*np.log(SHADOW_WIDTHS)))
        shadow = rng.uniform(0, MORE_SHADOW) * shadow_band(x, aside, rng.uniform(0.2, 0.6))
        light *= np.where(np.abs(x) > 1, 1 - shadow, 1)
    colour = (colour * light[..., None]).astype(np.float32)
    if rng.uniform() < BLUR_SHARE:
        kernel = gaussian(rng.uniform(0.3, 1.2))
        beyond = len(kernel) // 2
        padded = np.pad(colour, ((0, 0), (beyond, beyond), (0, 0)), mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, len(kernel), axis=1)
        colour = (windows @ kernel).astype(np.float32)
    return colour


def _relit(colour: Float32[np.ndarray, "n t 3"], rng: np.random.Generator) -> Float32[np.ndarray, "n t 3"]:
    """Another tone curve, exposure, white balance; at times channels that mix."""
    gain = np.exp(rng.normal(0, 0.1, 3) + rng.normal(0, 0.15))
    shown = 255 * gain * (np.maximum(colour, 0) / 255) ** np.exp(rng.normal(0, 0.15)) + rng.normal(0, 6)
    if rng.uniform() < 0.3:
        mixed = np.eye(3) + rng.normal(0, 0.12, (3, 3))
        shown = shown @ (mixed / mixed.sum(axis=1, keepdims=True)).T
    return np.clip(shown, 0, 255)


def _noisy(colour: Float32[np.ndarray, "n t 3"], rng: np.random.Generator) -> Float32[np.ndarray, "n t 3"]:
    return colour + rng.normal(0, rng.uniform(0, 4), colour.shape) if rng.uniform() < 0.5 else colour
