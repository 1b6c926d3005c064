"""Between a crop of an image and what a network of the Segment Anything kind takes and gives.

The longest side becomes 1024 px; colours, red first, are normalised by the mean and deviation of ImageNet; the rest of
the square, to the right and below, is 0. A point's coordinate u counts pixels of the enlarged crop, and the decoder
adds one half to it; masks come at a quarter of the square's size (segment-anything: `utils/transforms.py`,
`modeling/sam.py`, `utils/onnx.py`).
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

SIDE_PX = 1024
"""Of the square that the encoder sees."""
MASK_SIDE_PX = 256
MEAN = np.array([123.675, 116.28, 103.53], np.float32)
"""Of ImageNet's red, green and blue."""
DEVIATION = np.array([58.395, 57.12, 57.375], np.float32)
THREAD, BESIDE, PADDING = 1.0, 0.0, -1.0
"""Labels of points; a padding point stands where a box would."""


def enlarged_size(size: tuple[int, int]) -> tuple[int, int]:
    """Height and width of a crop whose longest side has become the square's."""
    scale = SIDE_PX / max(size)
    return int(size[0] * scale + 0.5), int(size[1] * scale + 0.5)


def encoder_input(crop: UInt8[np.ndarray, "h w 3"], normalised: bool) -> Float32[np.ndarray, "..."]:
    """What the encoder takes of a crop, blue first.

    Args:
        normalised: whether as 1 x 3 x 1024 x 1024, normalised and padded; else as h x w x 3, which it does itself.
    """
    height, width = enlarged_size((crop.shape[0], crop.shape[1]))
    how = cv2.INTER_LINEAR if height >= crop.shape[0] else cv2.INTER_AREA
    enlarged = cv2.cvtColor(cv2.resize(crop, (width, height), interpolation=how), cv2.COLOR_BGR2RGB)
    if not normalised:
        return enlarged.astype(np.float32)
    square = np.zeros((1, 3, SIDE_PX, SIDE_PX), np.float32)
    for number, plane in enumerate(cv2.split(enlarged)):
        square[0, number, :height, :width] = (plane - MEAN[number]) / DEVIATION[number]
    return square


def network_points(
    point_px: Float64[np.ndarray, "n 2"], is_thread: Bool[np.ndarray, "n"], size: tuple[int, int]
) -> tuple[Float32[np.ndarray, "1 m 2"], Float32[np.ndarray, "1 m"]]:
    """Points of a crop in the enlarged one, and their labels, with one padding point more."""
    height, width = enlarged_size(size)
    scale = np.array([width / size[1], height / size[0]])
    # the middle of a pixel stays the middle of what it becomes
    points = np.vstack(((point_px + 0.5) * scale - 0.5, np.zeros(2)))
    labels = np.append(np.where(is_thread, THREAD, BESIDE), PADDING)
    return points[None].astype(np.float32), labels[None].astype(np.float32)


def logits_of_crop(mask: Float32[np.ndarray, "256 256"], size: tuple[int, int]) -> Float32[np.ndarray, "h w"]:
    """Logits of a crop's pixels from those of the square, between its four nearest pixels."""
    height, width = enlarged_size(size)
    u, v = (MASK_SIDE_PX / SIDE_PX * side / own for side, own in ((width, size[1]), (height, size[0])))
    to_mask = np.array([[u, 0.0, 0.5 * u - 0.5], [0.0, v, 0.5 * v - 0.5]])
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    found = cv2.warpAffine(mask, to_mask, (size[1], size[0]), flags=how, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float32)


def fitted(shape: tuple[int | None, ...], wanted: tuple[int, ...]) -> bool:
    """Whether something of the wanted shape may be given where a shape is declared, None being any length."""
    return len(shape) == len(wanted) and all(n in (None, w) for n, w in zip(shape, wanted, strict=True))
