"""What is no thread and looks like it, or hides it: glints, vessels, blood, tool edges, smoke, laid over crops.

Glints, vessels and blood are laid beneath the thread, since they belong to the tissue; tools lie over it and take it
away, or beneath it as well. Crops are (n, 3, s, s) and their coverage (n, 1, s, s) by thread or (n, 3, s, s) by thread,
needle and instrument, 0 to 255.
"""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import numpy as np
import torch
from torch.nn import functional

from benchmarks.training.blurring import blurred
from benchmarks.training.random_numbers import Lots

Rod = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]
"""Tip (n, 2), the way it goes from there, radius there, and how much that grows on the way."""


def with_glints(image: torch.Tensor, coverage: torch.Tensor, layers: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Light that wet tissue mirrors, over the ground."""
    alpha = _laid(layers, len(image), image.shape[-1], lots) * _bare(coverage)
    white = torch.tensor([250.0, 252.0, 255.0], device=image.device)[:, None, None]
    return image + alpha * (white * lots.uniform(0.85, 1.0, len(image), 1, 1, 1) - image)


def with_vessels(image: torch.Tensor, coverage: torch.Tensor, layers: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Lines that stain the ground, which stays visible in them."""
    count = len(image)
    stain = _laid(layers, count, image.shape[-1], lots) * lots.uniform(0.3, 0.9, count, 1, 1, 1) * _bare(coverage)
    # a stain takes light away, most from blue and green; a pale fibre adds some
    low, high = (
        torch.tensor(part, device=image.device)[:, None, None] for part in ([0.2, 0.15, 0.4], [0.8, 0.7, 0.95])
    )
    dark = low + (high - low) * lots.uniform(0, 1, count, 3, 1, 1)
    pale = lots.uniform(1.1, 1.5, count, 3, 1, 1)
    keep = torch.where(lots.uniform(0, 1, count, 1, 1, 1) < 0.75, dark, pale)
    return torch.clamp(image * (1 + stain * (keep - 1)), 0, 255)


def with_blood(image: torch.Tensor, coverage: torch.Tensor, layers: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Streaks and drops that hide the ground and mirror lamps; most of blood, some of other juices."""
    count, side = len(image), image.shape[-1]
    shape = _laid(layers, count, side, lots)
    light = image.mean(dim=(1, 2, 3), keepdim=True) / 110
    red = torch.cat([lots.uniform(*bounds, count, 1, 1, 1) for bounds in ((2, 55), (0, 45), (50, 175))], dim=1)
    other = lots.uniform(5, 170, count, 3, 1, 1)
    colour = torch.where(lots.uniform(0, 1, count, 1, 1, 1) < 0.8, red, other) * light
    # it stands up over the ground, so that one side of it mirrors the lamp
    height = blurred(shape, lots.uniform(1.0, 3.0, count), 9)
    down, right = (
        functional.pad(part, pad)
        for part, pad in zip(
            (height[:, :, 2:] - height[:, :, :-2], height[..., 2:] - height[..., :-2]),
            ((0, 0, 1, 1), (1, 1, 0, 0)),
            strict=True,
        )
    )
    turn = lots.uniform(0, 2 * np.pi, count, 1, 1, 1)
    slope = (down * torch.sin(turn) + right * torch.cos(turn)) / (height.amax(dim=(2, 3), keepdim=True) * 0.3 + 1e-3)
    shade = torch.clamp(1 + lots.uniform(-0.5, 0.9, count, 1, 1, 1) * slope, 0.3, 1.8)
    narrow = lots.uniform(0.04, 0.25, count, 1, 1, 1)
    glint = torch.exp(-0.5 * ((slope - lots.uniform(0.1, 0.8, count, 1, 1, 1)) / narrow) ** 2)
    patch = functional.interpolate(lots.normal(1.0, count, 1, 20, 20), size=(side, side), mode="bilinear")
    mirrored = (
        glint
        * torch.clamp(patch - lots.uniform(-0.5, 1.5, count, 1, 1, 1), 0, 1)
        * lots.uniform(0, 220, count, 1, 1, 1)
    )
    alpha = shape * lots.uniform(0.6, 1.0, count, 1, 1, 1) * _bare(coverage)
    return torch.clamp(image + alpha * (colour * shade + mirrored - image), 0, 255)


def with_tools(image: torch.Tensor, coverage: torch.Tensor, lots: Lots) -> tuple[torch.Tensor, torch.Tensor]:
    """Shaded rods, cones and jaws, over everything or beneath thread and needle; what they cover shows instrument."""
    count, side = len(image), image.shape[-1]
    tip, turn = lots.uniform(0, side, count, 2), lots.uniform(0, 2 * np.pi, count)
    radius = torch.exp(lots.uniform(np.log(4), np.log(45), count))
    taper = lots.uniform(0, 0.15, count) * (lots.uniform(0, 1, count) < 0.3)
    rods: list[Rod] = [(tip, turn, radius, taper)]
    if lots.rng.uniform() < 0.5:
        # two jaws open from the rod's end
        opening = lots.uniform(0.05, 0.5, count)
        for sign in (-1, 1):
            back = turn + np.pi + sign * opening
            end = tip + 3 * radius[:, None] * torch.stack((torch.cos(back), torch.sin(back)), dim=1)
            rods.append((end, turn + sign * opening, radius / 2.5, torch.full_like(radius, 0.1)))
    steel = lots.uniform(20, 200, count, 1, 1, 1) * (1 + lots.normal(0.05, count, 3, 1, 1))
    is_over = (lots.uniform(0, 1, count, 1, 1, 1) < 0.5).float()
    for rod in rods:
        image, coverage = _with_rod(image, coverage, rod, steel, is_over, lots)
    return image, coverage


def _with_rod(
    image: torch.Tensor, coverage: torch.Tensor, rod: Rod, steel: torch.Tensor, is_over: torch.Tensor, lots: Lots
) -> tuple[torch.Tensor, torch.Tensor]:
    tip, turn, radius, taper = rod
    count, at = len(image), torch.arange(image.shape[-1], device=image.device)
    x, y = at - tip[:, 0, None, None], at[:, None] - tip[:, 1, None, None]
    cosine, sine = torch.cos(turn)[:, None, None], torch.sin(turn)[:, None, None]
    along = x * cosine + y * sine
    wide = radius[:, None, None] + taper[:, None, None] * torch.clamp(along, min=0)
    across = (x * sine - y * cosine) / wide
    # a round end, as steep as the drawing of lots says
    away = torch.hypot(across, torch.clamp(along, max=0) / (wide * lots.uniform(0.05, 1.5, count, 1, 1)))
    alpha = torch.clamp((1 - away) * wide + 0.5, 0, 1)[:, None]
    round_light = torch.sqrt(torch.clamp(1 - away**2, min=0))
    light = lots.uniform(0.1, 0.7, count, 1, 1) + lots.uniform(0.3, 1.0, count, 1, 1) * round_light
    off = (across - lots.uniform(-0.6, 0.6, count, 1, 1)) / lots.uniform(0.03, 0.4, count, 1, 1)
    light = light + lots.uniform(0, 0.8, count, 1, 1) * torch.exp(-0.5 * off**2)
    shadow = blurred(alpha, lots.uniform(2, 10, count), 20) * lots.uniform(0, 0.6, count, 1, 1, 1)
    bare = 1 - (1 - is_over) * _fine(coverage) / 255
    ground = image * (1 - shadow * bare)
    mixed = ground + alpha * bare * (torch.clamp(light[:, None] * steel, 0, 255) - ground)
    fine, instrument = coverage[:, :2] * (1 - alpha * is_over), coverage[:, 2:]
    instrument = instrument * (1 - alpha) + 255 * alpha * bare
    return torch.clamp(mixed, 0, 255), torch.cat((fine, instrument), dim=1)


def with_smoke(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    """A veil of cloudy grey light."""
    count, cells = len(image), int(lots.rng.integers(2, 6))
    cloud = functional.interpolate(lots.uniform(0, 1, count, 1, cells, cells), size=image.shape[-2:], mode="bicubic")
    alpha = torch.clamp(cloud * lots.uniform(0.1, 0.6, count, 1, 1, 1), 0, 0.65)
    return image + alpha * (lots.uniform(140, 230, count, 1, 1, 1) - image)


def _laid(layers: torch.Tensor, count: int, side: int, lots: Lots) -> torch.Tensor:
    """Parts of layers, mirrored and turned, 0 to 1."""
    row, column = (int(part) for part in lots.rng.integers(layers.shape[-1] - side + 1, size=2))
    parts = layers[lots.indices(len(layers), count), :, row : row + side, column : column + side]
    parts = parts.rot90(int(lots.rng.integers(4)), (2, 3))
    return (parts.flip(3) if lots.rng.uniform() < 0.5 else parts).float() / 255


def _bare(coverage: torch.Tensor) -> torch.Tensor:
    """How much of what is beneath everything else is seen, (n, 1, s, s)."""
    around = blurred(coverage.sum(dim=1, keepdim=True), torch.ones(len(coverage), device=coverage.device), 3)
    return 1 - torch.clamp(around / 128, 0, 1)


def _fine(coverage: torch.Tensor) -> torch.Tensor:
    """By thread and needle together, (n, 1, s, s)."""
    return torch.clamp(coverage[:, :2].sum(dim=1, keepdim=True), max=255)
