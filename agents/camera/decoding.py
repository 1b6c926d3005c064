"""Image files decoded without a word on standard error.

The libraries below OpenCV print what they think of a file straight to file descriptor 2, past `sys.stderr`. While a
file is decoded, that descriptor leads into a temporary file, whose content tells a damaged file from a whole one:
libjpeg and libtiff decode on through damage, and the picture has a tear.
"""

import contextlib
import os
import re
import tempfile
from collections.abc import Generator

import cv2
import numpy as np

from agents.camera import LARGEST_IMAGE_PIXELS

STANDARD_ERROR = 2
DAMAGE = re.compile(r"Corrupt JPEG data|premature end|TIFF_Error", re.IGNORECASE)
"""What decoders say of a file that they decode nevertheless, and whose pixels are then wrong."""


class DecodingError(ValueError):
    """Bytes that are no whole image; the text says what is wrong with them."""


def decode_colour(data: bytes) -> np.ndarray:
    """The first image in these bytes as blue, green, red, in the depth in which it was stored.

    Raises:
        DecodingError: where there is none, it is damaged, or larger than any camera's.
    """
    with _said_to_standard_error() as said:
        try:
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
        except (cv2.error, MemoryError) as error:
            image = None
            if "CV_IO_MAX_IMAGE" in str(error):
                raise DecodingError(_too_large()) from None
    if image is None:
        raise DecodingError("is damaged, or no image that can be decoded; give a whole PNG, JPEG, TIFF or BMP file")
    if DAMAGE.search("".join(said)):
        raise DecodingError("is damaged: parts of it cannot be decoded; save or copy it again")
    if image.shape[0] * image.shape[1] > LARGEST_IMAGE_PIXELS:
        raise DecodingError(_too_large())
    return image


def _too_large() -> str:
    return (
        f"is said to have more than {LARGEST_IMAGE_PIXELS / 1e6:.0f} million pixels; give an image as a camera takes it"
    )


@contextlib.contextmanager
def _said_to_standard_error() -> Generator[list[str]]:
    """What is written to file descriptor 2 meanwhile, in the list once the block has ended."""
    said: list[str] = []
    try:
        kept = os.dup(STANDARD_ERROR)
    except OSError:
        # a daemon may have closed it, and then nobody hears anything anyway
        yield said
        return
    with tempfile.TemporaryFile() as listener:
        os.dup2(listener.fileno(), STANDARD_ERROR)
        try:
            yield said
        finally:
            os.dup2(kept, STANDARD_ERROR)
            os.close(kept)
            listener.seek(0)
            said.append(listener.read().decode(errors="replace"))
