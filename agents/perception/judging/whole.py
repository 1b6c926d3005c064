"""What is judged whenever the whole of both images is looked at, about every two seconds.

Interlacing is told by the middle of the images, where the thread is.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8

from agents.perception.judging.alignment import judge
from agents.perception.judging.answers import judgements
from agents.perception.judging.correspondence import correspondence_of_texture
from agents.perception.judging.features import grey
from agents.perception.judging.picture import about_interlacing, about_sharpness
from agents.perception.judging.right_eye import is_certain, left_over, out_of_line, put_in_line
from schemas.messages import Judgement, RectifiedStereo, RightEye
from shared.disparities import shown_disparities
from shared.right_eye import in_line

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]


@dataclass(frozen=True)
class Whole:
    """Judgements of a pair.

    Fields:
        images: the rectified pair, its right eye in line where that could be done for certain.
        right_eye: by how much it was out of line.
        disparities_px: least and greatest at which thread may be; None where too little of the ground tells.
        offset: what is said about the right eye.
        alignment: what else is wrong with how the images lie; None where only the thread can tell.
        pictures: what is wrong with each image by itself.
    """

    images: Pair
    right_eye: RightEye | None
    disparities_px: Float64[np.ndarray, "2"] | None
    offset: tuple[Judgement, ...]
    alignment: tuple[Judgement, ...] | None
    pictures: tuple[Judgement, ...]


def judge_whole(rectified: Pair, raw: Pair, camera: RectifiedStereo, before: RightEye | None = None) -> Whole:
    """Judge a pair before anything is looked for in it, and put its right eye in line.

    Args:
        raw: the pair as the camera gave it, by which interlacing is told.
        camera: of the rectified pair.
        before: how its right eye lay at the last look.
    """
    left, right = grey(rectified[0]), grey(rectified[1])
    sharpness = about_sharpness(left, right)
    pictures = judgements([sharpness, about_interlacing(_middle(grey(raw[0])), _middle(grey(raw[1])))])
    seen = correspondence_of_texture(left, right)
    shown = None
    if seen is not None and seen.farthest_px and seen.nearest_px:
        shown = shown_disparities(seen.farthest_px, seen.nearest_px, camera.image_width)
    if seen is None or not is_certain(seen, left.shape[1]):
        images = rectified[0], in_line(rectified[1], before, camera)
        return Whole(images, before, shown, (), None, pictures)
    eye = out_of_line(seen, camera, before)
    images = rectified[0], in_line(rectified[1], eye, camera)
    alignment = judge(left_over(seen, eye), left.shape, camera)
    return Whole(images, eye, shown, put_in_line(eye), alignment, pictures)


def _middle(image: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "r c"]:
    height, width = image.shape
    return np.ascontiguousarray(image[height // 4 : height - height // 4, width // 4 : width - width // 4])
