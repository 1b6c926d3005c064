"""What is due in a frame beside following its thread, begun as the frame comes, in a thread of its own.

Each takes as long as following does and hardly touches Python's lock, so that it is done on another core meanwhile:
the tissue is matched, the pair is judged, or parts of the images are segmented. What is due follows from the last
observations alone, and nothing here needs the thread of this frame; `watched` and the surface put both together.
"""

from concurrent.futures import Future
from dataclasses import dataclass

from agents.perception.glances.glance import Score, part_score
from agents.perception.glances.parts import Part, parts_due
from agents.perception.judging.whole import Whole, judge_whole
from agents.perception.occluders import instruments_in
from agents.perception.rectified_pair import RectifiedPair
from agents.perception.search import FRAMES_BETWEEN_LOOKS, Pair, judged_in
from agents.perception.segmentation.choice import suitable_segmenter
from agents.perception.segmenter_names import NETWORK
from agents.perception.surface import Disparity, surface_of_disparity, tissue_disparity
from schemas.messages import FrameStamp, ThreadObservations, TissueSurface
from shared.aside import begun
from shared.images import decode_image


@dataclass(frozen=True)
class Beside:
    """What is worked on, at most one of the three in a frame.

    Fields:
        rows_moved_up: by which the rows were put in line for it.
        disparity: of the tissue.
        whole: the pair judged anew; None as its result where another segmenter is to look at the whole.
        parts, scores: of the images, and what the network makes of each.
    """

    rows_moved_up: int = 0
    disparity: Future[Disparity] | None = None
    whole: Future[Whole | None] | None = None
    parts: tuple[Part, ...] = ()
    scores: Future[list[Score]] | None = None


def tissue_beside(pair: RectifiedPair, rows_moved_up: int) -> Beside:
    """The tissue's disparity, begun with the rows in line as they were before.

    Args:
        pair: rectified, its rows not yet moved.
    """
    return Beside(rows_moved_up, disparity=begun(tissue_disparity, *pair.moved_up(rows_moved_up).images))


def tissue(stamp: FrameStamp, pair: RectifiedPair, observed: ThreadObservations, beside: Beside) -> TissueSurface:
    """The surface of the tissue beside the thread and the instruments of the frame.

    Args:
        pair: rectified, its rows not yet moved.
        beside: where the disparity was begun, unless the rows have been moved otherwise since.
    """
    thread = decode_image(observed.mask_left) > 0
    if observed.occluders is not None:
        thread |= instruments_in(decode_image(observed.occluders.left), thread.shape)
    rows = observed.rows_moved_up
    if beside.disparity is not None and beside.rows_moved_up == rows:
        disparity = beside.disparity.result()
    else:
        disparity = tissue_disparity(*pair.moved_up(rows).images)
    return surface_of_disparity(stamp, pair.camera, disparity, thread)


def watched_beside(sequence: int, pair: RectifiedPair, last: ThreadObservations, segmenter: str | None) -> Beside:
    """Whatever is due, begun, where glances tell what a look at the whole would.

    Args:
        sequence: of the frame.
        pair: rectified, its rows not yet moved.
        last: the observations before it.
        segmenter: as configured; None where it is chosen.
    """
    rows = last.rows_moved_up
    # not in two frames in turn, however few of the camera's are seen
    if sequence - judged_in(last) >= FRAMES_BETWEEN_LOOKS and judged_in(last) != last.stamp.sequence:
        return Beside(rows, whole=begun(_judged, pair, rows, segmenter))
    parts = tuple(parts_due(sequence, last))
    if not parts:
        return Beside()
    return Beside(rows, parts=parts, scores=begun(_scores, pair.moved_up(rows).images, parts))


def _judged(pair: RectifiedPair, rows_moved_up: int, segmenter: str | None) -> Whole | None:
    if segmenter is None and suitable_segmenter(pair.images[0]) != NETWORK:
        return None
    return judge_whole(pair.images, pair.raw, rows_moved_up, pair.camera)


def _scores(images: Pair, parts: tuple[Part, ...]) -> list[Score]:
    return [part_score(images[part.eye], part) for part in parts]
