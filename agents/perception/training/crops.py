"""Batches of crops, endlessly: most of them on thread, the others anywhere, so that the ground is learned as well."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float32

from agents.perception.segmentation.network import phases
from agents.perception.training.augmentation import crop_of, varied
from agents.perception.training.clutter import Coverage
from agents.perception.training.scenes import View

ON_THREAD_SHARE = 0.6
CROP_PX = 256
ACROSS = 2
"""The network gives so many pixels a side for each pixel of its own."""


def batches(
    folders: Sequence[Sequence[View]], size: int, seed: int
) -> Iterator[tuple[Float32[np.ndarray, "n 12 r c"], Float32[np.ndarray, "n 4 r c"]]]:
    """Varied crops as the network takes them, and the coverage that it should give, 0 to 1.

    Each folder of views is drawn from alike, so that few costly scenes count as much as many cheap ones.
    """
    rng = np.random.default_rng([seed, 21])
    threads = [[np.flatnonzero(view.coverage.ravel() > 127) for view in views] for views in folders]
    while True:
        chosen = [(k, int(rng.integers(len(folders[k])))) for k in rng.integers(len(folders), size=size).tolist()]
        crops = [_crop(folders[k][view], threads[k][view], rng) for k, view in chosen]
        yield (
            np.concatenate([phases(image) for image, _ in crops]),
            np.stack([coverage_phases(coverage) for _, coverage in crops]),
        )


def coverage_phases(coverage: Coverage) -> Float32[np.ndarray, "4 r c"]:
    """Coverage at half size, the four pixels of each square as channels, 0 to 1."""
    rows, columns = (side // ACROSS for side in coverage.shape)
    apart = coverage.reshape(rows, ACROSS, columns, ACROSS).transpose(1, 3, 0, 2)
    return apart.reshape(-1, rows, columns).astype(np.float32) / 255


def _crop(view: View, thread: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    height, width = view.coverage.shape
    if len(thread) and rng.uniform() < ON_THREAD_SHARE:
        pixel = int(rng.choice(thread))
        centre = np.array([pixel % width, pixel // width]) + rng.uniform(-0.3, 0.3, 2) * CROP_PX
    else:
        centre = rng.uniform(0, 1, 2) * (width, height)
    return varied(*crop_of(view.image, view.coverage, centre, CROP_PX, rng), rng)
