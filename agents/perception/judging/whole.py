"""What is judged whenever the whole of both images is looked at, about every two seconds.

Interlacing is told by the middle of the images, where the thread is.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import UInt8

from agents.perception.judge import judge
from agents.perception.judging.answers import judgements
from agents.perception.judging.correspondence import texture_of
from agents.perception.judging.features import grey
from agents.perception.judging.picture import about_interlacing, about_sharpness
from agents.perception.judging.rows import is_certain, moved_up, row_offset, rows_to_move
from schemas.messages import Judgement, RectifiedStereo

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]


@dataclass(frozen=True)
class Whole:
    """Judgements of a pair.

    Fields:
        images: the rectified pair, its rows in line where that could be done for certain.
        rows_moved_up: by how many rows its right image was moved for that.
        offset: what is said about that.
        alignment: what else is wrong with how the images lie; None where only the thread can tell.
        pictures: what is wrong with each image by itself.
    """

    images: Pair
    rows_moved_up: int
    offset: tuple[Judgement, ...]
    alignment: tuple[Judgement, ...] | None
    pictures: tuple[Judgement, ...]


def judge_whole(rectified: Pair, raw: Pair, rows_before: int = 0, camera: RectifiedStereo | None = None) -> Whole:
    """Judge a pair before anything is looked for in it, and put its rows in line.

    Args:
        raw: the pair as the camera gave it, by which interlacing is told.
        rows_before: by how many rows its right image was moved up at the last look.
        camera: of the rectified pair, by which distances are told; None leaves them out.
    """
    left, right = grey(rectified[0]), grey(rectified[1])
    shape = left.shape
    sharpness = about_sharpness(left, right)
    pictures = judgements([sharpness, about_interlacing(_middle(grey(raw[0])), _middle(grey(raw[1])))])
    seen = texture_of(left, right).seen
    if seen is None or not is_certain(seen, shape[1]):
        return Whole((rectified[0], moved_up(rectified[1], rows_before)), rows_before, (), None, pictures)
    rows = rows_to_move(seen, shape, rows_before)
    offset = row_offset(seen, rows)
    if rows and seen.row_residual_px is not None:
        seen = replace(seen, row_residual_px=seen.row_residual_px + rows, off_rows_px=None)
    return Whole((rectified[0], moved_up(rectified[1], rows)), rows, offset, judge(seen, shape, camera), pictures)


def _middle(image: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "r c"]:
    height, width = image.shape
    return np.ascontiguousarray(image[height // 4 : height - height // 4, width // 4 : width - width // 4])
