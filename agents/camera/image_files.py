"""Images from files, as colour with 8 bits, or one clear sentence why not."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from agents.camera.decoding import DecodingError, decode_colour
from shared.terminal import UsageError

SMALLEST_SIDE_PX = 16
LARGEST_FILE_BYTES = 1 << 29
"""More than any image of `LARGEST_IMAGE_PIXELS`; devices such as /dev/zero never end."""


class ImageFileError(ValueError):
    """An image file that cannot be used; the text names it, what is wrong, and what to do."""


def read_pair(left: Path, right: Path) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]:
    """Two images of one size as blue, green, red; grey becomes colour, 16 bits become 8, transparency is dropped.

    Raises:
        ImageFileError: where one cannot be read, or their sizes differ.
    """
    first, second = _read(left, "the left image"), _read(right, "the right image")
    if first.shape != second.shape:
        raise ImageFileError(
            f"the images differ in size: {left} has {_size(first)} pixels, {right} has {_size(second)}; "
            "give both eyes of one frame"
        )
    _check_smallest(first, f"the left image {left}")
    largest = max(int(first.max()), int(second.max()))
    return _eight_bit(first, largest), _eight_bit(second, largest)


def read_image(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """One image, as `read_pair` gives two.

    Raises:
        ImageFileError: where it cannot be read.
    """
    image = _read(path, "the image")
    _check_smallest(image, f"the image {path}")
    return _eight_bit(image, int(image.max()))


def read_given(
    left: Path | None, right: Path | None, stereo: Path | None
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]:
    """The pair that was named: either both images, or one side-by-side image.

    Raises:
        UsageError: where neither is named, or both are.
        ImageFileError: where a file cannot be used.
    """
    match left, right, stereo:
        case Path(), Path(), None:
            return read_pair(left, right)
        case None, None, Path():
            return read_side_by_side(stereo)
        case _:
            raise UsageError("give either both --left and --right, or one side-by-side image with --stereo")


def read_side_by_side(stereo: Path) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]:
    """The left and the right half of one image, as `read_pair` gives them.

    Raises:
        ImageFileError: where it cannot be read or has no two halves.
    """
    image = _read(stereo, "the side-by-side image")
    width = image.shape[1]
    if width % 2:
        raise ImageFileError(
            f"the side-by-side image {stereo} is {width} pixels wide, so it has no two equal halves; "
            "give both images in one file, or each in its own with --left and --right"
        )
    image = _eight_bit(image, int(image.max()))
    left, right = np.ascontiguousarray(image[:, : width // 2]), np.ascontiguousarray(image[:, width // 2 :])
    _check_smallest(left, f"each half of the side-by-side image {stereo}")
    return left, right


def read_mask(path: Path, what: str, width: int, height: int) -> UInt8[np.ndarray, "h w"]:
    """The coverage of each pixel by thread, 0 to 255: the brightest channel; zeros and ones are stretched.

    Raises:
        ImageFileError: where it cannot be read, has another size than the image, or is empty; `what` is what the
            text calls it.
    """
    mask = _read(path, what).max(axis=2)
    if mask.shape != (height, width):
        raise ImageFileError(
            f"{what} {path} has {_size(mask)} pixels, its image {width}x{height}; give the mask of this image"
        )
    largest = int(mask.max())
    if largest == 0:
        raise ImageFileError(f"{what} {path} is empty: no pixel is marked as thread; mark it, or leave the masks out")
    return (mask * 255).astype(np.uint8) if largest == 1 else _eight_bit(mask, largest)


def _read(path: Path, what: str) -> np.ndarray:
    """The image in its own depth, 8 or 16 bits."""
    data = _bytes(path, what)
    if not data:
        raise ImageFileError(f"{what} {path} is an empty file; give a PNG, JPEG, TIFF or BMP file")
    try:
        image = decode_colour(data)
    except DecodingError as error:
        raise ImageFileError(f"{what} {path} {error}") from None
    if image.dtype.name not in ("uint8", "uint16"):
        raise ImageFileError(f"{what} {path} holds {image.dtype} numbers; give 8 or 16 bits without sign")
    return image


def _bytes(path: Path, what: str) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE_BYTES + 1)
    except FileNotFoundError:
        raise ImageFileError(f"{what} {path} does not exist; check the path") from None
    except IsADirectoryError:
        raise ImageFileError(f"{what} {path} is a folder; give a file in it") from None
    except OSError as error:
        raise ImageFileError(f"{what} {path} cannot be read: {error.strerror or error}") from None
    if len(data) > LARGEST_FILE_BYTES:
        raise ImageFileError(f"{what} {path} is larger than {LARGEST_FILE_BYTES >> 20} MB; give a single image")
    return data


def _eight_bit(image: np.ndarray, largest: int) -> np.ndarray:
    """8 bits of 16; cameras of 10 to 14 bits leave the upper ones empty, which the largest value tells."""
    if image.dtype == np.uint8:
        return image
    bits = max(8, 2 * ((largest.bit_length() + 1) // 2))
    return np.rint(image * np.float32(255 / (2**bits - 1))).astype(np.uint8)


def _check_smallest(image: np.ndarray, what: str) -> None:
    if min(image.shape[:2]) < SMALLEST_SIDE_PX:
        raise ImageFileError(f"{what} has only {_size(image)} pixels; at least {SMALLEST_SIDE_PX} each way are needed")


def _size(image: np.ndarray) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"
