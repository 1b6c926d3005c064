"""What is due in a frame beside following its thread, begun as the frame comes, in a thread of its own.

It takes about as long as following does and hardly touches Python's lock, so that it is done on another core meanwhile:
the pair is judged, or parts of the images are segmented. What is due follows from the last observations alone, and
nothing of it needs the thread of this frame until that is followed; `watched` puts both together. When it is due, and
that no more than one of it is, `due` says.
"""

from concurrent.futures import Future
from dataclasses import dataclass

from agents.perception.glances.glance import Part, next_part, part_score
from agents.perception.judging.whole import Whole, judge_whole
from agents.perception.schedule import Due
from agents.perception.segmentation.choice import suitable_segmenter
from agents.perception.segmentation.classes import ThreadScore
from agents.perception.segmenter_names import NETWORK
from schemas.messages import RightEye, ThreadObservations
from shared.background import begun
from shared.rectification import RectifiedPair
from shared.right_eye import right_eye_of


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


def begun_beside(what: Due | None, pair: RectifiedPair, last: ThreadObservations, segmenter: str | None) -> Beside:
    """What is due, begun, where glances tell what a look at the whole would.

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
