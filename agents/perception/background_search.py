"""What is done beside a thread that is followed, so that the whole need seldom be looked at at once.

A look at the whole takes as long as some six followed frames, all of which it holds up. So what it finds is found a
part at a time: parts of the images are glanced at in turn (`glance`), and the pair is judged anew in a frame of its
own. Where that shows anything that following does not know, the whole is looked at in the same frame, but no more often
than where thread is not followed; and every 20 seconds in any case.

Either takes about as long as following does and hardly touches Python's lock, so that it is begun as the frame comes,
on another core: what is due (`schedule`) follows from the last observations alone.
"""

from concurrent.futures import Future
from dataclasses import dataclass, replace

from agents.perception.glance import Part, glance, next_part, part_score
from agents.perception.judging.alignment import judge
from agents.perception.judging.correspondence import correspondence_of
from agents.perception.judging.whole import Whole, judge_whole
from agents.perception.schedule import Due
from agents.perception.search import Pair, near_is_enough
from agents.perception.segmentation.choice import suitable_segmenter
from agents.perception.segmentation.classes import ThreadScore
from agents.perception.segmenter_names import NETWORK
from schemas.messages import Judgement, RightEye, Severity, ThreadObservations
from shared.background import begun
from shared.rectification import RectifiedPair
from shared.right_eye import right_eye_of

FRAMES_BETWEEN_LOOKS_WATCHED = 600
"""Of the camera: about 20 seconds, after which the whole is looked at though glances have shown nothing."""


@dataclass(frozen=True)
class Beside:
    """What is worked on, at most one of both in a frame.

    Fields:
        whole: the pair judged anew; None as its result where another segmenter is to look at the whole.
        part, score: of one image, and what the network makes of it.
    """

    whole: Future[Whole | None] | None = None
    part: Part | None = None
    score: Future[ThreadScore] | None = None


def may_be_watched(segmenter: str | None, last: ThreadObservations) -> bool:
    """Whether glances tell what a look at the whole would: where the network looks, and any thread is meant.

    Args:
        segmenter: as configured; None where it is chosen.
    """
    return segmenter in (None, NETWORK) and last.prompt_px is None


def begun_beside(what: Due | None, pair: RectifiedPair, last: ThreadObservations, segmenter: str | None) -> Beside:
    """What is due, begun.

    Args:
        pair: rectified, its right eye not yet in line.
        last: the observations before it.
        segmenter: as configured; None where it is chosen.
    """
    if what is Due.JUDGED:
        return Beside(whole=begun(_judged, pair, right_eye_of(last), segmenter))
    if what is not Due.GLANCE:
        return Beside()
    part = next_part(last)
    return Beside(part=part, score=begun(part_score, pair.in_line(right_eye_of(last)).images[part.eye], part))


def _judged(pair: RectifiedPair, right_eye: RightEye | None, segmenter: str | None) -> Whole | None:
    if segmenter is None and suitable_segmenter(pair.images[0]) != NETWORK:
        return None
    return judge_whole(pair.images, pair.raw, pair.camera, right_eye)


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
        return _with_judgements(observed, beside.whole.result(), coverage)
    if beside.part is None or beside.score is None:
        return observed
    sequence = observed.stamp.sequence
    strange = glance(beside.score.result(), observed, coverage[beside.part.eye], beside.part)
    if strange and not near_is_enough(last, sequence):
        return None
    # what is strange too early is glanced at again until it is time, or until it is not strange any more
    glances = observed.glances if strange else observed.glances + 1
    return replace(observed, glanced_sequence=sequence, glances=glances)


def _with_judgements(observed: ThreadObservations, whole: Whole | None, coverage: Pair) -> ThreadObservations | None:
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
