"""The thread of rendered views in another colour: its shading, glints and edges stay, its dye is drawn anew.

So training sees threads of every colour without new renders, red ones above all: the colour alone would take them for
vessels. Some crops get a second strand as well, of another crop or beside their own.
"""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import torch
from torch.nn import functional

from benchmarks.training.blurring import blurred, spread
from benchmarks.training.random_numbers import Lots

CORE = 230.0
"""Coverage, 0 to 255, from which on a pixel shows thread alone."""
LEAST_CORE_PX = 4
GLINT = 1.6
"""Times a thread's usual brightness: what is brighter is light that its surface mirrors, which has no dye."""
LEAST_CONTRAST = 28.0
"""In grey levels of the channel that differs most: a thread less unlike its ground than this cannot be told."""
TRIES = 4
UNEVEN_SHARE, SHEEN_SHARE = 0.6, 0.35
"""How often its brightness changes along it besides, as that of a twisted or glossy thread; and how often it mirrors
lamps in places."""


def with_other_dye(image: torch.Tensor, coverage: torch.Tensor, red_share: float, lots: Lots) -> torch.Tensor:
    """Crops (n, 3, s, s) with their thread in another colour; as they were where it would not be seen.

    Args:
        coverage: by thread alone, (n, 1, s, s).
    """
    count, core = len(image), (coverage >= CORE).float()
    pixels = core.sum(dim=(1, 2, 3))
    ground = spread(image, (coverage == 0).float())
    # a mixed pixel holds as much thread as it is covered, of the brightness of the thread beside it
    thread = core * image + (1 - core) * spread(image, core)
    grey = thread.mean(dim=1, keepdim=True)
    usual = torch.clamp(_mean_where(grey, core, pixels), min=4.0)
    contrast = lots.uniform(0.5, 1.2, count, 1, 1, 1)
    body = torch.clamp(grey / usual, 0.05, GLINT) ** contrast * _uneven(image, lots)
    glints = torch.clamp(grey - GLINT * usual, min=0) * lots.uniform(0.3, 1.0, count, 1, 1, 1)
    behind = _mean_where(ground, core, pixels)
    light = torch.clamp(behind.mean(dim=1, keepdim=True) / 130, 0.5, 1.4)
    colour, is_seen = _unlike(behind, light * _mean_where(body, core, pixels), red_share, lots)
    new = torch.clamp(body * (light * colour), 0, 250) + glints + _sheen(image, lots)
    alpha = coverage / 255 * (is_seen * (pixels >= LEAST_CORE_PX))[:, None, None, None]
    return torch.clamp(image + alpha * (torch.clamp(new, 0, 255) - thread), 0, 255)


def _unlike(
    behind: torch.Tensor, brightness: torch.Tensor, red_share: float, lots: Lots
) -> tuple[torch.Tensor, torch.Tensor]:
    """The first of some colours (n, 3, 1, 1) that differs from the ground, and whether one does."""
    colours = torch.stack([_colours(len(behind), red_share, lots) for _ in range(TRIES)])
    apart = (brightness * colours - behind).abs().amax(dim=2)[:, :, 0, 0] >= LEAST_CONTRAST
    first = apart.float().argmax(dim=0)
    return colours[first, torch.arange(len(behind), device=behind.device)], apart.any(dim=0).float()


def _colours(count: int, red_share: float, lots: Lots) -> torch.Tensor:
    """Blue first, 0 to 255, (n, 3, 1, 1)."""
    is_red = lots.uniform(0, 1, count) < red_share
    hue = torch.where(is_red, torch.remainder(lots.normal(7 / 360, count), 1), lots.uniform(0, 1, count))
    saturation = torch.where(is_red, lots.uniform(0.4, 0.95, count), lots.uniform(0.1, 1.0, count))
    value = torch.where(is_red, lots.uniform(0.3, 0.9, count), lots.uniform(0.15, 0.95, count))
    # of the hexagon of colours: each channel falls from its own hue to nothing a third of the circle away
    at = torch.tensor([2 / 3, 1 / 3, 0.0], device=lots.device)
    away = torch.remainder(hue[:, None] - at + 0.5, 1) - 0.5
    pure = torch.clamp(2 - 6 * away.abs(), 0, 1)
    return (255 * value[:, None] * (1 - saturation[:, None] * (1 - pure)))[..., None, None]


def _uneven(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    """How much brighter or darker a twisted thread is from place to place, (n, 1, s, s), over long and short ways."""
    count, side = len(image), image.shape[-1]
    often = (lots.uniform(0, 1, count, 1, 1, 1) < UNEVEN_SHARE).float()
    total = torch.zeros((count, 1, side, side), device=image.device)
    for cells in (int(lots.rng.integers(3, 12)), int(lots.rng.integers(40, side // 2))):
        field = lots.normal(1.0, count, 1, cells, cells) * lots.uniform(0.05, 0.45, count, 1, 1, 1)
        total = total + functional.interpolate(field, size=(side, side), mode="bilinear", align_corners=False)
    return torch.clamp(torch.exp(often * total), 0.3, 1.8)


def _sheen(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Light of lamps that a glossy thread mirrors in places: what is added to its colour, (n, 3, s, s)."""
    count, side, cells = len(image), image.shape[-1], int(lots.rng.integers(32, 128))
    often = (lots.uniform(0, 1, count, 1, 1, 1) < SHEEN_SHARE).float()
    field = functional.interpolate(lots.normal(1.0, count, 1, cells, cells), size=(side, side), mode="bilinear")
    where = torch.clamp(2 * (field - lots.uniform(0.2, 1.2, count, 1, 1, 1)), 0, 1)
    lamp = lots.uniform(40, 200, count, 1, 1, 1) * lots.uniform(0.75, 1.1, count, 3, 1, 1)
    return often * where * lamp


def with_second_strand(
    image: torch.Tensor, coverage: torch.Tensor, which: torch.Tensor, lots: Lots
) -> tuple[torch.Tensor, torch.Tensor]:
    """The crops with those numbers get the thread of other crops laid over them, or their own once more beside it.

    Args:
        coverage: by thread, and where known by needle and instrument, (n, k, s, s): the strand hides these.
    """
    image, coverage = image.clone(), coverage.clone()
    half = len(which) // 2
    beside, crossed = which[:half], which[half:]
    aside = [int(way) for way in lots.rng.choice((-1, 1), 2) * lots.rng.integers(2, 12, 2)]
    others = torch.from_numpy(lots.rng.permutation(len(image))[: len(crossed)]).to(image.device)
    for at, source, shift, turned in ((beside, beside, aside, False), (crossed, others, [0, 0], True)):
        if len(at) == 0:
            continue
        given, covered = image[source], coverage[source][:, :1]
        core = (covered >= CORE).float()
        laid = core * given + (1 - core) * spread(given, core)
        alpha = covered / 255 * (core.sum(dim=(1, 2, 3), keepdim=True) >= LEAST_CORE_PX)
        laid, alpha = (torch.roll(part.rot90(1, (2, 3)) if turned else part, shift, (2, 3)) for part in (laid, alpha))
        shadow = blurred(alpha, lots.uniform(1, 4, len(at)), 8) * lots.uniform(0, 0.6, len(at), 1, 1, 1)
        under = image[at] * (1 - torch.roll(shadow, [int(way) for way in lots.rng.integers(-4, 5, 2)], (2, 3)))
        image[at] = under + alpha * (laid - under)
        left = coverage[at] * (1 - alpha)
        left[:, :1] += 255 * alpha
        coverage[at] = left
    return image, coverage


def _mean_where(values: torch.Tensor, known: torch.Tensor, pixels: torch.Tensor) -> torch.Tensor:
    """The mean of each channel over the pixels that are known, (n, c, 1, 1)."""
    return (values * known).sum(dim=(2, 3), keepdim=True) / torch.clamp(pixels, min=1)[:, None, None, None]
