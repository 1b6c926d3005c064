"""Folders of rendered scenes as views to learn from: one eye's image, and the true coverage by thread."""

import functools
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

EYES = "left", "right"
Image = UInt8[np.ndarray, "h w 3"]
Coverage = UInt8[np.ndarray, "h w"]
NEEDLE, INSTRUMENT = ("needle",), ("instrument", "tool")
"""What the masks of these are called; `tool` by `suturegrasp scenes render`."""


class SceneFolderError(ValueError):
    """A folder that holds no scenes to learn from: the text says what is missing."""


@dataclass(frozen=True)
class View:
    """One eye's image and how much of each pixel is visible thread, and where known needle and instrument, 0 to 255."""

    name: str
    image: Image
    coverage: Coverage
    needle: Coverage | None = None
    instrument: Coverage | None = None


def views_in(folders: Iterable[Path], classes: bool = False) -> list[View]:
    """Every NAME_left.png and NAME_right.png that has a NAME_mask_EYE.png, below each folder, in order of names.

    Args:
        classes: read the masks of needles and instruments too, where there are any.

    Raises:
        SceneFolderError: where a folder has none.
    """
    views: list[View] = []
    one = functools.partial(_view_of, classes=classes)
    for folder in folders:
        # decoding leaves Python's lock, and thousands of views take minutes in one thread
        with ThreadPoolExecutor() as threads:
            found = [view for view in threads.map(one, sorted(folder.rglob("*.png"))) if view is not None]
        if not found:
            raise SceneFolderError(f"{folder} has no NAME_left.png beside a NAME_mask_left.png; render scenes into it")
        views += found
    return views


def _view_of(path: Path, classes: bool) -> View | None:
    name, _, eye = path.stem.rpartition("_")
    # masks have masks' names themselves, and would need a mask of their own
    if eye not in EYES or not path.with_name(f"{name}_mask_{eye}.png").is_file():
        return None
    image, coverage = cv2.imread(str(path), cv2.IMREAD_COLOR), _mask_of(path, ("mask",))
    if image is None or coverage is None or image.shape[:2] != coverage.shape:
        return None
    needle, instrument = (_mask_of(path, names) for names in (NEEDLE, INSTRUMENT)) if classes else (None, None)
    if any(mask is not None and mask.shape != coverage.shape for mask in (needle, instrument)):
        return None
    return View(f"{name}_{eye}", np.asarray(image, np.uint8), coverage, needle, instrument)


def _mask_of(path: Path, names: Sequence[str]) -> Coverage | None:
    """The first of the masks of an image that is there."""
    name, _, eye = path.stem.rpartition("_")
    for mask in (path.with_name(f"{name}_{kind}_{eye}.png") for kind in names):
        if mask.is_file() and (read := cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE)) is not None:
            return np.asarray(read, np.uint8)
    return None
