"""What of a pair's centrelines is the thread that is meant, what is other threads, and what may hide either.

All of it is found at looks at the whole. In the frames between, the candidates are followed, those that are left out of
the centrelines stay where they were, and what may hide thread is looked for anew every few frames, since instruments
move by themselves.
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import UInt8

from agents.perception.candidates import candidates_followed, candidates_in, length_in_common_px
from agents.perception.following.follow import every_second
from agents.perception.following.stacked import trail_without
from agents.perception.occluders import map_image, occluders_in
from agents.perception.segmenter_names import NETWORK, THRESHOLD
from schemas.messages import Centrelines, Image, ImageEncoding, Occluders, Status, StrandLines, ThreadObservations
from shared.disparities import disparities_of
from shared.images import decode_image
from shared.in_parallel import of_both

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]

LEAST_IN_COMMON_PX = 24.0
"""Of thread: less of it in both images is none."""
IN_ONE_EYE = (
    "what looks like thread is in one image alone, and no row of the other one has its counterpart; if it is thread, "
    "turn the camera until both eyes see it"
)
SCORE_WIDTH_PX = 240
"""Of the copy of a segmenter's score that travels."""
SCORE_QUALITY = 80


def told_apart(
    observed: ThreadObservations,
    images: Pair,
    last: ThreadObservations | None,
    score: UInt8[np.ndarray, "h w"] | None = None,
    occluders_due: bool = False,
) -> ThreadObservations:
    """The observations with candidates and occluders, their centrelines without threads that are certainly not meant.

    Args:
        observed: without occluders, or with those of the frame before.
        images: rectified, as the centrelines are.
        last: the observations before, None where there are none.
        score: of the left image by the segmenter, where it gives one and the whole was looked at.
        occluders_due: whether they are looked for anew though the whole was not looked at.
    """
    if observed.status is not Status.OK:
        return observed
    whole = observed.looked_sequence == observed.stamp.sequence
    lines = observed.centrelines_left, observed.centrelines_right
    reach = disparities_of(observed)
    # who points at a thread, or draws it, says what is thread
    is_asked = whole and observed.segmenter == NETWORK and observed.prompt_px is None
    if is_asked and length_in_common_px(lines, reach) < LEAST_IN_COMMON_PX:
        return _none(observed, IN_ONE_EYE, score)
    before = () if last is None else last.candidates
    occluders = _occluders(observed, images, whole or occluders_due, last)
    # one thread alone is told from no other by what may hide it
    may_hide = occluders is not None and (whole or len(before) > 1)
    of_left = decode_image(occluders.left) if occluders is not None and may_hide else None
    if whole:
        meant_px = before[0].left_px if before else None
        if observed.prompt_px is not None:
            meant_px = observed.prompt_px[None]
        found = candidates_in(images, lines, meant_px, score, of_left, reach)
    else:
        found = candidates_followed(before, lines, of_left, observed.camera.image_width)
    return replace(
        _with_lines(observed, (found.left, found.right)),
        strands=tuple(filter(None, (_strand(observed, lines) for lines in found.strands))),
        candidates=found.listed,
        occluders=occluders,
        score_map=None if score is None else _small(score),
    )


def as_sent(observed: ThreadObservations) -> ThreadObservations:
    """The observations with every second point of their centrelines, and of those of their strands."""
    strands = tuple(
        replace(
            strand,
            centrelines_left=every_second(strand.centrelines_left),
            centrelines_right=every_second(strand.centrelines_right),
        )
        for strand in observed.strands
    )
    left, right = every_second(observed.centrelines_left), every_second(observed.centrelines_right)
    return replace(observed, centrelines_left=left, centrelines_right=right, strands=strands)


def _strand(observed: ThreadObservations, lines: tuple[Centrelines, Centrelines]) -> StrandLines | None:
    """Some of the observed lines, with what the next frame follows them by; None where nothing is."""
    left = trail_without(observed.trail_left, observed.centrelines_left, lines[0])
    right = trail_without(observed.trail_right, observed.centrelines_right, lines[1])
    return None if left is None or right is None else StrandLines(*lines, left, right)


def _with_lines(observed: ThreadObservations, lines: tuple[Centrelines, Centrelines]) -> ThreadObservations:
    """The observations with fewer lines, and with what else is known of those that are left."""
    left, right = lines
    return replace(
        observed,
        trail_left=trail_without(observed.trail_left, observed.centrelines_left, left),
        trail_right=trail_without(observed.trail_right, observed.centrelines_right, right),
        centrelines_left=left,
        centrelines_right=right,
    )


def _none(observed: ThreadObservations, reason: str, score: UInt8[np.ndarray, "h w"] | None) -> ThreadObservations:
    """The observations of a pair that shows no thread, with the lines that look like it."""
    score_map = None if score is None else _small(score)
    return replace(observed, status=Status.FAILED, reason=reason, score_map=score_map)


def _occluders(
    observed: ThreadObservations, images: Pair, anew: bool, last: ThreadObservations | None
) -> Occluders | None:
    """Those of the last frames, or new ones; None on a ground of one colour, where nothing is to be learned."""
    if not anew:
        return None if last is None else last.occluders
    if observed.segmenter == THRESHOLD:
        return None
    left, right = of_both(occluders_in, images[:1], images[1:])
    return Occluders(map_image(left), map_image(right), observed.stamp.sequence)


def _small(score: UInt8[np.ndarray, "h w"]) -> Image:
    """A small copy, in which a thin thread keeps its score: of each of its pixels the largest counts."""
    height = max(1, round(score.shape[0] * SCORE_WIDTH_PX / score.shape[1]))
    side = max(1, round(score.shape[1] / SCORE_WIDTH_PX))
    largest = cv2.dilate(score, np.ones((side, side), np.uint8))
    small = cv2.resize(largest, (SCORE_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, SCORE_QUALITY])[1].tobytes()
    return Image(ImageEncoding.JPEG, SCORE_WIDTH_PX, height, 1, data)
