"""Pictures of what was found, over the images that it was found in; colours are blue first."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

Image = UInt8[np.ndarray, "h w 3"]
Points = Float64[np.ndarray, "n 2"]
GREEN, RED, YELLOW, MAGENTA = (0, 255, 0), (0, 0, 255), (0, 255, 255), (255, 0, 255)


def dotted(image: Image, *layers: tuple[Points, tuple[int, int, int]]) -> Image:
    """A copy of an image with a dot at each point of each layer, in the layer's colour."""
    picture = image.copy()
    for points, colour in layers:
        at = np.rint(points).astype(np.int64)
        inside = ((at >= 0) & (at < image.shape[1::-1])).all(axis=1)
        picture[at[inside, 1], at[inside, 0]] = colour
    return picture


def save(path: Path, *images: Image) -> None:
    """Write images side by side."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.hstack(images))
