"""Threads, needles and what looks like them in lab scenes: shaded strands along curves in the image.

Lengths are pixels, colours display values, blue first.
"""

import dataclasses

import cv2
import numpy as np
from jaxtyping import Float64

from benchmarks.training.lab_ground import (
    GROUND,
    NEEDLE,
    THREAD,
    Canvas,
    Colour,
    Curve,
    Lists,
    as_drawn,
    darken,
    lay,
    wandering,
)
from benchmarks.training.lab_instruments import mirrored_surrounding

STEP_PX = 0.5
SUNK_PX = 3.0
"""Within which a strand that goes into the ground vanishes."""


@dataclasses.dataclass(frozen=True)
class Strand:
    """A curve with widths and heights over the ground at each point, and which of its ends go into the ground."""

    path: Curve
    widths: Float64[np.ndarray, "n"]
    heights: Float64[np.ndarray, "n"]
    sinks: tuple[bool, bool] = (False, False)


@dataclasses.dataclass(frozen=True)
class Look:
    """How a thread shines: all threads of a scene that are of one kind share it."""

    colour: Colour
    braid: float
    pitch: float
    gloss: float
    rough: float


def thread_look(rng: np.random.Generator, lists: Lists, ground: Colour) -> Look:
    """A colour of the list, or nearly the ground's own in a quarter of all cases."""
    if rng.random() < 0.25:
        bgr = np.array(ground) * rng.uniform(0.65, 1.25) * rng.normal(1, 0.05, 3)
    else:
        bgr = np.array(lists.threads[int(rng.integers(len(lists.threads)))]) * rng.normal(1, 0.04, 3)
    colour = tuple(float(value) for value in np.clip(bgr, 4, 250))
    braid = rng.choice([0, 1]) * rng.uniform(0.08, 0.5)
    gloss = rng.choice([0.1, 1]) * rng.uniform(5, 130)
    return Look((colour[0], colour[1], colour[2]), braid, rng.uniform(0.8, 3.5), gloss, rng.uniform(0, 0.15))


def resampled(path: Curve) -> Curve:
    """The same curve with a point every half pixel."""
    arc = np.concatenate(([0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
    at = np.arange(0, arc[-1], STEP_PX)
    return np.column_stack([np.interp(at, arc, path[:, axis]) for axis in (0, 1)])


def smooth_along(rng: np.random.Generator, count: int, size: float) -> np.ndarray:
    """Smooth noise of about unit deviation along so many points (n,)."""
    knots = rng.standard_normal(max(int(count / size), 1) + 4)
    return cv2.resize(knots[None], (int(len(knots) * size) + 1, 1), interpolation=cv2.INTER_CUBIC)[0, int(size) :][
        :count
    ]


def free_strand(
    rng: np.random.Generator, shape: tuple[int, int], width: float, start: np.ndarray, height: float
) -> Strand:
    """A curve that wanders from the start, with loops, partly in the air."""
    path = resampled(wandering(rng, start, shape[1] * rng.uniform(0.2, 1.5), rng.choice([2, 5, 9]) / shape[1]))
    widths = width * (1 + 0.08 * smooth_along(rng, len(path), 150 * rng.uniform(0.5, 3)))
    lift = np.abs(smooth_along(rng, len(path), 200)) * rng.choice([0, 0.3, 1]) * rng.uniform(5, 60)
    lift += height * np.exp(-np.arange(len(path)) / rng.uniform(100, 500))
    return Strand(path, widths, lift, (False, bool(rng.random() < 0.3)))


def lay_thread(rng: np.random.Generator, canvas: Canvas, strand: Strand, look: Look, kind: int = THREAD) -> None:
    """Shadow, dimples at its ends, and the thread itself."""
    _cast(rng, canvas, strand)
    _dimples(rng, canvas, strand)
    pixels = _pixels(strand, canvas.light.shape[:2])
    lamp = np.array((*canvas.light_xy, 1.0))
    lamp /= np.linalg.norm(lamp)
    half = lamp + np.array((0, 0, 1))
    half /= np.linalg.norm(half)
    normal = _normals(pixels)
    phase = 2 * np.pi * pixels.at * STEP_PX / (look.pitch * float(np.median(strand.widths)))
    turn = np.arcsin(np.clip(pixels.across, -1, 1))
    braid = 1 + look.braid * np.cos(phase + turn) * np.cos(phase - turn)
    uneven = 1 + look.rough * smooth_along(rng, len(strand.path), 12)[pixels.at]
    diffuse = (0.35 + 0.75 * np.clip(normal @ lamp, 0, 1)) * braid * uneven
    patches = np.clip(0.7 + 0.4 * smooth_along(rng, len(strand.path), rng.uniform(30, 250)), 0, 1.5)[pixels.at]
    shine = look.gloss * np.clip(normal @ half, 0, 1) ** rng.uniform(8, 60) * patches * braid
    _lay_pixels(canvas, pixels, np.array(look.colour) * diffuse[:, None] + shine[:, None], kind)


def lay_needle(rng: np.random.Generator, canvas: Canvas, strand: Strand) -> None:
    """A steel needle: it mirrors an invented surrounding."""
    _cast(rng, canvas, strand)
    _dimples(rng, canvas, strand)
    pixels = _pixels(strand, canvas.light.shape[:2])
    normal = _normals(pixels)
    around = mirrored_surrounding(rng, np.array(canvas.ground)) * rng.uniform(0.5, 1.1)
    look = np.clip(31.5 + 30 * normal[:, :2], 0, 63).astype(int)
    uneven = 1 + rng.uniform(0.05, 0.4) * smooth_along(rng, len(strand.path), rng.uniform(4, 60))[pixels.at]
    grain = 1 + rng.uniform(0, 0.25) * rng.standard_normal(len(uneven))
    dark = np.clip(rng.uniform(0.3, 1.2) + 0.6 * smooth_along(rng, len(strand.path), 80)[pixels.at], 0.15, 1.3)
    _lay_pixels(canvas, pixels, around[look[:, 1], look[:, 0]] * (uneven * grain * dark)[:, None], NEEDLE)


def needle_arc(rng: np.random.Generator, shape: tuple[int, int], middle: np.ndarray | None) -> Strand:
    """An arc of a circle seen aslant, from its blunt end to its tip; its grip or its centre at the given point."""
    scale = shape[1] / 960
    radius = np.exp(rng.uniform(np.log(22), np.log(260))) * scale
    # the wire of a suture needle is an eighth to a twentieth of its radius
    width = np.clip(radius / rng.uniform(8, 20), 2 * scale, 18 * scale)
    first = rng.standard_normal(3)
    first /= np.linalg.norm(first)
    second = np.cross(first, rng.standard_normal(3))
    second /= np.linalg.norm(second)
    angle = np.linspace(0, np.pi * rng.uniform(0.75, 1.0), 200)[:, None]
    path = radius * (np.cos(angle) * first + np.sin(angle) * second)
    path -= path[int(200 * rng.uniform(0.1, 0.6))]
    flat = path[:, :2] + (middle if middle is not None else rng.uniform(0.1, 0.9, 2) * shape[::-1])
    kept = 200 if rng.random() < 0.6 else int(rng.uniform(80, 190))
    even = resampled(flat[:kept])
    taper = np.clip((1 - np.linspace(0, kept / 200, len(even))) / rng.uniform(0.08, 0.3), 0.12, 1)
    blunt = np.interp(np.arange(len(even)), [0, 6 * width], [rng.uniform(0.8, 1.25), 1])
    lift = np.interp(np.linspace(0, kept, len(even)), np.arange(200), path[:, 2] - path[:kept, 2].min())
    return Strand(even, width * taper * blunt, lift * rng.uniform(0.2, 1), (False, kept < 200))


def stitches(rng: np.random.Generator, canvas: Canvas, width: float, look: Look) -> None:
    """Bars across a slit, or across an invented line, with knots and cut ends."""
    shape = canvas.light.shape[:2]
    if canvas.slits and rng.random() < 0.8:
        line = canvas.slits[int(rng.integers(len(canvas.slits)))]
    else:
        line = wandering(rng, rng.uniform(0.2, 0.8, 2) * shape[::-1], shape[1] * rng.uniform(0.15, 0.6), 0.001)
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None] + 1e-9
    reach, slant = rng.uniform(4, 14) * width, rng.normal(0, 0.5)
    count = int(rng.integers(2, 12))
    knotted, tails = rng.random(), rng.uniform(3, 25)
    for at in np.linspace(0.08, 0.92, count) + rng.normal(0, 0.02, count):
        point, way = (values[int(np.clip(at, 0, 0.999) * len(line))] for values in (line, along))
        across = np.array((-way[1], way[0])) + rng.normal(slant, 0.12) * way
        t = np.linspace(-1, 1, 30)[:, None]
        bow = rng.normal(0, 0.12) * (1 - t**2) * way * reach
        bar = resampled(point + rng.uniform(0.7, 1.2) * reach * t * across + bow)
        if len(bar) < 6:
            continue
        full = np.full(len(bar), width)
        lay_thread(rng, canvas, Strand(bar, full, 0 * full + rng.uniform(0, 2) * width, (True, True)), look)
        if rng.random() < knotted:
            knot(rng, canvas, bar[int(rng.uniform(0.05, 0.95) * len(bar))], width, look, tails)


def knot(rng: np.random.Generator, canvas: Canvas, at: np.ndarray, width: float, look: Look, tails: float) -> None:
    """A small tangle with up to three cut ends, frayed at times; `tails` is their length in widths."""
    for _ in range(int(rng.integers(1, 4))):
        angle = np.linspace(0, 2 * np.pi * rng.uniform(0.6, 1.3), 40)[:, None] + rng.uniform(0, 6)
        size, turn = width * rng.uniform(0.5, 2.2, 2), rng.uniform(-2, 2, (2, 2))
        loop = resampled(
            at + rng.normal(0, 0.5, 2) * width + np.concatenate((np.cos(angle), np.sin(angle)), 1) * size @ turn
        )
        if len(loop) > 4:
            full = np.full(len(loop), width)
            lay_thread(rng, canvas, Strand(loop, full, full * rng.uniform(0.3, 2)), look)
    for _ in range(int(rng.integers(0, 4))):
        path = resampled(wandering(rng, at, width * tails * rng.uniform(0.5, 1.4) + 8, 0.15 / width))
        full = np.full(len(path), width)
        lay_thread(rng, canvas, Strand(path, full, np.linspace(0, rng.uniform(0, 8) * width, len(path))), look)
        if rng.random() < 0.4:
            fray(rng, canvas, path[-1], width, look)


def fray(rng: np.random.Generator, canvas: Canvas, at: np.ndarray, width: float, look: Look) -> None:
    """Single fibres at a cut end."""
    for _ in range(int(rng.integers(2, 6))):
        path = resampled(wandering(rng, at, width * rng.uniform(1.5, 5) + 8, 0.3 / width))
        full = np.full(len(path), max(0.3 * width, 0.7))
        lay_thread(rng, canvas, Strand(path, full, 0 * full), dataclasses.replace(look, braid=0.0))


def distractor(rng: np.random.Generator, canvas: Canvas) -> None:
    """A cable or tube of no class, far thicker than thread, that has no end in the image."""
    shape = canvas.light.shape[:2]
    width = rng.uniform(17, 40) * shape[1] / 960
    path = wandering(rng, np.zeros(2), 3 * shape[1], 1.2 / shape[1])
    path = resampled(path - path[len(path) // 2] + rng.uniform(0.1, 0.9, 2) * shape[::-1])
    colour = rng.uniform(5, 240, 3)
    look = Look((float(colour[0]), float(colour[1]), float(colour[2])), 0.0, 2.0, rng.uniform(0, 150), 0.05)
    full = np.full(len(path), width)
    lay_thread(rng, canvas, Strand(path, full, full / 2), look, GROUND)


def _cast(rng: np.random.Generator, canvas: Canvas, strand: Strand) -> None:
    """The shadow on what is below, in three pieces: the higher the strand, the softer and the farther."""
    strength = rng.uniform(0.15, 0.7)
    shadow = (
        strand.path
        - strand.heights[:, None] * np.array(canvas.light_xy)
        - 0.35 * strand.widths[:, None] * np.array(canvas.light_xy)
    )
    levels = np.digitize(strand.heights, (4.0, 16.0))
    width = max(round(float(np.median(strand.widths))), 1)
    for level in np.unique(levels):
        mask, (edges,) = np.zeros(canvas.light.shape[:2], np.uint8), np.nonzero(np.diff(levels))
        for piece, its in zip(np.split(shadow, edges + 1), np.split(levels, edges + 1), strict=True):
            if its[0] == level and len(piece) > 1:
                cv2.polylines(mask, [as_drawn(piece[::3])], False, 255, width, cv2.LINE_AA, 4)
        sigma = 0.8 + 0.25 * float(strand.heights[levels == level].mean())
        darken(canvas, mask, sigma, strength * (1 - 0.2 * float(level)))


def _dimples(rng: np.random.Generator, canvas: Canvas, strand: Strand) -> None:
    """A dark hollow where an end goes into the ground."""
    for end, sinks in zip((0, -1), strand.sinks, strict=True):
        if sinks:
            mask = np.zeros(canvas.light.shape[:2], np.uint8)
            x, y = strand.path[end]
            size = float(np.median(strand.widths)) * rng.uniform(0.4, 1.6)
            cv2.circle(mask, (int(np.clip(x, -99, 9999)), int(np.clip(y, -99, 9999))), max(int(size), 1), 255, -1)
            darken(canvas, mask, rng.uniform(1, 2.5), rng.uniform(0.1, 0.6))


@dataclasses.dataclass(frozen=True)
class _Pixels:
    """Pixels that a strand covers, once for each time that it passes, those passed over first."""

    flat: np.ndarray
    at: np.ndarray
    """Index of the nearest point of the path."""
    across: np.ndarray
    """-1 to 1 from side to side."""
    cover: np.ndarray
    side: np.ndarray
    """Unit vector across the strand (n, 2)."""


def _pixels(strand: Strand, shape: tuple[int, int]) -> _Pixels:
    tangent = np.gradient(strand.path, axis=0)
    tangent = cv2.blur(tangent, (1, 5))
    tangent /= np.linalg.norm(tangent, axis=1)[:, None] + 1e-9
    side = np.column_stack((-tangent[:, 1], tangent[:, 0]))
    reach = float(strand.widths.max()) / 2 + 1.0
    offsets = np.arange(-reach, reach + STEP_PX, STEP_PX)
    pixel = np.rint(strand.path[:, None] + offsets[:, None] * side[:, None]).astype(int)
    at = np.broadcast_to(np.arange(len(strand.path))[:, None], pixel.shape[:2])
    inside = (pixel >= 0).all(axis=2) & (pixel[..., 0] < shape[1]) & (pixel[..., 1] < shape[0])
    pixel, at = pixel[inside], at[inside]
    away = pixel - strand.path[at]
    across, along = (away * side[at]).sum(axis=1), np.abs((away * tangent[at]).sum(axis=1))
    flat = pixel[:, 1] * shape[1] + pixel[:, 0]
    order = np.lexsort((at, flat))
    flat, at, across, along = flat[order], at[order], across[order], along[order]
    gap = int((3 * reach + 4) / STEP_PX)
    is_new = np.concatenate(([True], (np.diff(flat) != 0) | (np.diff(at) > gap)))[: len(flat)]
    visit = np.cumsum(is_new) - 1
    best = np.lexsort((along, visit))
    best = best[np.concatenate(([True], np.diff(visit[best]) != 0))[: len(best)]]
    flat, at, across, along = flat[best], at[best], across[best], along[best]
    half = strand.widths[at] / 2
    cover = np.clip(half - np.abs(across) + 0.5, 0, np.minimum(2 * half, 1)) * (along < 1.0)
    for sinks, far in zip(strand.sinks, (at, len(strand.path) - 1 - at), strict=True):
        cover *= np.clip(far * STEP_PX / SUNK_PX, 0, 1) if sinks else 1
    over = np.argsort(strand.heights[at] + 1e-6 * at, kind="stable")
    over = over[np.argsort(flat[over], kind="stable")]
    return _Pixels(
        flat[over], at[over], np.clip(across / np.maximum(half, 0.5), -1, 1)[over], cover[over], side[at][over]
    )


def _normals(pixels: _Pixels) -> np.ndarray:
    """Of a round strand, towards the camera: (n, 3)."""
    across = 0.97 * pixels.across[:, None]
    return np.concatenate((pixels.side * across, np.sqrt(1 - across**2)), axis=1)


def _lay_pixels(canvas: Canvas, pixels: _Pixels, colours: np.ndarray, kind: int) -> None:
    """Blend the passes into the canvas one after the other."""
    shape = canvas.light.shape[:2]
    flat = pixels.flat
    if len(flat) == 0:
        return
    is_new = np.concatenate(([True], np.diff(flat) != 0))
    rank = np.arange(len(flat)) - np.maximum.accumulate(np.where(is_new, np.arange(len(flat)), 0))
    for layer in range(int(rank.max()) + 1):
        (now,) = np.nonzero(rank == layer)
        rows, columns = np.divmod(flat[now], shape[1])
        box = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        size = canvas.light[box].shape
        alpha, colour = np.zeros(size[:2], np.float32), np.zeros(size, np.float32)
        alpha[rows - box[0].start, columns - box[1].start] = pixels.cover[now]
        colour[rows - box[0].start, columns - box[1].start] = colours[now]
        lay(canvas, box, colour, alpha, kind)
