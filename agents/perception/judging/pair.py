"""All questions about one rectified pair."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, UInt8

from agents.perception.judging.alignment import (
    DISTANCE,
    ROTATION,
    ROWS,
    SIDES,
    SIZES,
    about_distance,
    about_rotation,
    about_rows,
    about_sides,
    about_sizes,
)
from agents.perception.judging.answers import Answer, wrong
from agents.perception.judging.correspondence import UNKNOWN, Correspondence, texture_of
from agents.perception.judging.features import grey
from agents.perception.judging.masks import correspondence_of_masks
from agents.perception.judging.picture import about_exposure, about_interlacing, about_sharpness, exposures
from schemas.messages import RectifiedStereo, Severity

MANY_FEATURES = 300
"""Of which none corresponds: the images show different things."""

ALIGNMENT = (ROWS, ROTATION, SIZES, SIDES, DISTANCE)
"""The questions that both images answer together."""

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]
Thread = tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]


def about_pair(
    rectified: Pair, camera: RectifiedStereo, raw: Pair | None = None, thread: Thread | None = None
) -> list[Answer]:
    """Every question, with what the images say to it.

    Args:
        raw: the images as the camera gave them, by which interlacing is told; the rectified ones where they are those.
        thread: where thread is, which is left out of what is compared.
    """
    left, right = (grey(image) for image in rectified)
    raw_left, raw_right = (left, right) if raw is None else (grey(raw[0]), grey(raw[1]))
    texture = texture_of(left, right, *(thread or (None, None)))
    seen = texture.seen or (correspondence_of_masks(*thread) if thread else UNKNOWN)
    alignment = about_alignment(seen, camera, 0 if texture.seen else texture.features)
    if np.array_equal(raw_left, raw_right):
        alignment = [about_sides(replace(UNKNOWN, disparity_px=0.0))]
    return [
        *alignment,
        about_exposure(*exposures(*rectified)),
        about_sharpness(left, right),
        about_interlacing(raw_left, raw_right),
    ]


def about_alignment(seen: Correspondence, camera: RectifiedStereo, features: int = 0) -> list[Answer]:
    """What follows from how the images lie to each other; `features` were found, and none of them corresponds."""
    height, width = camera.image_height, camera.image_width
    rows = about_rows(seen, height)
    if features > MANY_FEATURES:
        finding = f"of {features} distinct places in one image, the other shows hardly any"
        remedy = "give both eyes of one frame, synchronised; turn and crop both alike; and use their calibration"
        rows = wrong(ROWS, "nothing_corresponds", Severity.WARNING, finding, remedy)
    return [
        rows,
        about_rotation(seen, height, width),
        about_sizes(seen, height),
        about_sides(seen),
        about_distance(seen, camera),
    ]
