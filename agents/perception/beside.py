"""What is due in a frame beside following its thread, begun as the frame comes, in a thread of its own.

It takes about as long as following does and hardly touches Python's lock, so that it is done on another core meanwhile:
the pair is judged, or parts of the images are segmented. What is due follows from the last observations alone, and
nothing of it needs the thread of this frame until that is followed; `watched` puts both together.
"""

from concurrent.futures import Future
from dataclasses import dataclass

from agents.perception.glances.glance import part_score
from agents.perception.glances.parts import Part, parts_due
from agents.perception.judging.whole import Whole, judge_whole
from agents.perception.rectified_pair import RectifiedPair
from agents.perception.search import FRAMES_BETWEEN_LOOKS, Pair, judged_in
from agents.perception.segmentation.choice import suitable_segmenter
from agents.perception.segmentation.classes import ThreadScore
from agents.perception.segmenter_names import NETWORK
from schemas.messages import RightEye, ThreadObservations
from shared.aside import begun
from shared.right_eye import right_eye_of


@dataclass(frozen=True)
class Beside:
    """What is worked on, at most one of both in a frame.

    Fields:
        whole: the pair judged anew; None as its result where another segmenter is to look at the whole.
        parts, scores: of the images, and what the network makes of each.
    """

    whole: Future[Whole | None] | None = None
    parts: tuple[Part, ...] = ()
    scores: Future[list[ThreadScore]] | None = None


def begun_beside(sequence: int, pair: RectifiedPair, last: ThreadObservations, segmenter: str | None) -> Beside:
    """Whatever is due, begun, where glances tell what a look at the whole would.

    Args:
        sequence: of the frame.
        pair: rectified, its right eye not yet in line.
        last: the observations before it.
        segmenter: as configured; None where it is chosen.
    """
    # not in two frames in turn, however few of the camera's are seen
    if sequence - judged_in(last) >= FRAMES_BETWEEN_LOOKS and judged_in(last) != last.stamp.sequence:
        return Beside(whole=begun(_judged, pair, right_eye_of(last), segmenter))
    parts = tuple(parts_due(sequence, last))
    if not parts:
        return Beside()
    return Beside(parts=parts, scores=begun(_scores, pair.in_line(right_eye_of(last)).images, parts))


def _judged(pair: RectifiedPair, right_eye: RightEye | None, segmenter: str | None) -> Whole | None:
    if segmenter is None and suitable_segmenter(pair.images[0]) != NETWORK:
        return None
    return judge_whole(pair.images, pair.raw, pair.camera, right_eye)


def _scores(images: Pair, parts: tuple[Part, ...]) -> list[ThreadScore]:
    return [part_score(images[part.eye], part) for part in parts]
