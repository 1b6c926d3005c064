"""Masks as they travel."""

import struct
import zlib

import cv2
import numpy as np
from jaxtyping import UInt8

from schemas.messages import Image, ImageEncoding

ENCODING = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE)
"""Rows as they are: the next frame decodes them in an eighth of the time that OpenCV's usual filters take."""
SIGNATURE = b"\x89PNG\r\n\x1a\n"
ONE_BIT_OF_GREY = 1, 0, 0, 0, 0
"""Depth and colour, and the only kinds of compression, filters and order that do without more."""
FAST = 1


def mask_image(coverage: UInt8[np.ndarray, "h w"]) -> Image:
    """A coverage mask as PNG."""
    height, width = coverage.shape
    return Image(ImageEncoding.PNG, width, height, 1, cv2.imencode(".png", coverage, ENCODING)[1].tobytes())


def drawn_mask_image(mask: UInt8[np.ndarray, "h w"]) -> Image:
    """A mask of 0 and 255 alone as PNG of one bit a pixel, in a seventh of the time that OpenCV takes."""
    height, width = mask.shape
    # each row begins with the number of its filter, which is none
    rows = np.zeros((height, 1 + -(-width // 8)), np.uint8)
    rows[:, 1:] = np.packbits(mask, axis=1)
    header = struct.pack(">II5B", width, height, *ONE_BIT_OF_GREY)
    chunks = _chunk(b"IHDR", header), _chunk(b"IDAT", zlib.compress(rows.tobytes(), FAST)), _chunk(b"IEND", b"")
    return Image(ImageEncoding.PNG, width, height, 1, SIGNATURE + b"".join(chunks))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
