"""Folders of rendered scenes as views to learn from: one eye's image, and the true coverage by thread."""

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

EYES = "left", "right"
Image = UInt8[np.ndarray, "h w 3"]
Coverage = UInt8[np.ndarray, "h w"]


class SceneFolderError(ValueError):
    """A folder that holds no scenes to learn from: the text says what is missing."""


@dataclass(frozen=True)
class View:
    """One eye's image and how much of each pixel is visible thread, 0 to 255."""

    name: str
    image: Image
    coverage: Coverage


def views_in(folders: Iterable[Path]) -> list[View]:
    """Every NAME_left.png and NAME_right.png that has a NAME_mask_EYE.png, below each folder, in order of names.

    Raises:
        SceneFolderError: where a folder has none.
    """
    views: list[View] = []
    for folder in folders:
        # decoding leaves Python's lock, and thousands of views take minutes in one thread
        with ThreadPoolExecutor() as threads:
            found = [view for view in threads.map(_view_of, sorted(folder.rglob("*.png"))) if view is not None]
        if not found:
            raise SceneFolderError(f"{folder} has no NAME_left.png beside a NAME_mask_left.png; render scenes into it")
        views += found
    return views


def _view_of(path: Path) -> View | None:
    name, _, eye = path.stem.rpartition("_")
    mask = path.with_name(f"{name}_mask_{eye}.png")
    # masks have masks' names themselves, and would need a mask of their own
    if eye not in EYES or not mask.is_file():
        return None
    image, coverage = cv2.imread(str(path), cv2.IMREAD_COLOR), cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE)
    if image is None or coverage is None or image.shape[:2] != coverage.shape:
        return None
    return View(f"{name}_{eye}", np.asarray(image, np.uint8), np.asarray(coverage, np.uint8))
