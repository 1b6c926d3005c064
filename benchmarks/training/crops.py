"""Batches of crops, endlessly: most of them on thread, the others anywhere, so that the ground is learned as well."""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float64, UInt8

from agents.perception.segmentation.classes import Kind, highest, scores_of
from benchmarks.training.augmentation import varied
from benchmarks.training.drawn_layers import Layers, drawn_layers
from benchmarks.training.random_numbers import Lots, lots_of
from benchmarks.training.scenes import View

ON_THREAD_SHARE = 0.6
CROP_PX = 256
ACROSS = 2
"""The network gives so many pixels a side for each pixel of its own."""
RESAMPLED_SHARE = 0.55
SCALE = 0.4, 1.7
"""Of a resampled crop: the same thread is nearer or farther, or the camera has more or fewer pixels."""
AVERAGED_SCALE = 0.8
"""What is drawn smaller than this is averaged of four samples for each pixel."""
CORNERS = (0, 0), (0, 1), (1, 0), (1, 1)
"""The pixels around a sample: rows and columns on from the first one."""
POINTS_KEPT = 512
"""Places of each kind on each view, one of which a crop may have near its middle."""
POINT_WEIGHTS = 0.5, 0.1, 0.1, 0.3
"""How often such a crop lies on thread, needle, instrument, and what was mistaken, of those that the view has."""
NEAR_PX = 5
"""Side of the square about a pixel within which an answer is no mistake: edges are anybody's guess."""
BYTES = 8
"""Of a pixel: its colour, its coverage by thread, needle and instrument, and what makes it a number of 64 bits."""
COLOURS, KINDS = 3, 3


@dataclass(frozen=True)
class Pixels:
    """All pixels of views, one behind the other on the device, so that crops of views of any size are one step.

    Fields:
        pixels: blue, green, red, and coverage by thread, needle and instrument, (p, 8), 0 to 255; the last two are 0.
        start, height, width: of each view, the number of its first pixel and its size.
        folders: the first view of each folder, and how many there are.
        points: of each view and kind, places (x, y) on it; none, where it has none.
        sizes: of each view, rows and columns.
    """

    pixels: torch.Tensor
    start: torch.Tensor
    height: torch.Tensor
    width: torch.Tensor
    folders: list[tuple[int, int]]
    points: list[list[Float64[np.ndarray, "k 2"]]]
    sizes: list[tuple[int, int]]


def pixels_of(
    folders: Sequence[Sequence[View]], device: torch.device, seed: int, mistaken_by: Path | None = None
) -> Pixels:
    """The views of some folders, on a device; a folder that is named again is there but once.

    Args:
        mistaken_by: an exported network with classes whose mistakes are drawn more often than the rest of the ground.
    """
    rng = np.random.default_rng([seed, 20])
    distinct = {id(folder): folder for folder in folders}
    views = [view for folder in distinct.values() for view in folder]
    sizes = [view.coverage.shape for view in views]
    counts = np.array([height * width for height, width in sizes])
    starts = np.concatenate(([0], np.cumsum(counts)))
    pixels = torch.zeros((int(starts[-1]), BYTES), dtype=torch.uint8, device=device)
    for view, begin, after in zip(views, starts[:-1], starts[1:], strict=True):
        for first, values in ((0, view.image), (3, view.coverage), (4, view.needle), (5, view.instrument)):
            if values is not None:
                flat = torch.from_numpy(values.reshape(int(after - begin), -1)).to(device)
                pixels[int(begin) : int(after), first : first + flat.shape[1]] = flat
    ends = np.cumsum([len(folder) for folder in distinct.values()]).tolist()
    first = {number: end - len(folder) for (number, folder), end in zip(distinct.items(), ends, strict=True)}
    of_view = torch.tensor(np.column_stack((starts[:-1], np.array(sizes))), device=device)
    start, height, width = of_view.unbind(1)
    return Pixels(
        pixels=pixels,
        start=start,
        height=height,
        width=width,
        folders=[(first[id(folder)], len(folder)) for folder in folders],
        points=[_points(view, rng, mistaken_by) for view in views],
        sizes=[(int(height), int(width)) for height, width in sizes],
    )


def _points(view: View, rng: np.random.Generator, mistaken_by: Path | None) -> list[Float64[np.ndarray, "k 2"]]:
    points: list[Float64[np.ndarray, "k 2"]] = []
    mistaken = None if mistaken_by is None else _mistaken(view, mistaken_by)
    for covered in (view.coverage, view.needle, view.instrument, mistaken):
        on = np.zeros(0, np.int64) if covered is None else np.flatnonzero(covered.ravel() > 127)
        kept = on if len(on) <= POINTS_KEPT else rng.choice(on, POINTS_KEPT, replace=False)
        row, column = np.divmod(kept, view.coverage.shape[1])
        points.append(np.column_stack((column, row)).astype(np.float64))
    return points


def _mistaken(view: View, weights: Path) -> UInt8[np.ndarray, "h w"]:
    """Where a network finds thread or needle and there is none nearby, and thread that it does not find, 0 or 255."""
    answer, wrong = highest(scores_of(view.image, weights)), np.zeros(view.coverage.shape, np.uint8)
    for kind, covered in ((Kind.THREAD, view.coverage), (Kind.NEEDLE, view.needle)):
        there = np.zeros(wrong.shape, np.uint8) if covered is None else covered
        wrong[(answer == kind) & (cv2.dilate(there, np.ones((NEAR_PX, NEAR_PX), np.uint8)) == 0)] = 255
    wrong[(answer != Kind.THREAD) & (view.coverage > 127)] = 255
    return wrong


def batches(
    folders: Sequence[Sequence[View]],
    size: int,
    seed: int,
    device: torch.device,
    red_share: float,
) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Varied crops as the network takes them (n, 12, r, c), and the shares of classes (n, 16, r, c), 0 to 1.

    Each folder of views is drawn from alike, so that few costly scenes count as much as many cheap ones.

    Args:
        red_share: of the colours in which thread is dyed anew.
    """
    return batches_of(pixels_of(folders, device, seed), size, seed, red_share)


def batches_of(pixels: Pixels, size: int, seed: int, red_share: float) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """As `batches`, of views whose pixels are on the device already."""
    device = pixels.pixels.device
    lots, layers = lots_of(seed, device), drawn_layers(seed, device)
    while True:
        yield one_batch(pixels, size, lots, layers, red_share)


def one_batch(
    pixels: Pixels, size: int, lots: Lots, layers: Layers, red_share: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """So many varied crops and the shares of their classes, as the network takes and gives them."""
    with torch.no_grad():
        image, coverage = crops_of(pixels, size, lots)
        image, coverage = varied(image, coverage, lots, layers, red_share)
        return phases_of(image / 255), phases_of(shares_of(coverage))


def shares_of(coverage: torch.Tensor) -> torch.Tensor:
    """The shares of ground, thread, needle and instrument (n, 4, s, s), which are 1 together, from coverage (n, 3)."""
    shown = coverage / 255
    total = shown.sum(dim=1, keepdim=True)
    return torch.cat((torch.clamp(1 - total, min=0), shown / torch.clamp(total, min=1)), dim=1)


def phases_of(image: torch.Tensor) -> torch.Tensor:
    """At half size, the four pixels of each square as channels: (n, c, h, w) to (n, 4 c, h/2, w/2)."""
    count, channels, height, width = image.shape
    apart = image.reshape(count, channels, height // ACROSS, ACROSS, width // ACROSS, ACROSS)
    return apart.permute(0, 3, 5, 1, 2, 4).reshape(count, -1, height // ACROSS, width // ACROSS)


def crops_of(pixels: Pixels, size: int, lots: Lots) -> tuple[torch.Tensor, torch.Tensor]:
    """Images (n, 3, s, s) and coverage by thread, needle, instrument (n, 3, s, s), 0 to 255.

    They are mirrored and turned, and part of them turned freely.
    """
    rng = lots.rng
    chosen = [
        (folder, int(rng.integers(pixels.folders[folder][1])))
        for folder in rng.integers(len(pixels.folders), size=size).tolist()
    ]
    view = np.array([pixels.folders[folder][0] + number for folder, number in chosen])
    resampled = rng.uniform(size=size) < RESAMPLED_SHARE
    scale = np.where(resampled, np.exp(rng.uniform(np.log(SCALE[0]), np.log(SCALE[1]), size)), 1.0)
    turn = np.where(resampled, rng.uniform(0, 2 * np.pi, size), rng.integers(4, size=size) * np.pi / 2)
    centre = np.stack([_centre(pixels, int(number), rng) for number in view])
    centre = np.where(resampled[:, None], centre, np.rint(centre + 0.5) - 0.5)
    rows = np.stack((np.cos(turn), -np.sin(turn), np.sin(turn), np.cos(turn)), axis=1).reshape(size, 2, 2)
    rows[..., 0] *= rng.choice((-1, 1), size)[:, None]
    towards = rows / scale[:, None, None]
    seen = torch.empty((size, CROP_PX, CROP_PX, COLOURS + KINDS), device=lots.device)
    averaged = scale < AVERAGED_SCALE
    # what is only turned by right angles lies on pixels
    for few, aside, corners in (
        (averaged, (-0.25, 0.25), CORNERS),
        (resampled & ~averaged, (0.0,), CORNERS),
        (~resampled, (0.0,), CORNERS[:1]),
    ):
        which = np.flatnonzero(few)
        if len(which):
            at = torch.from_numpy(which).to(lots.device)
            seen[at] = _sampled(pixels, view[which], centre[which], towards[which], aside, corners)
    shown = seen.permute(0, 3, 1, 2)
    return shown[:, :COLOURS].contiguous(), shown[:, COLOURS:].contiguous()


def _centre(pixels: Pixels, view: int, rng: np.random.Generator) -> Float64[np.ndarray, "2"]:
    some = [(points, weight) for points, weight in zip(pixels.points[view], POINT_WEIGHTS, strict=True) if len(points)]
    height, width = pixels.sizes[view]
    if some and rng.uniform() < ON_THREAD_SHARE:
        weights = np.array([weight for _, weight in some])
        points = some[int(rng.choice(len(some), p=weights / weights.sum()))][0]
        return points[int(rng.integers(len(points)))] + rng.uniform(-0.3, 0.3, 2) * CROP_PX
    return rng.uniform(0, 1, 2) * (width, height)


def _sampled(
    pixels: Pixels,
    view: np.ndarray,
    centre: np.ndarray,
    towards: np.ndarray,
    aside: Sequence[float],
    corners: Sequence[tuple[int, int]],
) -> torch.Tensor:
    """Crops (n, s, s, 6) by bilinear interpolation, the mean of a sample at each offset in pixels of the crop.

    Args:
        corners: which of the four pixels around a sample take part (row, column).
    """
    device = pixels.pixels.device
    number = torch.from_numpy(view).to(device)
    start, height, width = (part[number][:, None, None] for part in (pixels.start, pixels.height, pixels.width))
    middle = torch.from_numpy(centre.astype(np.float32)).to(device)
    move = torch.from_numpy(towards.astype(np.float32)).to(device)
    steps = torch.arange(CROP_PX, device=device) - (CROP_PX - 1) / 2
    packed = pixels.pixels.view(torch.int64)[:, 0]
    total = torch.zeros((len(view), CROP_PX, CROP_PX, COLOURS + KINDS), device=device)
    for down in aside:
        for right in aside:
            place = torch.stack(torch.meshgrid(steps + down, steps + right, indexing="ij")[::-1], dim=-1)
            at = middle[:, None, None] + torch.einsum("nij,rcj->nrci", move, place)
            # what is exact but for rounding stays exact
            at = torch.where((at - at.round()).abs() < 1e-3, at.round(), at)
            low = at.floor()
            share = at - low
            for row, column in corners:
                x = _inside(low[..., 0].long() + column, width)
                y = _inside(low[..., 1].long() + row, height)
                across, down_share = (
                    part if far else 1 - part for part, far in zip(share.unbind(-1), (column, row), strict=True)
                )
                # all bytes of a pixel are fetched at once
                found = packed[start + y * width + x].view(torch.uint8).reshape(*total.shape[:3], BYTES)
                found = found[..., : COLOURS + KINDS]
                total += (across * down_share)[..., None] * found
    return total / len(aside) ** 2


def _inside(index: torch.Tensor, count: torch.Tensor) -> torch.Tensor:
    """Mirrored at the borders."""
    period = 2 * (count - 1)
    within = torch.remainder(index, period)
    return torch.where(within < count, within, period - within)
