"""What one eye's picture tells by itself, or beside the other's: exposure, sharpness, interlacing."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8

from agents.perception.judging.answers import Answer, untold, well, wrong
from agents.perception.judging.interlacing import combed
from agents.perception.judging.sharpness import DIRECTIONS_DEG, softness_px
from schemas.messages import Severity

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


def about_exposure(left: Exposure, right: Exposure) -> Answer:
    """Whether both images are bright enough, not too bright, and alike."""
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


def exposures(left: UInt8[np.ndarray, "h w *c"], right: UInt8[np.ndarray, "h w *c"]) -> tuple[Exposure, Exposure]:
    """Of both images."""
    return exposure(left), exposure(right)
