"""Thread on textured ground without weights: elongated ridges, then the colour of the most thread-like of them.

Found on a reduced image, where a thread is one to four pixels wide; its width comes from the full one at the end.

1. What is darker than its surroundings and what is brighter are looked at apart, so that the gap between two glints
   is no dark line.
2. Oriented filters (`line_filter`) answer to lines of the thread's width and hardly to specks. Strong ridges are
   seeds, weaker ones connected to them extend them.
3. Of the connected ridges the one whose colour is rarest in the image, weighted by its contrast, is taken to be
   thread. Its colour decides which other ridges belong to it: vessels and folds are ridges too, of another colour.
   A pixel that is only partly thread has a mixture of the thread's colour and the ground's, and is judged as one.

Where it is known about where the thread is, only what lies near is looked at: the same numbers come out there, as if
nothing else in the image were a ridge.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64, UInt8

from agents.perception.segmentation.full_size import at_full_size, mean_excess
from agents.perception.segmentation.line_filter import RADIUS_PX, line_response
from agents.perception.segmentation.near import Meant, Near

DETECTION_WIDTH_PX = 480
"""Width of the reduced image; the sizes in pixels below are of this image."""
BACKGROUND_STEP, BACKGROUND_WINDOW = 3, 5
"""The local background is the median of so many pixels to a side, each as large as so many here: several times the
thread's width. Medians of more pixels take ten times as long."""
STRONG_SHARE = 0.003
"""Of the image's pixels: its strongest ridges."""
SEED_SHARE, GROW_SHARE = 0.5, 0.25
"""Of the response of the image's strongest ridges: what seeds a piece of thread, and what extends it."""
FAINT_SHARE = 0.15
"""What extends it where its colour is known to be the thread's: over dark ground a dark thread has little contrast."""
LEAST_LENGTH_PX = 12
"""Pieces shorter than this are specks."""
LEAST_WEIGHT_SHARE, LEAST_EXTENT_SHARE = 0.06, 0.2
"""Pieces with less response, or less extent, than this share of the greatest are clutter."""
LEAST_THREAD_PX, LEAST_SHARE_OF_LENGTH, LEAST_RESPONSE = 48, 0.2, 6.0
"""What cannot be thread alone: pieces of which the longest is shorter, or has less of the length of all together, as in
a field of glints; and ridges of fewer grey levels in the median, as in folds and noise."""
COLOUR_LIMIT, GROWN_COLOUR_LIMIT = 3.0, 4.5
"""Deviations from the thread's colour up to which a pixel seeds, or extends, a piece of thread."""
COLOUR_DEVIATION_RANGE = np.array([[8.0, 4.0, 4.0], [24.0, 8.0, 8.0]], np.float32)
"""Least and greatest deviation of a thread's own colour (OpenCV's 8-bit L, a, b)."""
LEAST_SHARE_OF_THREAD, MOSTLY_THREAD = 0.4, 0.8
"""In a mixed pixel: what is credited at least, and what is enough to learn the thread's colour from."""
RAREST = 6.0
"""Deviations from the image's colours beyond which a colour is not rarer still."""
LEAST_COLOUR_PIXELS = 8
BLOCK = 16
"""Values of which only the greatest counts while the strongest are looked for."""
FAINTEST_SHARE = 0.05
"""Of the response of the image's strongest ridges: pixels with less are looked at no further."""
CROP_MARGIN_PX = BACKGROUND_STEP * -(-(RADIUS_PX + BACKGROUND_STEP * BACKGROUND_WINDOW) // BACKGROUND_STEP)
"""Around what is looked at: far enough for the filters and for the background to see what they see in a whole image.
A multiple of the background's step, so that the image for it is reduced alike."""


@dataclass(frozen=True)
class _View:
    """What is looked at of the reduced image.

    Fields:
        rows, columns: where it lies in the reduced image.
        near: which pixels of it may be thread; all, if it is None.
        meant: which of its ridges is.
        strong: how many pixels of the whole image are among its strongest.
        rare: what makes a colour of the whole image rare.
        both: whether dark and bright thread are both looked for, so that it counts how strong each is.
    """

    rows: slice
    columns: slice
    near: Bool[np.ndarray, "h w"] | None
    meant: Meant | None
    strong: float
    seen: UInt8[np.ndarray, "h w 3"]
    background: UInt8[np.ndarray, "h w 3"]
    rare: "_Rare"
    both: bool


@dataclass(frozen=True)
class _Rare:
    """The usual colour of an image, and what takes differences from it to deviations."""

    usual: Float32[np.ndarray, "3"]
    whitening: Float32[np.ndarray, "3 3"]


@dataclass(frozen=True)
class _Ridges:
    """The pixels of one polarity that look a little like part of a line, and nothing of the others.

    Fields:
        shape: of the part of the reduced image that is looked at.
        pixel: indices in it.
        response: to lines, score: the same, weighted by how rare the colour is.
    """

    shape: tuple[int, int]
    pixel: Int64[np.ndarray, "p"]
    response: Float32[np.ndarray, "p"]
    score: Float32[np.ndarray, "p"]
    colour: Float32[np.ndarray, "p 3"]


@dataclass(frozen=True)
class _Pieces:
    """Connected pieces among ridge pixels.

    Fields:
        of: number of the piece of each ridge pixel; 0 of those in none.
        weight: the total score of each; 0 of the ground, of specks, and of what holds no seed.
        extent: the diagonal of each, in pixels.
    """

    of: Int32[np.ndarray, "p"]
    weight: Float64[np.ndarray, "c"]
    extent: Float64[np.ndarray, "c"]


@dataclass(frozen=True)
class _Found:
    """Ridge pixels of one polarity that look like thread, and their strength."""

    pixel: Int64[np.ndarray, "p"]
    strength: float


NOTHING = _Found(np.zeros(0, np.int64), 0.0)


def segment_ridge(
    image: UInt8[np.ndarray, "h w 3"], near: Near | None = None, meant: Meant | None = None
) -> UInt8[np.ndarray, "h w"]:
    """Coverage of each pixel by thread, 0 or 255: dark or bright thread, whichever stands out more.

    Args:
        near: where thread is looked for; anywhere, if it is None.
        meant: which ridge is thread; the one that stands out most, if it is None.
    """
    where = None if near is None else near.where
    if where is not None and not where.any():
        return np.zeros(image.shape[:2], np.uint8)
    reduced = _reduced(image, min(1.0, DETECTION_WIDTH_PX / image.shape[1]))
    view = _view(reduced, near, meant)
    darker = _of_polarity(view, False) if near is None or not near.is_bright else None
    brighter = _of_polarity(view, True) if near is None or near.is_bright else None
    is_bright = darker is None or (brighter is not None and brighter[0].strength > darker[0].strength)
    found, contrast = brighter if is_bright and brighter else darker or (NOTHING, np.zeros(view.seen.shape[:2]))
    ridge = _of_pixels(found.pixel, view.seen.shape[:2])
    background, ridge, contrast = (_in_whole(part, view, reduced.shape) for part in (view.background, ridge, contrast))
    return at_full_size(image, background, ridge, contrast, is_bright)


def _of_polarity(view: _View, is_bright: bool) -> tuple[_Found, Float32[np.ndarray, "h w"]]:
    """The thread among what is brighter, or darker, than its surroundings, and by how much everything is."""
    contrast = mean_excess(*((view.seen, view.background) if is_bright else (view.background, view.seen)))
    return _thread_among(_ridges(_response(contrast, view.near), view), view), contrast


def _response(contrast: Float32[np.ndarray, "h w"], near: Bool[np.ndarray, "h w"] | None) -> Float32[np.ndarray, "h w"]:
    """The response to lines where thread may be, 0 elsewhere."""
    if near is None:
        return line_response(contrast)
    left, top, columns, rows = cv2.boundingRect(near.view(np.uint8))
    box = np.s_[top : top + rows, left : left + columns]
    response = np.zeros_like(contrast)
    np.multiply(line_response(contrast, *box), near[box], out=response[box])
    return response


def _reduced(image: np.ndarray, share: float) -> np.ndarray:
    size = (max(1, round(image.shape[1] * share)), max(1, round(image.shape[0] * share)))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _view(reduced: UInt8[np.ndarray, "H W 3"], near: Near | None, meant: Meant | None) -> _View:
    small = None
    if near is not None:
        small = (
            np.asarray(cv2.resize(near.where.view(np.uint8), reduced.shape[1::-1], interpolation=cv2.INTER_NEAREST)) > 0
        )
        # a place that falls between the pixels of the reduced image is looked at all the same
        small = small if small.any() else np.ones(small.shape, bool)
    rows, columns = _box(small, reduced.shape)
    seen = reduced[rows, columns]
    if meant is not None:
        weight = cv2.resize(meant.weight, reduced.shape[1::-1], interpolation=cv2.INTER_AREA)
        meant = Meant(np.asarray(weight)[rows, columns], meant.alone)
    return _View(
        rows=rows,
        columns=columns,
        near=None if small is None else small[rows, columns],
        meant=meant,
        strong=STRONG_SHARE * (reduced.shape[0] * reduced.shape[1] - 1),
        seen=seen,
        background=_background(seen),
        rare=_rare(np.ascontiguousarray(reduced[::4, ::4])),
        both=near is None,
    )


def _box(near: Bool[np.ndarray, "h w"] | None, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """The rows and columns of the reduced image that hold everything near, with a margin."""
    if near is None:
        return slice(0, shape[0]), slice(0, shape[1])
    sides: list[slice] = []
    for axis, size in ((1, shape[0]), (0, shape[1])):
        hit = np.flatnonzero(near.any(axis=axis))
        first = max(0, int(hit[0]) - CROP_MARGIN_PX)
        last = min(size, int(hit[-1]) + CROP_MARGIN_PX + 1)
        sides.append(slice(first - first % BACKGROUND_STEP, min(size, last + -last % BACKGROUND_STEP)))
    return sides[0], sides[1]


def _background(image: UInt8[np.ndarray, "h w 3"]) -> np.ndarray:
    height, width = image.shape[:2]
    size = max(1, width // BACKGROUND_STEP), max(1, height // BACKGROUND_STEP)
    median = cv2.medianBlur(cv2.resize(image, size, interpolation=cv2.INTER_AREA), BACKGROUND_WINDOW)
    return cv2.resize(median, (width, height), interpolation=cv2.INTER_LINEAR)


def _lab(colour: UInt8[np.ndarray, "p 3"]) -> Float32[np.ndarray, "p 3"]:
    if len(colour) == 0:
        return np.zeros((0, 3), np.float32)
    return np.asarray(cv2.cvtColor(colour[None], cv2.COLOR_BGR2Lab), np.float32)[0]


def _rare(sample: UInt8[np.ndarray, "h w 3"]) -> _Rare:
    """From a sample of the whole image."""
    channels = np.ascontiguousarray(_lab(sample.reshape(-1, 3)).T)
    from_mean = channels - channels.mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(from_mean @ from_mean.T / channels.shape[1] + 4.0 * np.eye(3))
    usual = np.median(channels, axis=1).astype(np.float32)
    return _Rare(usual, (axes / np.sqrt(spread)).astype(np.float32))


def _rarity(colour: Float32[np.ndarray, "p 3"], rare: _Rare) -> Float32[np.ndarray, "p"]:
    """Mahalanobis distance of each colour from those of the whole image, up to a limit."""
    # subtracted first: the usual colour then is not rare at all, not even by a rounding error
    away = (colour - rare.usual) @ rare.whitening
    return np.minimum(np.sqrt(np.einsum("pc,pc->p", away, away)), np.float32(RAREST))


def _ridges(response: Float32[np.ndarray, "h w"], view: _View) -> _Ridges:
    faintest = FAINTEST_SHARE * _from_top(response.ravel(), view.strong)
    pixel = np.flatnonzero(response > faintest)
    of_pixel = response.ravel()[pixel]
    colour = _lab(view.seen.reshape(-1, 3)[pixel])
    return _Ridges(response.shape, pixel, of_pixel, of_pixel * _rarity(colour, view.rare), colour)


def _thread_among(ridges: _Ridges, view: _View) -> _Found:
    """The thread among the ridges of one polarity."""
    if len(ridges.pixel) == 0:
        return NOTHING
    response, score = ridges.response, ridges.score
    meant = None if view.meant is None else score * view.meant.weight.ravel()[ridges.pixel]
    strong = _from_top(score, view.strong)
    pieces = _pieces(ridges, score > GROW_SHARE * strong, score > SEED_SHARE * strong)
    counting = pieces.weight if meant is None else _weight_meant(pieces, meant)
    if not counting.any():
        return NOTHING
    strong = _from_top(response, view.strong)
    visible = response > FAINT_SHARE * strong
    away = np.full(len(response), np.inf, np.float32)
    ground = _lab(view.background.reshape(-1, 3)[ridges.pixel[visible]])
    piece = pieces.of[visible] == int(np.argmax(counting))
    away[visible] = _colour_distance(ridges.colour[visible], ground, score[visible], piece)
    alike = away < GROWN_COLOUR_LIMIT
    seeds = (away < COLOUR_LIMIT) & (response > SEED_SHARE * strong)
    pieces = _pieces(ridges, alike, seeds)
    longest = pieces.extent[pieces.weight > 0].max(initial=0)
    kept = (pieces.weight > LEAST_WEIGHT_SHARE * pieces.weight.max()) & (pieces.extent > LEAST_EXTENT_SHARE * longest)
    if view.meant is not None and meant is not None:
        counting = _weight_meant(pieces, meant)
        chosen = kept & (counting == counting.max()) & (counting > 0)
        return _Found(ridges.pixel[(chosen if view.meant.alone else kept)[pieces.of]], float(counting.max()))
    if longest < max(LEAST_THREAD_PX, LEAST_SHARE_OF_LENGTH * pieces.extent[kept].sum()):
        return NOTHING
    if np.median(response[kept[pieces.of]]) < LEAST_RESPONSE:
        return NOTHING
    if not view.both:
        return _Found(ridges.pixel[kept[pieces.of]], 0.0)
    # faint pixels would count for whichever polarity has more clutter to grow into
    clear = _pieces(ridges, alike & (response > GROW_SHARE * strong), seeds)
    return _Found(ridges.pixel[kept[pieces.of]], float(clear.weight.max()))


def _of_pixels(index: Int64[np.ndarray, "p"], shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    mask = np.zeros(shape, bool)
    mask.ravel()[index] = True
    return mask


def _weight_meant(pieces: _Pieces, score: Float32[np.ndarray, "p"]) -> Float64[np.ndarray, "c"]:
    """What speaks for each piece, of those that have weight."""
    total = np.bincount(pieces.of, weights=score, minlength=len(pieces.weight))
    return np.where(pieces.weight > 0, total, 0.0)


def _from_top(values: Float32[np.ndarray, "p"], places: float) -> float:
    """The value so many places below the greatest, between its neighbours; the least where there are fewer."""
    if places >= len(values) - 1:
        return float(values.min(initial=0))
    whole = int(places)
    # so many blocks have a greatest value of at least this that no smaller value counts
    blocks = values[: len(values) - len(values) % BLOCK].reshape(BLOCK, -1).max(axis=0)
    if len(blocks) > whole + 1:
        values = values[values >= -np.partition(-blocks, whole + 1)[whole + 1]]
    above, below = -np.partition(-values, (whole, whole + 1))[whole : whole + 2]
    return float(above + (below - above) * (places - whole))


def _pieces(ridges: _Ridges, kept: Bool[np.ndarray, "p"], seeds: Bool[np.ndarray, "p"]) -> _Pieces:
    """The connected pieces of the ridge pixels that are kept, of which only those that hold a seed have weight."""
    mask = _of_pixels(ridges.pixel[kept], ridges.shape)
    # OpenCV's own statistics of the pieces take several times as long as the pieces
    count, labelled = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)
    piece = np.asarray(labelled, np.int32).ravel()[ridges.pixel]
    extent = np.hypot(*(_sides(piece[kept], at, count) for at in np.divmod(ridges.pixel[kept], ridges.shape[1])))
    weight = np.bincount(piece, weights=ridges.score, minlength=count)
    seeded = np.zeros(count, bool)
    seeded[piece[seeds]] = True
    weight[~seeded | (extent < LEAST_LENGTH_PX)] = 0.0
    weight[0] = 0.0
    return _Pieces(piece, weight, extent)


def _sides(piece: Int32[np.ndarray, "p"], at: Int64[np.ndarray, "p"], count: int) -> Float64[np.ndarray, "c"]:
    """How many rows, or columns, each piece reaches over; 0 where a piece has no pixel."""
    first, last = np.full(count, np.iinfo(np.int64).max), np.full(count, -1)
    np.minimum.at(first, piece, at)
    np.maximum.at(last, piece, at)
    return np.where(last >= 0, last - np.minimum(first, last) + 1.0, 0.0)


def _colour_distance(
    colour: Float32[np.ndarray, "p 3"],
    ground: UInt8[np.ndarray, "p 3"],
    score: Float32[np.ndarray, "p"],
    piece: Bool[np.ndarray, "p"],
) -> Float32[np.ndarray, "p"]:
    """How many deviations each pixel's colour is from a mixture of the thread's and its own ground's, in two rounds.

    The colour c of a pixel with the share α of thread is α t + (1 − α) g; what α leaves over of c − g, over α, is how
    far the thread in it would have to be from t. The piece of thread may have grown into vessels that it crosses, so t
    is first the median of its best-scored quarter.
    """
    own = piece & (score >= np.percentile(score[piece], 75, method="lower")) if piece.any() else piece
    away = np.full(len(colour), np.inf, np.float32)
    channels, ground_channels = (np.ascontiguousarray(part.T, np.float32) for part in (colour, ground))
    from_ground = channels - ground_channels
    for least in (1, LEAST_COLOUR_PIXELS):
        if np.count_nonzero(own) < least:
            break
        known = channels[:, own]
        thread = np.median(known, axis=1, keepdims=True)
        spread = 1.4826 * np.median(np.abs(known - thread), axis=1, keepdims=True)
        per_deviation = 1 / np.clip(spread, *COLOUR_DEVIATION_RANGE[:, :, None])
        seen, whole = from_ground * per_deviation, (thread - ground_channels) * per_deviation
        along = (seen * whole).sum(axis=0) / np.maximum((whole * whole).sum(axis=0), 1e-6)
        share = np.clip(along, LEAST_SHARE_OF_THREAD, 1.0)
        left = seen - share * whole
        away = np.sqrt((left * left).sum(axis=0)) / share
        own = piece & (away < COLOUR_LIMIT) & (share > MOSTLY_THREAD)
    return away


def _in_whole(part: np.ndarray, view: _View, shape: tuple[int, ...]) -> np.ndarray:
    """What was found in a part of the reduced image, in the whole of it, with nothing around."""
    whole = np.zeros((*shape[:2], *part.shape[2:]), part.dtype)
    whole[view.rows, view.columns] = part
    return whole
