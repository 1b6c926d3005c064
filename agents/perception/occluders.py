"""Instruments and needles as the network with classes sees them in one image: what may hide thread."""

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from agents.perception.segmentation.classes import kinds_of_squares
from schemas.messages import Image, ImageEncoding, Occluder

WIDTH_PX = 240
"""Of a map of occluders."""
OF_KIND = np.array([0, 0, Occluder.NEEDLE.value, Occluder.TOOL.value], np.uint8)
"""The number of an `Occluder`, or 0, for each `Kind`."""


def occluders_in(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "r c"]:
    """The number of an `Occluder`, or 0, for each pixel of a map 240 px wide.

    The network looks at a copy of twice that size, since it says one class for each square of four pixels.
    """
    rows, columns = map_shape(image.shape)
    small = cv2.resize(image, (2 * columns, 2 * rows), interpolation=cv2.INTER_AREA)
    return OF_KIND[kinds_of_squares(np.asarray(small, np.uint8))]


def map_shape(image_shape: tuple[int, ...]) -> tuple[int, int]:
    """Rows and columns of a map of occluders."""
    return max(1, round(image_shape[0] * WIDTH_PX / image_shape[1])), WIDTH_PX


def instruments_in(occluders: UInt8[np.ndarray, "r c"], shape: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """Where an instrument or a needle lies in an image, by its map of occluders."""
    known = np.isin(occluders, (Occluder.TOOL.value, Occluder.NEEDLE.value)).astype(np.uint8)
    return np.asarray(cv2.resize(known, shape[::-1], interpolation=cv2.INTER_NEAREST)) > 0


def map_image(occluders: UInt8[np.ndarray, "r c"]) -> Image:
    """A map of occluders as it travels."""
    height, width = occluders.shape
    return Image(ImageEncoding.PNG, width, height, 1, cv2.imencode(".png", occluders)[1].tobytes())
