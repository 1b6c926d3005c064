"""What a pair as the camera gave it tells, with its calibration: all of `judging`, its size, and its order."""

from collections.abc import Callable

import numpy as np
from jaxtyping import UInt8

from agents.perception.judging.alignment import about_alignment
from agents.perception.judging.answers import Answer, well, wrong
from agents.perception.judging.correspondence import correspondence_of_texture
from agents.perception.judging.pair import ALIGNMENT, about_pair
from agents.perception.observe import LARGEST_SEGMENTED_SHARE
from agents.perception.segmentation.choice import SEGMENTERS, suitable_segmenter
from schemas.messages import Severity, StereoCalibration
from shared.calibration.reader import eyes_in_one
from shared.rectification import Rectification, RectificationError, rectification, rectify_image

SIZE, CALIBRATION, ORDER = "size", "calibration", "order of the images"
SAME_SHAPE = 0.01
"""Of width to height: within that, images of another size were scaled, and not cropped."""

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]


def _mirrored(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image[:, ::-1])


def _turned(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image[::-1, ::-1])


TRIALS: tuple[tuple[str, str, str, Callable[[Pair], Pair]], ...] = (
    ("left_right_swapped", "left and right are exchanged", "exchange --left and --right", lambda p: (p[1], p[0])),
    ("mirrored", "both images are mirrored", "turn off mirroring", lambda p: (_mirrored(p[0]), _mirrored(p[1]))),
    ("rotated", "both images are upside down", "turn both by 180 degrees", lambda p: (_turned(p[0]), _turned(p[1]))),
)
"""What could have been done to a pair whose eyes do not fit each other: tried the other way round, they fit."""


def answers_about(images: Pair, calibration: StereoCalibration) -> list[Answer]:
    """Every question about a pair as the camera gave it, with what the images say to it."""
    size = about_size(images[0].shape[1], images[0].shape[0], calibration)
    if size.wrong is not None:
        return [size]
    try:
        to_rectified = rectification(calibration)
    except RectificationError as error:
        remedy = "use the calibration of this camera, or calibrate again"
        return [size, wrong(CALIBRATION, "not_rectifiable", Severity.FAULT, str(error), remedy)]
    left, right = _rectified(images, to_rectified)
    segment = SEGMENTERS[suitable_segmenter(left)]
    thread = segment(left) > 0, segment(right) > 0
    if max(float(mask.mean()) for mask in thread) > LARGEST_SEGMENTED_SHARE:
        thread = None
    answers = about_pair((left, right), to_rectified.camera, images, thread)
    order = _order(images, to_rectified, answers)
    # what follows from the wrong order would only hide it
    return [size, *order, *(answer for answer in answers if not (order and answer.question in ALIGNMENT))]


def about_size(width: int, height: int, calibration: StereoCalibration) -> Answer:
    """Whether images have the size that the calibration is for."""
    wanted = calibration.image_width, calibration.image_height
    if (width, height) == wanted:
        return well(
            SIZE, f"{width}x{height}, as the calibration is for; a crop that was scaled back does not show here"
        )
    finding = f"the images are {width}x{height} and the calibration is for {wanted[0]}x{wanted[1]}"
    if (two_in_one := eyes_in_one(width, height, wanted)) is not None:
        what, remedy = two_in_one
        return wrong(SIZE, "size", Severity.FAULT, f"{finding}: {what}", remedy)
    if abs(width / height / (wanted[0] / wanted[1]) - 1) < SAME_SHAPE:
        finding += f": scaled to {width / wanted[0]:.0%}, or cropped on all sides"
        remedy = "have the camera or the frame grabber give the full size, or calibrate at this one"
    elif width <= wanted[0] and height <= wanted[1]:
        finding += ": cropped"
        remedy = "turn cropping off, or calibrate with the cropped images"
    else:
        remedy = "use the calibration of this camera, or calibrate again"
    return wrong(SIZE, "size", Severity.FAULT, finding, remedy)


def _order(images: Pair, to_rectified: Rectification, answers: list[Answer]) -> list[Answer]:
    """What makes a pair fit that does not: lenses and principal points of both eyes differ, and tell them apart."""
    codes = {answer.wrong.code for answer in answers if answer.wrong is not None}
    amiss = codes & {
        "row_residual",
        "rotated",
        "sizes_differ",
        "disparity_sign",
        "disparity_range",
        "distance_implausible",
    }
    if not amiss or codes & {"left_right_swapped", "mirrored", "no_disparity"}:
        return []
    for code, finding, remedy, undone in TRIALS:
        left, right = _rectified(undone(images), to_rectified)
        seen = correspondence_of_texture(left, right)
        if seen is None:
            continue
        tried = about_alignment(seen, left.shape, to_rectified.camera)
        if all(answer.is_known and answer.wrong is None for answer in tried):
            return [wrong(ORDER, code, Severity.FAULT, f"{finding}: the other way round they fit each other", remedy)]
    return []


def _rectified(images: Pair, to_rectified: Rectification) -> Pair:
    return rectify_image(images[0], to_rectified.map_left), rectify_image(images[1], to_rectified.map_right)
