"""Where perception looks for thread: near where it was, so that it need not look everywhere in each frame.

The thread is looked for near where it was. What could make that wrong has the whole images looked at again: thread at
the border of what was looked at, less thread than there was, and every so many frames in any case. The segmenter is
chosen, and the pair judged, with each look at the whole.

All that one frame needs of those before it is in the last observations, so that these are the agent's whole state.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.perception.judging.alignment import judge
from agents.perception.judging.correspondence import correspondence_of_texture
from agents.perception.prompt import followed, meant_as_before, meant_at, meant_like
from agents.perception.schedule import judged_in
from agents.perception.segmentation.boxes import Near
from agents.perception.segmentation.choice import SCORED, SEGMENTERS, Segmenter, suitable_segmenter
from schemas.messages import Judgement, Status, ThreadObservations
from shared.images import decode_image
from shared.in_parallel import of_both

FRAMES_BETWEEN_LOOKS = 60
"""Of the camera: about two seconds, after which thread that came into view elsewhere is seen too. A look takes as long
as some six frames near the thread."""
LONGEST_GAP = 30
"""Of the camera's frames, after which thread may lie anywhere."""
LEAST_FRAMES_NEAR = 4
"""How many frames at least are looked at near the thread between two looks at the whole, also where so many of the
camera's are left out that two seconds have fewer: else whoever is slow already would do most of the work most often."""
MARGIN_SHARE = 0.04
"""Of the width: how far from where it was thread is looked for. It may move so far between two frames."""
SMALL_WIDTH_PX = 240
"""Of the image in which the margin is laid around the thread."""
LEAST_KEPT_SHARE = 0.8
"""Of the thread's pixels in the frame before; fewer mean that some of it has been lost."""
DRAWN_SHARE = 0.8
"""Of a mask that was drawn along a followed thread, as wide as its edges lie apart: segmenters cover that at least."""
BESIDE_PX = 5, 13
"""Sides of the windows that make the ring beside the thread."""
BORDER_PX = 9
"""Thread so near to the border of what was looked at may go on beyond it."""

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]


@dataclass(frozen=True)
class Looked:
    """What was segmented in a pair.

    Fields:
        coverage: by thread, left and right.
        looked_sequence: of the frame whose whole images were last looked at: this one, or one before.
        is_bright: whether the thread was brighter than what lay beside it then.
        judgements: made then, each saying when, or just now; None where the pair is to be judged from these masks.
        prompt_px: on the thread that is meant; None where any is.
        score: of the left image's pixels by the segmenter; None where it has none, or not the whole was looked at.
    """

    coverage: Pair
    segmenter: str
    looked_sequence: int
    is_bright: bool
    judgements: tuple[Judgement, ...] | None
    prompt_px: Float64[np.ndarray, "2"] | None
    score: UInt8[np.ndarray, "h w"] | None = None


def look_everywhere(
    images: Pair,
    sequence: int,
    segmenter: str | None = None,
    prompt_px: Float64[np.ndarray, "2"] | None = None,
    segmenters: Mapping[str, Segmenter] = SEGMENTERS,
) -> Looked:
    """Segment the whole of both images with a segmenter, or with the one that suits the left image."""
    left, right = images
    name = segmenter or suitable_segmenter(left)
    segment = segmenters[name]
    if prompt_px is None:
        coverage, score = _everywhere(segment, left, right)
        return Looked(coverage, name, sequence, is_brighter(left, coverage[0]), None, None, score)
    of_left = segment(left, None, meant_at(prompt_px, left.shape))
    if not of_left.any():
        return Looked((of_left, of_left), name, sequence, False, (), prompt_px)
    coverage = of_left, segment(right, None, meant_like(left, of_left, right))
    # the right mask may hold threads that the left one leaves out, so that only the ground tells how the pair lies
    ground = correspondence_of_texture(left, right, coverage[0] > 0, coverage[1] > 0)
    judgements = judge(ground, left.shape) if ground else ()
    bright = is_brighter(left, of_left)
    return Looked(coverage, name, sequence, bright, judgements, followed(prompt_px, of_left))


def _everywhere(
    segment: Segmenter, left: UInt8[np.ndarray, "h w 3"], right: UInt8[np.ndarray, "h w 3"]
) -> tuple[Pair, UInt8[np.ndarray, "h w"] | None]:
    """The coverage of both images, and the left one's score where the segmenter has one."""
    with_score = SCORED.get(segment)
    if with_score is None:
        return of_both(segment, (left,), (right,)), None
    (of_left, score), (of_right, _) = of_both(with_score, (left,), (right,))
    return (of_left, of_right), score


def look_near(
    images: Pair, last: ThreadObservations, sequence: int, segmenters: Mapping[str, Segmenter] = SEGMENTERS
) -> Looked | None:
    """Segment what lies near the last thread; None where that does not do, and all must be looked at."""
    if not near_is_enough(last, sequence):
        return None
    # observations of another agent may come from a segmenter that this one was not given
    segment = segmenters.get(last.segmenter)
    if segment is None:
        return None
    left = _look_near(images[0], decode_image(last.mask_left), last, True, segment)
    right = _look_near(images[1], decode_image(last.mask_right), last, False, segment)
    if left is None or right is None:
        return None
    coverage = left, right
    prompt_px = None if last.prompt_px is None else followed(last.prompt_px, coverage[0])
    return Looked(coverage, last.segmenter, last.looked_sequence, last.is_bright, carried_on(last), prompt_px)


def near_is_enough(
    last: ThreadObservations, sequence: int, longest: int = LONGEST_GAP, between: int = FRAMES_BETWEEN_LOOKS
) -> bool:
    """Whether the whole need not be looked at: it was not long ago, and thread was observed just before.

    Args:
        longest: how many of the camera's frames later than the last observations is too late.
        between: how many of them there are between two looks at the whole.
    """
    since_look, since_last = sequence - last.looked_sequence, sequence - last.stamp.sequence
    is_early = since_look < between or last.frames_since_look < LEAST_FRAMES_NEAR
    return last.status is Status.OK and since_last < longest and since_look > 0 and is_early


def _look_near(
    image: UInt8[np.ndarray, "h w *c"],
    before: UInt8[np.ndarray, "h w"],
    last: ThreadObservations,
    is_left: bool,
    segment: Segmenter,
) -> UInt8[np.ndarray, "h w"] | None:
    """Coverage by thread near where it was in this eye's image; None where some may be missing."""
    near = Near(near_thread(before), last.is_bright)
    meant = None if last.prompt_px is None else meant_as_before(before, alone=is_left)
    coverage = segment(image, near, meant)
    drawn = last.segmented_sequence not in (None, last.stamp.sequence)
    if may_lack_thread(coverage, near.where, round(_pixels(before) * (DRAWN_SHARE if drawn else 1.0))):
        return None
    return coverage


def carried_on(last: ThreadObservations) -> tuple[Judgement, ...]:
    """The judgements of when the pair was last judged, each saying when that was."""
    if last.stamp.sequence != judged_in(last):
        return last.judgements
    when = f" (judged in frame {last.stamp.sequence})"
    return tuple(replace(judgement, finding=judgement.finding + when) for judgement in last.judgements)


def is_brighter(image: UInt8[np.ndarray, "h w 3"], coverage: UInt8[np.ndarray, "h w"]) -> bool:
    """Whether what is covered is brighter than what lies beside it."""
    left, top, columns, rows = cv2.boundingRect(coverage)
    if columns == 0:
        return False
    margin = max(BESIDE_PX)
    box = np.s_[max(0, top - margin) : top + rows + margin, max(0, left - margin) : left + columns + margin]
    covered, grey = coverage[box], cv2.cvtColor(image[box], cv2.COLOR_BGR2GRAY)
    beside, around = (cv2.dilate(covered, np.ones((side, side), np.uint8)) for side in BESIDE_PX)
    return bool(cv2.mean(grey, covered)[0] > cv2.mean(grey, cv2.subtract(around, beside))[0])


def near_thread(coverage: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Where a thread that covered this may be in the next frame."""
    height, width = coverage.shape
    share = min(1.0, SMALL_WIDTH_PX / width)
    size = max(1, round(width * share)), max(1, round(height * share))
    small = (cv2.resize(coverage, size, interpolation=cv2.INTER_AREA) > 0).view(np.uint8)
    side = 2 * max(1, round(MARGIN_SHARE * size[0])) + 1
    wide = cv2.dilate(small, np.ones((side, side), np.uint8))
    return np.asarray(cv2.resize(wide, (width, height), interpolation=cv2.INTER_NEAREST)).view(bool)


def may_lack_thread(coverage: UInt8[np.ndarray, "h w"], near: Bool[np.ndarray, "h w"], pixels_before: int) -> bool:
    """Whether thread that was found near a place may go on elsewhere, or part of it has been lost."""
    found = _pixels(coverage)
    if found < LEAST_KEPT_SHARE * pixels_before:
        return True
    # beyond the image's own border there is nothing to look at
    inside = cv2.erode(near.view(np.uint8), np.ones((2 * BORDER_PX + 1,) * 2, np.uint8))
    return _pixels(cv2.bitwise_and(coverage, coverage, mask=inside)) < found


def _pixels(coverage: np.ndarray) -> int:
    return int(np.count_nonzero(coverage))
