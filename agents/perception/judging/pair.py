"""All questions about one rectified pair."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, UInt8

from agents.perception.judging.alignment import DISTANCE, ROTATION, ROWS, SIDES, SIZES, about_alignment, about_sides
from agents.perception.judging.answers import Answer, wrong
from agents.perception.judging.correspondence import UNKNOWN, correspondence_of_masks, correspondence_of_texture
from agents.perception.judging.features import grey, matched_features
from agents.perception.judging.picture import about_exposure, about_interlacing, about_sharpness
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
    covered = thread or (None, None)
    texture = correspondence_of_texture(left, right, *covered)
    seen = texture or (correspondence_of_masks(*thread) if thread else UNKNOWN)
    alignment = about_alignment(seen, left.shape, camera)
    if texture is None and (features := matched_features(left, right, *covered).features) > MANY_FEATURES:
        finding = f"of {features} distinct places in one image, the other shows hardly any"
        remedy = "give both eyes of one frame, synchronised; turn and crop both alike; and use their calibration"
        alignment[0] = wrong(ROWS, "nothing_corresponds", Severity.WARNING, finding, remedy)
    if np.array_equal(raw_left, raw_right):
        alignment = [about_sides(replace(UNKNOWN, disparity_px=0.0))]
    return [
        *alignment,
        about_exposure(*rectified),
        about_sharpness(left, right),
        about_interlacing(raw_left, raw_right),
    ]
