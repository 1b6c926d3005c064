"""What is done beside a thread that is followed, so that the whole need seldom be looked at at once.

A look at the whole takes as long as some six followed frames, all of which it holds up. So what it finds is found a
part at a time: parts of the images are glanced at in turn (`glances`), and the pair is judged anew in a frame of its
own. Where that shows anything that following does not know, the whole is looked at in the same frame, but no more often
than where thread is not followed; and every 20 seconds in any case.
"""

from dataclasses import replace

from agents.perception.concurrent import Beside
from agents.perception.glances.glance import glance
from agents.perception.judging.alignment import judge
from agents.perception.judging.correspondence import correspondence_of
from agents.perception.judging.whole import Whole
from agents.perception.search import Pair, near_is_enough
from agents.perception.segmenter_names import NETWORK
from schemas.messages import Judgement, Severity, ThreadObservations
from shared.right_eye import right_eye_of

FRAMES_BETWEEN_LOOKS_WATCHED = 600
"""Of the camera: about 20 seconds, after which the whole is looked at though glances have shown nothing."""


def may_be_watched(segmenter: str | None, last: ThreadObservations) -> bool:
    """Whether glances tell what a look at the whole would: where the network looks, and any thread is meant.

    Args:
        segmenter: as configured; None where it is chosen.
    """
    return segmenter in (None, NETWORK) and last.prompt_px is None


def watched(
    observed: ThreadObservations, coverage: Pair, last: ThreadObservations, beside: Beside
) -> ThreadObservations | None:
    """The observations of a followed thread after what else was due in the frame; None to have the whole looked at.

    Args:
        observed: with candidates and occluders.
        coverage: by the followed thread.
        beside: what was begun with the frame.
    """
    if beside.whole is not None:
        return _judged(observed, beside.whole.result(), coverage)
    if beside.part is None or beside.score is None:
        return observed
    sequence = observed.stamp.sequence
    strange = glance(beside.score.result(), observed, coverage[beside.part.eye], beside.part)
    if strange and not near_is_enough(last, sequence):
        return None
    # what is strange too early is glanced at again until it is time, or until it is not strange any more
    glances = observed.glances if strange else observed.glances + 1
    return replace(observed, glanced_sequence=sequence, glances=glances)


def _judged(observed: ThreadObservations, whole: Whole | None, coverage: Pair) -> ThreadObservations | None:
    """The observations with the pair judged anew; None where its right eye lies otherwise, or it is of no use."""
    if whole is None or whole.right_eye != right_eye_of(observed):
        return None
    alignment = _by_thread(whole.images, coverage) if whole.alignment is None else whole.alignment
    judgements = (*whole.offset, *alignment, *whole.pictures)
    if any(judgement.severity is Severity.FAULT for judgement in judgements):
        return None
    shown = observed.disparities_px if whole.disparities_px is None else whole.disparities_px
    sequence = observed.stamp.sequence
    return replace(observed, judgements=judgements, judged_sequence=sequence, disparities_px=shown)


def _by_thread(images: Pair, coverage: Pair) -> tuple[Judgement, ...]:
    """How the images lie to each other, where the ground alone does not tell."""
    return judge(correspondence_of(*images, coverage[0] > 0, coverage[1] > 0), images[0].shape)
