"""The camera's images as Rerun shows them, as they travelled, and the masks that come beside what was seen in them."""

import numpy as np
import rerun as rr
from jaxtyping import UInt8

from agents.viewer.entity import Entity
from agents.viewer.image_pane import decoded_mask
from schemas.messages import Image, ImageEncoding, StereoFrame
from shared.images import ImageDataError, decode_image, encode_image

JPEG_QUALITY = 85
"""Of images that travel raw, which would fill a disk within minutes."""

_MEDIA = {ImageEncoding.JPEG: ("image/jpeg", b"\xff\xd8\xff"), ImageEncoding.PNG: ("image/png", b"\x89PNG\r\n")}


def frame_entities(frame: StereoFrame, rectified: bool) -> list[Entity]:
    """Both images: on the cameras of space where they are rectified, otherwise apart."""
    left, right = ("world/left/image", "world/right/image") if rectified else ("camera/raw/left", "camera/raw/right")
    return [(left, [encoded(frame.left)]), (right, [encoded(frame.right)])]


def encoded(image: Image) -> rr.EncodedImage:
    """An image as it travelled; a raw one is compressed.

    Raises:
        ImageDataError: where it does not begin as its encoding does.
    """
    if image.encoding is ImageEncoding.RAW:
        image = encode_image(decode_image(image), ImageEncoding.JPEG, JPEG_QUALITY)
    media_type, begins = _MEDIA[image.encoding]
    if not image.data.startswith(begins):
        raise ImageDataError(f"{len(image.data)} bytes are no {image.encoding.name}, though the message says so")
    return rr.EncodedImage(contents=image.data, media_type=media_type)


def coverage(mask: Image) -> UInt8[np.ndarray, "h w"]:
    coverage = decoded_mask(mask)
    if coverage is None:
        raise ImageDataError("a mask is no image of the size that it claims")
    return coverage
