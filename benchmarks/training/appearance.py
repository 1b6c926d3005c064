"""Other looks of what scenes hold: ground of any colour and texture, worn or dark steel, light that falls off to black.

Crops are (n, 3, s, s), blue first, and their coverage by thread, needle and instrument (n, 3, s, s), 0 to 255. The
thread's own colour is drawn anew elsewhere (`dyeing`).
"""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import torch
from torch.nn import functional

from benchmarks.training.random_numbers import Lots

BEHIND_PX = 8
"""How far the ground's detail is told from its light."""
DARKEST = 0.06
"""Of the light that was: where there is less, nothing is seen that could be learned."""


def with_other_ground(image: torch.Tensor, coverage: torch.Tensor, lots: Lots) -> torch.Tensor:
    """The ground's light and part of its detail, in another colour: beige, grey, blue or whatever."""
    count = len(image)
    grey = image.mean(dim=1, keepdim=True)
    usual = torch.clamp(grey.mean(dim=(2, 3), keepdim=True), min=10)
    contrast = lots.uniform(0.4, 1.4, count, 1, 1, 1)
    light = torch.clamp(grey / usual, 0.05, 4) ** contrast
    colour = _any_colour(count, lots)
    new = torch.clamp(light * colour, 0, 255)
    # at times some of the old colour stays
    share = torch.clamp(lots.uniform(0.3, 1.4, count, 1, 1, 1), max=1)
    return image + share * _ground(coverage) * (new - image)


def with_other_texture(image: torch.Tensor, coverage: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Pores, grain, weave and ridges on the ground, or its own detail fainter or stronger."""
    count, side = len(image), image.shape[-1]
    wide = functional.interpolate(functional.avg_pool2d(image, BEHIND_PX), size=(side, side), mode="bilinear")
    changed = wide + torch.exp(lots.uniform(-1.2, 0.6, count, 1, 1, 1)) * (image - wide)
    stain = torch.zeros((count, 1, side, side), device=image.device)
    for fewest, most in ((3, 12), (16, 48), (64, side // 2)):
        cells = int(lots.rng.integers(fewest, most))
        field = lots.normal(1.0, count, 1, cells, cells) * torch.clamp(lots.uniform(-0.15, 0.25, count, 1, 1, 1), min=0)
        stain = stain + functional.interpolate(field, size=(side, side), mode="bilinear")
    stain = stain + _ridges(image, lots)
    tint = 1 + lots.normal(0.3, count, 3, 1, 1)
    return image + _ground(coverage) * (torch.clamp(changed * torch.exp(stain * tint), 0, 255) - image)


def with_other_steel(image: torch.Tensor, coverage: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Instruments and needles darker or brighter, harder or softer in their light, tinted a little."""
    for kind in (1, 2):
        count = len(image)
        gain = torch.exp(lots.normal(0.5, count, 1, 1, 1)) * (1 + lots.normal(0.08, count, 3, 1, 1))
        curved = 255 * gain * torch.clamp(image / 255, 0, 1) ** torch.exp(lots.normal(0.35, count, 1, 1, 1))
        image = image + coverage[:, kind : kind + 1] / 255 * (torch.clamp(curved, 0, 255) - image)
    return image


def with_other_light(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Light that falls off around a spot, or from one side to the other, and soft shadows."""
    count, side = len(image), image.shape[-1]
    at = (torch.arange(side, device=image.device) + 0.5) / side
    x, y = (lots.uniform(-0.5, 1.5, count, 1, 1) for _ in range(2))
    away = (at - x) ** 2 + (at[:, None] - y) ** 2
    spot = torch.exp(-away / (2 * lots.uniform(0.35, 1.6, count, 1, 1) ** 2))
    turn = lots.uniform(0, 2 * torch.pi, count, 1, 1)
    along = (at - 0.5) * torch.cos(turn) + (at[:, None] - 0.5) * torch.sin(turn)
    light = spot * torch.exp(lots.normal(0.7, count, 1, 1) * along)
    cells = int(lots.rng.integers(3, 9))
    cloud = functional.interpolate(lots.normal(1.0, count, 1, cells, cells), size=(side, side), mode="bicubic")
    dark = torch.clamp(lots.uniform(-0.5, 0.8, count, 1, 1, 1), min=0)
    shadow = 1 - dark * torch.sigmoid(lots.uniform(2, 12, count, 1, 1, 1) * (cloud - 0.5))
    # a camera's gain follows the light
    gain = torch.exp(lots.uniform(0.0, 0.7, count, 1, 1, 1))
    shown = torch.clamp(light[:, None] * shadow, min=DARKEST)
    return torch.clamp(image * shown * gain, 0, 255)


def with_other_order(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    """The three channels in another order: colours as no scene has them."""
    return image[:, lots.rng.permutation(3).tolist()]


def _ridges(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Parallel bands as of a weave or of a printed pad, in some of the crops."""
    count, side = len(image), image.shape[-1]
    at = torch.arange(side, device=image.device)
    turn, period = lots.uniform(0, torch.pi, count, 1, 1), torch.exp(lots.uniform(1.0, 4.2, count, 1, 1))
    along = at * torch.cos(turn) + at[:, None] * torch.sin(turn)
    wave = torch.sin(2 * torch.pi * along / period + lots.uniform(0, 6, count, 1, 1))
    sharp = torch.tanh(lots.uniform(0.5, 5, count, 1, 1) * (wave - lots.uniform(-0.8, 0.8, count, 1, 1)))
    return (torch.clamp(lots.uniform(-0.6, 0.3, count, 1, 1), min=0) * sharp)[:, None]


def _any_colour(count: int, lots: Lots) -> torch.Tensor:
    """Mostly pale, at times strong, (n, 3, 1, 1)."""
    strength = lots.uniform(0, 1, count, 1, 1, 1) ** 2
    value = 255 * lots.uniform(0.08, 0.95, count, 1, 1, 1)
    return value * (1 - strength * lots.uniform(0, 1, count, 3, 1, 1))


def _ground(coverage: torch.Tensor) -> torch.Tensor:
    """How much of each pixel is ground, 0 to 1, (n, 1, s, s)."""
    return torch.clamp(1 - coverage.sum(dim=1, keepdim=True) / 255, 0, 1)
