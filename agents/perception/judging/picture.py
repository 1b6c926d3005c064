"""What one eye's picture tells by itself, or beside the other's: exposure, sharpness, interlacing.

**Sharpness** is how soft the sharpest edges of an image are in each direction, in pixels. An edge that is a step
blurred by a Gaussian of standard deviation s has a gradient that falls by

    R = sqrt(1 + (s0 / s)^2),   so that   s = s0 / sqrt(R^2 - 1),

where it is blurred again by s0 (Zhuo and Sim 2011). Edges of things may be soft, as those of ink on paper and of
folds are: only what the lens or a motion softens is soft everywhere. A motion by a deviation m softens an edge whose
normal is at an angle a to it by m |cos a|, so no edge lets m be more than

    s / |cos a|.

The sharpest few edges tell, whichever way they run, a slanting thread's among them. Noise, and things thinner than
their blur, let these look sharper than they are, by up to half.

**Interlacing**: frame grabbers weave an image from two fields of different moments. Where things moved in between,
every other row is displaced, and a pixel is brighter than both of its neighbours above and below, or darker than both.
Texture and noise do that along the columns as often as along the rows; only fields do it along the columns alone. A
scene that stands still tells nothing.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from agents.perception.judging.answers import Answer, untold, well, wrong
from schemas.messages import Severity

WIDTH_PX = 960
"""Wider images are reduced to this, which takes noise away and time."""
AGAIN_PX = 1.5
"""The second blur: about as much as what is looked for."""
BEFORE_PX = 0.8
"""Noise has gradients too: this much blur is laid on first, and taken off the result."""
LEAST_EDGES = 200
LEAST_STEP, LEAST_STEEPNESS = 30.0, 1.0
"""Grey levels from one side of an edge to the other, and per pixel on it, of one that stands out of noise."""
LEAST_COSINE = 0.5
"""Edges that run closer to a direction than this tell nothing about a motion along it."""
SHARPEST_SHARE = 0.02
"""Of the edges: so many may look sharper than they are, for noise and for what is thinner than its blur."""
SOFTEST_PX = 20.0
BORDER_SHARE = 0.125
"""Of each side: lenses draw worst there, and rectification and video overlays have sharp borders of their own."""

DIRECTIONS_DEG = (0.0, 45.0, 90.0, 135.0)
"""From right to down. The one across each is two further on."""

Image = Float32[np.ndarray, "h w"]


def softness_px(grey: UInt8[np.ndarray, "h w"]) -> tuple[float | None, ...]:
    """Of the sharpest edges, along each of `DIRECTIONS_DEG`; None where too few cross that direction to tell."""
    height, width = grey.shape
    share = min(1.0, WIDTH_PX / width)
    if share < 1:
        size = max(1, round(share * width)), max(1, round(share * height))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    dv, du = (round(BORDER_SHARE * side) for side in grey.shape)
    soft, normal = _edges(grey[dv : grey.shape[0] - dv, du : grey.shape[1] - du].astype(np.float32))
    angles = np.radians(DIRECTIONS_DEG)
    cosines = np.abs(np.stack((np.cos(angles), np.sin(angles)), axis=1).astype(np.float32) @ normal)
    return tuple(_of_sharpest(soft, cosine, share) for cosine in cosines)


def _of_sharpest(soft: Float32[np.ndarray, "n"], cosine: Float32[np.ndarray, "n"], share: float) -> float | None:
    telling = cosine > LEAST_COSINE
    if telling.sum() < LEAST_EDGES:
        return None
    return float(np.quantile(soft[telling] / cosine[telling], SHARPEST_SHARE)) / share


def _edges(image: Image) -> tuple[Float32[np.ndarray, "n"], Float32[np.ndarray, "2 n"]]:
    """How soft each edge is in its middle, and its normal: right, down."""
    smooth = cv2.GaussianBlur(image, (0, 0), BEFORE_PX)
    gradient = _gradient(smooth)
    again = _gradient(cv2.GaussianBlur(smooth, (0, 0), AGAIN_PX))
    steepness = np.asarray(cv2.magnitude(*gradient))
    at = np.flatnonzero(_is_middle(steepness, gradient))
    steep = steepness.ravel()[at]
    normal = np.stack([along.ravel()[at] for along in gradient]) / steep
    blurred = np.abs(again[0].ravel()[at] * normal[0] + again[1].ravel()[at] * normal[1])
    fall = np.maximum(steep / np.maximum(blurred, 1e-3), 1.0 + 1e-4)
    soft = np.minimum(AGAIN_PX / np.sqrt(fall**2 - 1), SOFTEST_PX)
    strong = steep * np.sqrt(2 * np.pi * (soft**2 + BEFORE_PX**2)) > LEAST_STEP
    return np.sqrt(np.maximum(soft**2 - BEFORE_PX**2, 0.0))[strong], normal[:, strong]


def _gradient(image: Image) -> tuple[Image, Image]:
    along_rows = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    return np.asarray(along_rows), np.asarray(cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=3, scale=0.125))


def _is_middle(steepness: Image, gradient: tuple[Image, Image]) -> Bool[np.ndarray, "h w"]:
    """Where it is steepest within two pixels, along the row or the column, whichever crosses the edge more."""
    more_along_rows = np.abs(gradient[0]) >= np.abs(gradient[1])
    in_row = more_along_rows & (steepness >= cv2.dilate(steepness, np.ones((1, 5), np.uint8)))
    in_column = ~more_along_rows & (steepness >= cv2.dilate(steepness, np.ones((5, 1), np.uint8)))
    return (in_row | in_column) & (steepness > LEAST_STEEPNESS)


STEP = 10
"""Grey levels from a pixel to its neighbour."""
LEAST_STEPS = 500


def combed(grey: UInt8[np.ndarray, "h w"]) -> tuple[float, float]:
    """Shares of the strong steps along the columns, and along the rows, that are teeth: up, down and up again.

    NaN where there are too few of them to tell.
    """
    level = grey.astype(np.int16)
    return _teeth(level), _teeth(np.ascontiguousarray(level.T))


def _teeth(level: np.ndarray) -> float:
    step = level[1:] - level[:-1]
    strong = np.abs(step) > STEP
    three = strong[:-2] & strong[1:-1] & strong[2:]
    teeth = three & ((step[:-2] ^ step[1:-1]) < 0) & ((step[1:-1] ^ step[2:]) < 0)
    steps = np.count_nonzero(strong)
    return np.count_nonzero(teeth) / steps if steps >= LEAST_STEPS else np.nan


EVERY_PX = 8
"""Pixels are taken from every so many rows and columns: some thousands tell as much as all, in a tenth of a ms."""
BURNT_LEVEL, NEARLY_LEVEL = 250, 215
"""From these grey levels on a pixel tells nothing any more, and nearly so."""


@dataclass(frozen=True)
class Exposure:
    """How bright an image is.

    Fields:
        median, bright: grey levels that half of the pixels, and 2 % of them, are above.
        burnt: share of the pixels that are as bright as can be.
        spread: grey levels from the darkest to the brightest pixel.
        nearly: share of the others that come close to it.
        one_value: share of the pixels that have exactly the most frequent colour.
    """

    median: float
    bright: float
    spread: float
    burnt: float
    nearly: float
    one_value: float


def exposure(image: UInt8[np.ndarray, "h w *c"]) -> Exposure:
    """How bright an image is, by its grey levels."""
    some = np.ascontiguousarray(image[EVERY_PX // 2 :: EVERY_PX, EVERY_PX // 2 :: EVERY_PX])
    if some.size == 0:
        some = np.ascontiguousarray(image)
    level = cv2.cvtColor(some, cv2.COLOR_BGR2GRAY) if some.ndim == 3 else some
    count = np.bincount(level.ravel(), minlength=256)
    of_all = count.cumsum() / level.size
    burnt = count[BURNT_LEVEL:].sum() / level.size
    nearly = count[NEARLY_LEVEL:BURNT_LEVEL].sum() / max(level.size - count[BURNT_LEVEL:].sum(), 1)
    return Exposure(
        median=float(np.searchsorted(of_all, 0.5)),
        bright=float(np.searchsorted(of_all, 0.98)),
        spread=float(np.ptp(level)),
        burnt=float(burnt),
        nearly=float(nearly),
        one_value=float(count.max() / level.size),
    )


EXPOSURE, SHARPNESS, INTERLACING = "exposure", "sharpness", "interlacing"
DARK_LEVEL = 60.0
"""Grey level: where 98 % of an image are below, little of it is told from noise."""
ONE_COLOUR = 24.0
"""Grey levels that noise alone spreads over."""
BURNT_SHARE = 0.15
CUT_OUT_SHARE, HALO_SHARE = 0.6, 0.005
"""So much of one colour, and nothing nearly as bright beside it, was painted by a program."""
APART = 0.35
"""Between the eyes' grey levels, of the brighter one's."""
SOFT_SHARE = 0.0011
"""Of the width: softness of the sharpest edges of an image that is out of focus."""
SMEARED_SHARES = np.array((0.00135, 0.0018, 0.00135, 0.0018))
"""The same of what is smeared, by direction. Threads on soft print stay below 0.00134 along the sides of an image and
below 0.0017 aslant, of 443 pairs."""
SMEARED_RATIO = 1.6
"""Between the softness along a smear and across it."""
WAYS = ("left to right", "down to the right", "up and down", "down to the left")
LEAST_WIDTH_PX = 800
"""Smaller images are as soft as larger ones, in pixels."""
TEETH, MORE_THAN_ALONG_ROWS = 0.09, 2.5
"""Of the steps along the columns, and as a multiple of those along the rows."""


def about_exposure(left_image: UInt8[np.ndarray, "h w *c"], right_image: UInt8[np.ndarray, "h w *c"]) -> Answer:
    """Whether both images are bright enough, not too bright, and alike."""
    left, right = exposure(left_image), exposure(right_image)
    for eye, seen in (("left", left), ("right", right)):
        if answer := _one_exposure(eye, seen):
            return answer
    if max(left.one_value, right.one_value) > CUT_OUT_SHARE:
        return untold(EXPOSURE, f"{max(left.one_value, right.one_value):.0%} of an image is of one plain colour")
    brighter, darker = max(left.median, right.median), min(left.median, right.median)
    if brighter > DARK_LEVEL / 2 and darker < (1 - APART) * brighter:
        which = "left" if left.median < right.median else "right"
        finding = (
            f"the {which} image is darker than the other: half of it is below {darker:.0f} of 255, not {brighter:.0f}"
        )
        remedy = "clean that eye's window and its light, and set gain and exposure of both eyes alike"
        return wrong(EXPOSURE, "exposures_differ", Severity.WARNING, finding, remedy)
    return well(EXPOSURE, f"the images' median grey levels are {left.median:.0f} and {right.median:.0f} of 255")


def _one_exposure(eye: str, seen: Exposure) -> Answer | None:
    if seen.spread < ONE_COLOUR:
        finding = f"the {eye} image shows nothing: it is of one colour, grey level {seen.median:.0f}"
        remedy = "check that this eye's cable and input have a signal, and that its light is on"
        return wrong(EXPOSURE, "no_picture", Severity.FAULT, finding, remedy)
    if seen.bright < DARK_LEVEL:
        finding = f"the {eye} image is too dark: 98 % of it are below {seen.bright:.0f} of 255"
        remedy = "turn the light up, or raise exposure or gain of the camera"
        return wrong(EXPOSURE, "too_dark", Severity.WARNING, finding, remedy)
    cut_out = seen.one_value > CUT_OUT_SHARE and seen.nearly * (1 - seen.burnt) < HALO_SHARE
    if seen.burnt > BURNT_SHARE and not cut_out:
        finding = f"the {eye} image is too bright: {seen.burnt:.0%} of it is white and tells nothing"
        remedy = "turn the light down, or lower exposure or gain of the camera"
        return wrong(EXPOSURE, "too_bright", Severity.WARNING, finding, remedy)
    return None


def about_sharpness(left: UInt8[np.ndarray, "h w"], right: UInt8[np.ndarray, "h w"]) -> Answer:
    """Whether both grey images have edges that are sharp, in every direction.

    A lens may be out of focus in one eye alone; a motion smears both alike. Where edges are soft one way in one eye, or
    slightly so, it may be the ground: soft ink, say, and no thread that runs across it.
    """
    width = max(left.shape[1], LEAST_WIDTH_PX)
    softness = np.array([softness_px(left), softness_px(right)], np.float64)
    for eye, soft in zip(("left", "right"), softness, strict=True):
        if soft.min() > SOFT_SHARE * width:
            finding = f"the {eye} image is out of focus: its sharpest edges are {soft.min():.1f} px soft"
            remedy = "focus, and clean the window of the endoscope"
            return wrong(SHARPNESS, "blurred", Severity.WARNING, finding, remedy)
    if np.isnan(softness).any():
        return untold(SHARPNESS, "there are too few edges in one direction or another")
    across = np.roll(softness, len(DIRECTIONS_DEG) // 2, axis=1)
    is_smeared = ((softness > SMEARED_SHARES * width) & (softness > SMEARED_RATIO * across)).all(axis=0)
    if is_smeared.any():
        way = int(np.argmax(np.where(is_smeared, softness.min(axis=0), 0.0)))
        soft, sharp = softness[:, way].min(), across[:, way].max()
        finding = f"both images are smeared {WAYS[way]}: edges are {soft:.1f} px soft there, and {sharp:.1f} px across"
        remedy = "move more slowly, or expose for a shorter time"
        return wrong(SHARPNESS, "smeared", Severity.WARNING, finding, remedy)
    if softness.max() > SOFT_SHARE * width:
        way = WAYS[int(np.argmax(softness.max(axis=0)))]
        return untold(SHARPNESS, f"edges are {softness.max():.1f} px soft {way}, as a slight smear or soft things are")
    return well(SHARPNESS, f"edges are sharp, to {softness.max():.1f} px")


def about_interlacing(left: UInt8[np.ndarray, "h w"], right: UInt8[np.ndarray, "h w"]) -> Answer:
    """Whether a grey image is woven from two fields; while nothing moves, that cannot be seen."""
    smooth: list[str] = []
    for eye, image in (("left", left), ("right", right)):
        in_columns, in_rows = combed(image)
        if np.isnan(in_columns):
            smooth.append(eye)
        elif in_columns > TEETH and in_columns > MORE_THAN_ALONG_ROWS * np.nan_to_num(in_rows):
            finding = f"the {eye} image is interlaced: every other row is of another moment"
            remedy = "set the video output to progressive (p), or have the frame grabber deinterlace"
            return wrong(INTERLACING, "interlaced", Severity.WARNING, finding, remedy)
    if smooth:
        return untold(INTERLACING, f"there are too few edges in the {' and the '.join(smooth)} image")
    return well(INTERLACING, "no combs; those of an interlaced image show only while something moves")
