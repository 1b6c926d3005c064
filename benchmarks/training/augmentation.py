"""Variations of crops that keep what is thread: dye and ground; light and colour; lens, motion and sensor.

Crops are (n, 3, s, s), blue first, and their coverage by thread, needle and instrument (n, 3, s, s), 0 to 255, on any
device: all of a batch is varied at once.
"""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

from collections.abc import Iterator

import torch

from benchmarks.training.appearance import (
    with_other_ground,
    with_other_light,
    with_other_order,
    with_other_steel,
    with_other_texture,
)
from benchmarks.training.blurring import blurred, moved
from benchmarks.training.clutter import with_blood, with_glints, with_smoke, with_tools, with_vessels
from benchmarks.training.drawn_layers import Layers
from benchmarks.training.dyeing import with_other_dye, with_second_strand
from benchmarks.training.jpeg import compressed
from benchmarks.training.random_numbers import Lots

DYED_SHARE, STRANDS_SHARE = 0.6, 0.15
VESSELS_SHARE, BLOOD_SHARE, GLINTS_SHARE, TOOLS_SHARE, SMOKE_SHARE = 0.3, 0.3, 0.3, 0.25, 0.1
GROUND_SHARE, TEXTURE_SHARE, STEEL_SHARE, LIGHT_SHARE, ORDER_SHARE = 0.3, 0.3, 0.4, 0.3, 0.15
GREY_SHARE, INTERLACED_SHARE, MOVED_SHARE = 0.05, 0.06, 0.12


def varied(
    image: torch.Tensor, coverage: torch.Tensor, lots: Lots, layers: Layers, red_share: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """The crops, varied in everything but their size and place."""
    image = _with_other_looks(image, coverage, lots)
    for few in _some(image, DYED_SHARE, lots):
        image[few] = with_other_dye(image[few], coverage[few][:, :1], red_share, lots)
    for few in _some(image, STRANDS_SHARE, lots):
        image, coverage = with_second_strand(image, coverage, few, lots)
    for share, clutter, drawn in (
        (VESSELS_SHARE, with_vessels, layers.vessels),
        (BLOOD_SHARE, with_blood, layers.blood),
        (GLINTS_SHARE, with_glints, layers.glints),
    ):
        for few in _some(image, share, lots):
            image[few] = clutter(image[few], coverage[few], drawn, lots)
    for few in _some(image, TOOLS_SHARE, lots):
        image[few], coverage[few] = with_tools(image[few], coverage[few], lots)
    for few in _some(image, LIGHT_SHARE, lots):
        image[few] = with_other_light(image[few], lots)
    image = _recoloured(image, lots)
    for few in _some(image, SMOKE_SHARE, lots):
        image[few] = with_smoke(image[few], lots)
    for few in _some(image, INTERLACED_SHARE, lots):
        shift = int(lots.rng.integers(1, 4))
        for part in (image, coverage):
            # odd rows are seen a little later than even ones
            part[few, :, 1::2] = torch.roll(part[few, :, 1::2], shift, 3)
    return _seen_by_sensor(image, lots), coverage


def _with_other_looks(image: torch.Tensor, coverage: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Ground, its texture, and steel, each in some crops; in a few the channels change places."""
    for share, change in (
        (GROUND_SHARE, with_other_ground),
        (TEXTURE_SHARE, with_other_texture),
        (STEEL_SHARE, with_other_steel),
    ):
        for few in _some(image, share, lots):
            image[few] = change(image[few], coverage[few], lots)
    for few in _some(image, ORDER_SHARE, lots):
        image[few] = with_other_order(image[few], lots)
    return image


def _some(image: torch.Tensor, share: float, lots: Lots) -> Iterator[torch.Tensor]:
    """The numbers of a share of the crops; nothing, where that is none."""
    few = lots.some(len(image), share)
    if len(few):
        yield few


def _recoloured(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Another lamp, white balance, exposure and tone curve; another hue of everything; colours stronger or weaker."""
    count = len(image)
    for few in _some(image, 0.5, lots):
        image[few] = _other_hue(image[few], lots)
    for few in _some(image, GREY_SHARE, lots):
        image[few] = image[few].mean(dim=1, keepdim=True).expand(-1, 3, -1, -1)
    gain = torch.exp(lots.normal(0.12, count, 3, 1, 1) + lots.normal(0.15, count, 1, 1, 1))
    gamma, lift = torch.exp(lots.normal(0.22, count, 1, 1, 1)), lots.uniform(-0.04, 0.06, count, 1, 1, 1)
    curved = gain * torch.clamp(image / 255, 0, 1) ** gamma + lift
    return 255 * torch.clamp(curved, 0, 1)


def _other_hue(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Colours turned about grey, and drawn towards it or away."""
    count = len(image)
    turn, strength = lots.normal(0.28, count, 1), torch.exp(lots.normal(0.35, count, 1))
    grey = torch.full((3, 3), 1 / 3, device=image.device)
    # of a turn about the axis of greys: the part in its plane, and the part across
    plane = torch.eye(3, device=image.device) - grey
    across = torch.tensor([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]], device=image.device) / 3**0.5
    mixed = strength[..., None] * (torch.cos(turn)[..., None] * plane + torch.sin(turn)[..., None] * across) + grey
    return torch.clamp(torch.einsum("nij,njrc->nirc", mixed, image), 0, 255)


def _seen_by_sensor(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Out of focus or moved, noisy, sharpened and compressed, each at times."""
    for share, change in (
        (0.5, _out_of_focus),
        (MOVED_SHARE, _moved),
        (0.6, _noisy),
        (0.2, _sharpened),
        (0.4, compressed),
    ):
        for few in _some(image, share, lots):
            image[few] = change(image[few], lots)
    return torch.clamp(image, 0, 255).round()


def _out_of_focus(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    return blurred(image, lots.uniform(0.3, 1.4, len(image)), 4)


def _moved(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    return moved(image, lots.uniform(2, 11, len(image)), lots.uniform(0, torch.pi, len(image)), 6)


def _noisy(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    count = len(image)
    read, shot = lots.uniform(0, 6, count, 1, 1, 1), lots.uniform(0, 9, count, 1, 1, 1)
    grain = lots.normal(1.0, *image.shape)
    for smooth in _some(image, 0.3, lots):
        # video smooths its noise
        grain[smooth] = 1.8 * blurred(grain[smooth], torch.full((len(smooth),), 0.7, device=image.device), 2)
    return torch.clamp(image + torch.sqrt(read**2 + shot**2 * image / 255) * grain, 0, 255)


def _sharpened(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    amount = lots.uniform(0.2, 1.0, len(image), 1, 1, 1)
    wide = blurred(image, torch.full((len(image),), 1.2, device=image.device), 4)
    return torch.clamp(image + amount * (image - wide), 0, 255)
