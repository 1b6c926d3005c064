"""Photographs of black stitches as labelled views: python -m benchmarks.training.photographs --output DIR.

What is black on a pad of the colour of skin, and long, is thread: ink on these pads is red or violet. Photographs that
show less pad than surroundings are left out, since rulers lie there.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from jaxtyping import UInt8

from benchmarks.training.lab_ground import save
from benchmarks.training.scenes import Coverage, Image

BLACK, EDGE = 0.42, 0.62
"""Of the red light of the pad around: thread shows no more, and its edge less than this. Red ink shows more."""
SHORTEST_PX = 12
"""Shorter pieces are dust."""
PAD_SHARE = 0.6
"""Of a photograph that is used."""
AROUND_PX = 121
"""Side of the square whose median is the pad's colour: thread and ink fill less than half of it."""
BORDER_PX = 12
"""Of the pad, which is in the shadow of its frame."""


def stitches(photograph: Image) -> Coverage | None:
    """How much of each pixel is thread, 0 to 255; None where the photograph shows more than its pad."""
    pad_colour = _around(photograph)
    pad = _pad(pad_colour)
    if np.count_nonzero(pad) < PAD_SHARE * pad.size:
        return None
    red = cv2.GaussianBlur(photograph[..., 2], (0, 0), 0.8) / np.maximum(pad_colour[..., 2], 1.0)
    cover = np.clip((EDGE - red) / (EDGE - BLACK), 0, 1) * (pad > 0)
    count, piece, about, _ = cv2.connectedComponentsWithStats((cover > 0.3).astype(np.uint8), connectivity=8)
    blackest = np.zeros(count)
    np.maximum.at(blackest, np.asarray(piece, np.int64).ravel(), cover.ravel())
    is_thread = (np.asarray(about)[:, 2:4].max(axis=1) >= SHORTEST_PX) & (blackest > 0.9)
    return np.rint(255 * cover * is_thread[np.asarray(piece)]).astype(np.uint8)


def _around(photograph: Image) -> np.ndarray:
    """The usual colour around each pixel, as 32-bit floats."""
    shrink = 4
    small = cv2.resize(photograph, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
    usual = cv2.medianBlur(small, AROUND_PX // shrink | 1)
    return cv2.resize(usual, photograph.shape[1::-1], interpolation=cv2.INTER_LINEAR).astype(np.float32)


def _pad(colour: np.ndarray) -> UInt8[np.ndarray, "h w"]:
    """The largest region of the colour of skin, without its border."""
    blue, green, red = cv2.split(colour)
    skin = ((red > 1.15 * blue) & (red < 2.3 * blue) & (green > 0.55 * red)).astype(np.uint8)
    count, region, about, _ = cv2.connectedComponentsWithStats(skin)
    if count < 2:
        return np.zeros(skin.shape, np.uint8)
    largest = (np.asarray(region) == 1 + np.argmax(np.asarray(about)[1:, 4])).astype(np.uint8)
    whole = cv2.morphologyEx(largest, cv2.MORPH_CLOSE, np.ones((AROUND_PX // 2, AROUND_PX // 2), np.uint8))
    # the photograph may end on the pad
    inner = cv2.erode(cv2.copyMakeBorder(whole, 1, 1, 1, 1, cv2.BORDER_REPLICATE), np.ones((2 * BORDER_PX + 1,) * 2))
    return np.asarray(inner[1:-1, 1:-1], np.uint8)


@dataclass(frozen=True)
class Options:
    """From where to where."""

    output: Path
    """Folder to write into."""
    photographs: Path = Path("../shared/data/suture_pads")
    """Folder of *.jpg."""


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line and write NAME_left.png and NAME_mask_left.png of each; returns the exit status."""
    options = tyro.cli(Options, args=arguments, description=__doc__)
    paths = sorted(options.photographs.glob("*.jpg"))
    if not paths:
        print(f"{options.photographs} holds no *.jpg", file=sys.stderr)
        return 2
    options.output.mkdir(parents=True, exist_ok=True)
    for path in paths:
        photograph = np.asarray(cv2.imread(str(path), cv2.IMREAD_COLOR), np.uint8)
        cover = stitches(photograph)
        if cover is not None:
            save(options.output / f"{path.stem}_left.png", photograph)
            save(options.output / f"{path.stem}_mask_left.png", cover)
    return 0


if __name__ == "__main__":
    sys.exit(main())
