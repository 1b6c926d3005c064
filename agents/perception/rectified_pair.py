"""Both images of a frame, decoded and rectified."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import UInt8

from agents.perception.rectification import Rectification, rectify_image
from schemas.messages import Image, RectifiedStereo, RightEye, StereoFrame
from shared.both_eyes import of_both
from shared.images import decode_image
from shared.right_eye import in_line

Pair = tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]


@dataclass(frozen=True)
class RectifiedPair:
    """A pair of images in colour.

    Fields:
        images: rectified.
        raw: as the camera gave them.
    """

    camera: RectifiedStereo
    images: Pair
    raw: Pair

    def in_line(self, eye: RightEye | None) -> "RectifiedPair":
        """The pair with a right eye put in line that is out of it by so much."""
        return replace(self, images=(self.images[0], in_line(self.images[1], eye, self.camera))) if eye else self


def decoded_pair(frame: StereoFrame) -> Pair:
    """Both images of a frame in colour.

    Raises:
        ImageDataError: where one cannot be decoded.
    """
    return of_both(_decoded, (frame.left,), (frame.right,))


def rectified_pair(raw: Pair, to_rectified: Rectification) -> RectifiedPair:
    """Images of the size that the rectification is for, rectified."""
    left, right = raw
    images = rectify_image(left, to_rectified.map_left), rectify_image(right, to_rectified.map_right)
    return RectifiedPair(to_rectified.camera, images, raw)


def _decoded(image: Image) -> UInt8[np.ndarray, "h w 3"]:
    return _colour(decode_image(image))


def _colour(pixels: Any) -> Any:
    return pixels if pixels.ndim == 3 else pixels[:, :, None].repeat(3, axis=2)
