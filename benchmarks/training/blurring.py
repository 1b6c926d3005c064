"""Crops as tensors (n, c, h, w), blurred each by its own width or along its own line."""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import torch
from torch.nn import functional


def blurred(image: torch.Tensor, sigma_px: torch.Tensor, reach_px: int) -> torch.Tensor:
    """Each crop blurred by a Gaussian of its own width; mirrored at the border."""
    away = torch.arange(-reach_px, reach_px + 1, device=image.device)
    weight = torch.exp(-0.5 * (away / sigma_px[:, None]) ** 2)
    weight = weight / weight.sum(dim=1, keepdim=True)
    column = _filtered(image, weight[:, :, None])
    return _filtered(column, weight[:, None, :])


def moved(image: torch.Tensor, length_px: torch.Tensor, turn: torch.Tensor, reach_px: int) -> torch.Tensor:
    """Each crop smeared evenly along a line of its own length and direction."""
    away = torch.arange(-reach_px, reach_px + 1, device=image.device, dtype=torch.float32)
    y, x = away[:, None], away[None, :]
    cosine, sine = torch.cos(turn)[:, None, None], torch.sin(turn)[:, None, None]
    along, across = x * cosine + y * sine, y * cosine - x * sine
    weight = torch.clamp(length_px[:, None, None] / 2 + 0.5 - along.abs(), 0, 1) * torch.clamp(1 - across.abs(), 0, 1)
    return _filtered(image, weight / weight.sum(dim=(1, 2), keepdim=True))


def spread(values: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """What is known about (n, 1, h, w), blurred widely into what is not; sides are multiples of 4."""
    weighed = functional.avg_pool2d(torch.cat((values * known, known), dim=1), 4)
    # four pixels are one there
    wide = blurred(weighed, torch.full((len(values),), 1.5, device=values.device), 4)
    wide = functional.interpolate(wide, scale_factor=4, mode="bilinear", align_corners=False)
    return wide[:, :-1] / torch.clamp(wide[:, -1:], min=1e-3)


def _filtered(image: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Each crop by its own kernel (n, r, c), whose sides are odd."""
    count, channels, height, width = image.shape
    rows, columns = weight.shape[1:]
    padded = functional.pad(image, (columns // 2, columns // 2, rows // 2, rows // 2), mode="reflect")
    kernels = weight.repeat_interleave(channels, dim=0)[:, None]
    flat = padded.reshape(1, count * channels, *padded.shape[2:])
    return functional.conv2d(flat, kernels, groups=count * channels).reshape(count, channels, height, width)
