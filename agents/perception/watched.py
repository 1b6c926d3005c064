"""What is done beside a thread that is followed, so that the whole need seldom be looked at at once.

A look at the whole takes as long as some six followed frames, all of which it holds up. So what it finds is found a
part at a time: parts of the images are glanced at in turn (`glances`), and the pair is judged anew in a frame of its
own. Where that shows anything that following does not know, the whole is looked at in the same frame, but no more often
than where thread is not followed; and every 20 seconds in any case.
"""

from dataclasses import replace

from agents.perception.glances.glance import glance
from agents.perception.glances.parts import parts_due
from agents.perception.judge import correspondence_of_masks, correspondence_of_texture, judge
from agents.perception.judging.whole import judge_whole
from agents.perception.rectified_pair import RectifiedPair
from agents.perception.search import FRAMES_BETWEEN_LOOKS, Pair, judged_in, near_is_enough
from agents.perception.segmentation.choice import suitable_segmenter
from agents.perception.segmenter_names import NETWORK
from schemas.messages import Judgement, Severity, ThreadObservations

FRAMES_BETWEEN_LOOKS_WATCHED = 600
"""Of the camera: about 20 seconds, after which the whole is looked at though glances have shown nothing."""


def may_be_watched(segmenter: str | None, last: ThreadObservations) -> bool:
    """Whether glances tell what a look at the whole would: where the network looks, and any thread is meant.

    Args:
        segmenter: as configured; None where it is chosen.
    """
    return segmenter in (None, NETWORK) and last.prompt_px is None


def watched(
    observed: ThreadObservations,
    pair: RectifiedPair,
    coverage: Pair,
    last: ThreadObservations,
    segmenter: str | None,
    is_busy: bool,
) -> ThreadObservations | None:
    """The observations of a followed thread after what else is due in the frame; None to have the whole looked at.

    Args:
        observed: with candidates and occluders.
        pair: rectified, its rows not yet moved.
        coverage: by the followed thread.
        segmenter: as configured; None where it is chosen.
        is_busy: whether the frame has other work besides, so that this waits for the next one.
    """
    sequence = observed.stamp.sequence
    if is_busy:
        return observed
    # not in two frames in turn, however few of the camera's are seen
    if sequence - judged_in(last) >= FRAMES_BETWEEN_LOOKS and judged_in(last) != last.stamp.sequence:
        if segmenter is None and suitable_segmenter(pair.images[0]) != NETWORK:
            return None
        return _judged(observed, pair, coverage)
    parts = parts_due(sequence, last)
    if not parts:
        return observed
    images = pair.moved_up(observed.rows_moved_up).images
    strange = any(glance(images[part.eye], observed, coverage[part.eye], part) for part in parts)
    if strange and not near_is_enough(last, sequence):
        return None
    # what is strange too early is glanced at again until it is time, or until it is not strange any more
    glances = observed.glances if strange else observed.glances + len(parts)
    return replace(observed, glanced_sequence=sequence, glances=glances)


def _judged(observed: ThreadObservations, pair: RectifiedPair, coverage: Pair) -> ThreadObservations | None:
    """The observations with the pair judged anew; None where its rows are to be moved otherwise, or it is of no use."""
    whole = judge_whole(pair.images, pair.raw, observed.rows_moved_up, pair.camera)
    if whole.rows_moved_up != observed.rows_moved_up:
        return None
    alignment = _by_thread(whole.images, coverage) if whole.alignment is None else whole.alignment
    judgements = (*whole.offset, *alignment, *whole.pictures)
    if any(judgement.severity is Severity.FAULT for judgement in judgements):
        return None
    return replace(observed, judgements=judgements, judged_sequence=observed.stamp.sequence)


def _by_thread(images: Pair, coverage: Pair) -> tuple[Judgement, ...]:
    """How the images lie to each other, where the ground alone does not tell."""
    thread = coverage[0] > 0, coverage[1] > 0
    return judge(correspondence_of_texture(*images, *thread) or correspondence_of_masks(*thread), images[0].shape)
