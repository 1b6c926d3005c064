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
from agents.perception.segmentation.line_filter import RADIUS_PX, line_response, line_responses
from agents.perception.segmentation.near import Meant, Near

DETECTION_WIDTH_PX = 480
"""Width of the reduced image; the sizes in pixels below are of this image."""
BACKGROUND_WINDOW = 7
"""Of the median that is the local background, in pixels of twice the size: several times the thread's width."""
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
CROP_MARGIN_PX = 2 * (RADIUS_PX + BACKGROUND_WINDOW)
"""Around what is looked at: far enough for the filters and for the background to see what they see in a whole image.
Even, so that the image for the background is reduced alike."""


@dataclass(frozen=True)
class _View:
    """What is looked at of the reduced image.

    Fields:
        rows, columns: where it lies in the reduced image.
        near: which pixels of it may be thread; all, if it is None.
        meant: which of its ridges is.
        strong: how many pixels of the whole image are among its strongest.
    """

    rows: slice
    columns: slice
    near: Bool[np.ndarray, "h w"] | None
    meant: Meant | None
    strong: float
    colour: Float32[np.ndarray, "h w 3"]
    ground: UInt8[np.ndarray, "h w 3"]
    rarity: Float32[np.ndarray, "h w"]


@dataclass(frozen=True)
class _Pieces:
    """Connected pieces of a mask.

    Fields:
        labels: of each pixel; 0 is the ground.
        weight: the total score of each; 0 of the ground, of specks, and of what holds no seed.
        extent: the diagonal of each, in pixels.
    """

    labels: Int32[np.ndarray, "h w"]
    weight: Float64[np.ndarray, "c"]
    extent: Float64[np.ndarray, "c"]


@dataclass(frozen=True)
class _Found:
    """Ridge pixels of one polarity that look like thread, and their strength."""

    ridge: Bool[np.ndarray, "h w"]
    strength: float


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
    rows, columns = _box(where, reduced.shape)
    seen = reduced[rows, columns]
    background = _background(seen)
    view = _view(reduced, background, where, meant, rows, columns)
    if near is None:
        darker, brighter = mean_excess(background, seen), mean_excess(seen, background)
        of_dark, of_bright = line_responses(darker, brighter)
        dark, bright = _thread_among(of_dark, view), _thread_among(of_bright, view)
        is_bright = bright.strength > dark.strength
        found, contrast = (bright, brighter) if is_bright else (dark, darker)
    else:
        is_bright = near.is_bright
        contrast = mean_excess(*((seen, background) if is_bright else (background, seen)))
        found = _thread_among(line_response(contrast), view)
    background, ridge, contrast = (_in_whole(part, view, reduced.shape) for part in (background, found.ridge, contrast))
    return at_full_size(image, background, ridge, contrast, is_bright)


def _reduced(image: np.ndarray, share: float) -> np.ndarray:
    size = (max(1, round(image.shape[1] * share)), max(1, round(image.shape[0] * share)))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _box(near: Bool[np.ndarray, "h w"] | None, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """The rows and columns of the reduced image that hold everything near, with a margin."""
    if near is None:
        return slice(0, shape[0]), slice(0, shape[1])
    sides: list[slice] = []
    for axis, size in ((1, shape[0]), (0, shape[1])):
        hit = np.flatnonzero(near.any(axis=axis)) * (size / near.shape[1 - axis])
        first = max(0, int(hit[0]) - CROP_MARGIN_PX)
        sides.append(slice(first - first % 2, min(size, int(hit[-1]) + CROP_MARGIN_PX + 1)))
    return sides[0], sides[1]


def _view(
    reduced: UInt8[np.ndarray, "H W 3"],
    background: UInt8[np.ndarray, "h w 3"],
    near: Bool[np.ndarray, "h w"] | None,
    meant: Meant | None,
    rows: slice,
    columns: slice,
) -> _View:
    colour = _lab(reduced[rows, columns])
    rarity = _rarity(colour, _lab(np.ascontiguousarray(reduced[::4, ::4])).reshape(-1, 3))
    small = None
    if near is not None:
        whole = cv2.resize(near.astype(np.uint8), reduced.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        small = np.asarray(whole)[rows, columns] > 0
    if meant is not None:
        weight = cv2.resize(meant.weight, reduced.shape[1::-1], interpolation=cv2.INTER_AREA)
        meant = Meant(np.asarray(weight)[rows, columns], meant.alone)
    return _View(
        rows=rows,
        columns=columns,
        near=small,
        meant=meant,
        strong=STRONG_SHARE * (reduced.shape[0] * reduced.shape[1] - 1),
        colour=colour,
        ground=cv2.cvtColor(background, cv2.COLOR_BGR2Lab),
        rarity=rarity,
    )


def _background(image: UInt8[np.ndarray, "h w 3"]) -> np.ndarray:
    median = cv2.medianBlur(_reduced(image, 0.5), BACKGROUND_WINDOW)
    return cv2.resize(median, image.shape[1::-1], interpolation=cv2.INTER_LINEAR)


def _lab(image: np.ndarray) -> Float32[np.ndarray, "h w 3"]:
    return cv2.cvtColor(image, cv2.COLOR_BGR2Lab).astype(np.float32)


def _rarity(colour: Float32[np.ndarray, "h w 3"], sample: Float32[np.ndarray, "p 3"]) -> Float32[np.ndarray, "h w"]:
    """Mahalanobis distance of each pixel's colour from those of a sample of the whole image, up to a limit."""
    from_mean = sample - sample.mean(axis=0)
    spread, axes = np.linalg.eigh(from_mean.T @ from_mean / len(sample) + 4.0 * np.eye(3))
    # subtracted first: the usual colour then is not rare at all, not even by a rounding error
    away = colour - np.median(sample, axis=0)
    whitened = cv2.transform(away, (axes / np.sqrt(spread)).T.astype(np.float32))
    squared = cv2.transform(cv2.multiply(whitened, whitened), np.ones((1, 3), np.float32))
    return np.sqrt(np.minimum(np.asarray(squared, np.float32), np.float32(RAREST**2)))


def _thread_among(response: Float32[np.ndarray, "h w"], view: _View) -> _Found:
    """The thread among the ridges of one polarity."""
    response = response if view.near is None else np.where(view.near, response, np.float32(0))
    score = response * view.rarity
    strong = _from_top(score, view)
    ridges = _pieces(score > GROW_SHARE * strong, score > SEED_SHARE * strong, score)
    counting = ridges.weight if view.meant is None else _weight_meant(ridges, score * view.meant.weight)
    if not counting.any():
        return _Found(np.zeros(score.shape, bool), 0.0)
    strong = _from_top(response, view)
    ridge = np.flatnonzero(response > FAINT_SHARE * strong)
    piece = ridges.labels.ravel()[ridge] == int(np.argmax(counting))
    colour, ground = (part.reshape(-1, 3)[ridge] for part in (view.colour, view.ground))
    away = _colour_distance(colour, ground, score.ravel()[ridge], piece)
    alike = _of_pixels(ridge[away < GROWN_COLOUR_LIMIT], score.shape)
    seeds = _of_pixels(ridge[away < COLOUR_LIMIT], score.shape) & (response > SEED_SHARE * strong)
    pieces = _pieces(alike, seeds, score)
    longest = pieces.extent[pieces.weight > 0].max(initial=0)
    kept = (pieces.weight > LEAST_WEIGHT_SHARE * pieces.weight.max()) & (pieces.extent > LEAST_EXTENT_SHARE * longest)
    if view.meant is not None:
        counting = _weight_meant(pieces, score * view.meant.weight)
        chosen = kept & (counting == counting.max()) & (counting > 0)
        return _Found((chosen if view.meant.alone else kept)[pieces.labels], float(counting.max()))
    # faint pixels would count for whichever polarity has more clutter to grow into
    clear = _pieces(alike & (response > GROW_SHARE * strong), seeds, score)
    return _Found(kept[pieces.labels], float(clear.weight.max()))


def _of_pixels(index: Int64[np.ndarray, "p"], shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    mask = np.zeros(shape, bool)
    mask.ravel()[index] = True
    return mask


def _weight_meant(pieces: _Pieces, score: Float32[np.ndarray, "h w"]) -> Float64[np.ndarray, "c"]:
    """What speaks for each piece, of those that have weight."""
    total = np.bincount(pieces.labels.ravel(), weights=score.ravel(), minlength=len(pieces.weight))
    return np.where(pieces.weight > 0, total, 0.0)


def _from_top(values: Float32[np.ndarray, "h w"], view: _View) -> float:
    """The value so many places below the greatest near the thread, between its neighbours; 0 where there are fewer."""
    near = values.ravel() if view.near is None else values[view.near]
    places = view.strong
    if places >= len(near) - 1:
        return float(near.min(initial=0))
    whole = int(places)
    # so many blocks have a greatest value of at least this that no smaller value counts
    blocks = near[: len(near) - len(near) % BLOCK].reshape(BLOCK, -1).max(axis=0)
    if len(blocks) > whole + 1:
        near = near[near >= -np.partition(-blocks, whole + 1)[whole + 1]]
    above, below = -np.partition(-near, (whole, whole + 1))[whole : whole + 2]
    return float(above + (below - above) * (places - whole))


def _pieces(
    mask: Bool[np.ndarray, "h w"], seeds: Bool[np.ndarray, "h w"], score: Float32[np.ndarray, "h w"]
) -> _Pieces:
    """The connected pieces of a mask, of which only those that hold a seed have weight."""
    # OpenCV's own statistics of the pieces take several times as long as the pieces
    count, labelled = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)
    labels = np.asarray(labelled, np.int32)
    of_pixel, pixel = labels.ravel(), np.flatnonzero(mask)
    extent = np.hypot(*(_sides(of_pixel[pixel], at, count) for at in np.divmod(pixel, mask.shape[1])))
    weight = np.bincount(of_pixel[pixel], weights=score.ravel()[pixel], minlength=count)
    seeded = np.zeros(count, bool)
    seeded[of_pixel[np.flatnonzero(seeds & mask)]] = True
    weight[~seeded | (extent < LEAST_LENGTH_PX)] = 0.0
    weight[0] = 0.0
    return _Pieces(labels, weight, extent)


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
