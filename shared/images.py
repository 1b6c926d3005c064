"""Images as arrays and as messages."""

import cv2
import numpy as np
from jaxtyping import UInt8

from schemas.messages import Image, ImageEncoding
from shared.jpeg import jpeg_damage


class ImageDataError(ValueError):
    """An image message whose bytes are not the image that it says; the text names what is wrong."""


SUFFIX = {ImageEncoding.PNG: ".png", ImageEncoding.JPEG: ".jpg"}
FRAMING = {
    ImageEncoding.PNG: (b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"),
    ImageEncoding.JPEG: (b"\xff\xd8", b"\xff\xd9"),
}
"""How the bytes of an encoded image begin and end. Of half a JPEG, decoders make a picture with a grey half."""


def encode_image(pixels: UInt8[np.ndarray, "h w *c"], encoding: ImageEncoding, jpeg_quality: int = 95) -> Image:
    """An image message of grey or colour (blue first) pixels."""
    height, width = pixels.shape[:2]
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    if encoding is ImageEncoding.RAW:
        data = pixels.tobytes()
    else:
        quality = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality] if encoding is ImageEncoding.JPEG else []
        data = cv2.imencode(SUFFIX[encoding], pixels, quality)[1].tobytes()
    return Image(encoding, width, height, channels, data)


def decode_image(image: Image) -> UInt8[np.ndarray, "h w *c"]:
    """The pixels of an image message: grey (h, w) or colour (h, w, 3), blue first.

    Raises:
        ImageDataError: where they cannot be decoded, or are not of the size that the message says.
    """
    shape = (image.height, image.width) if image.channels == 1 else (image.height, image.width, image.channels)
    if image.encoding is ImageEncoding.RAW:
        return np.frombuffer(image.data, np.uint8).reshape(shape)
    begin, end = FRAMING[image.encoding]
    if not (image.data.startswith(begin) and image.data.rstrip(b"\0").endswith(end)):
        raise ImageDataError(f"{len(image.data)} bytes of {image.encoding.name} are not whole, or no such image")
    if image.encoding is ImageEncoding.JPEG and (damage := jpeg_damage(image.data)):
        raise ImageDataError(f"the JPEG is damaged: {damage}")
    flags = cv2.IMREAD_GRAYSCALE if image.channels == 1 else cv2.IMREAD_COLOR
    try:
        pixels = cv2.imdecode(np.frombuffer(image.data, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    except (cv2.error, MemoryError):
        pixels = None
    if pixels is None:
        raise ImageDataError(f"{len(image.data)} bytes of {image.encoding.name} cannot be decoded")
    if pixels.shape != shape:
        raise ImageDataError(
            f"the image decodes to {pixels.shape[1]}x{pixels.shape[0]}, not to {image.width}x{image.height} as it says"
        )
    return pixels.astype(np.uint8, copy=False)
