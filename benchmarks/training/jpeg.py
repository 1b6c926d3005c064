"""What JPEG compression leaves of crops, without the files: blocks of 8 x 8 in coarse steps, colour at half size.

Tables: ITU-T Recommendation T.81, annex K, scaled by quality as the IJG's library does.
"""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

import numpy as np
import torch
from torch.nn import functional

from benchmarks.training.random_numbers import Lots

BLOCK = 8
QUALITY = 40.0, 96.0
LIGHT = (
    (16, 11, 10, 16, 24, 40, 51, 61),
    (12, 12, 14, 19, 26, 58, 60, 55),
    (14, 13, 16, 24, 40, 57, 69, 56),
    (14, 17, 22, 29, 51, 87, 80, 62),
    (18, 22, 37, 56, 68, 109, 103, 77),
    (24, 35, 55, 64, 81, 104, 113, 92),
    (49, 64, 78, 87, 103, 121, 120, 101),
    (72, 92, 95, 98, 112, 100, 103, 99),
)
COLOUR_CORNER = ((17, 18, 24, 47), (18, 21, 26, 66), (24, 26, 56, 99), (47, 66, 99, 99))
"""The steps of all higher waves of colour are 99."""
# of blue, green, red: brightness, and what is more blue and more red than that
TO_COLOURS = ((0.114, 0.587, 0.299), (0.5, -0.331264, -0.168736), (-0.081312, -0.418688, 0.5))


def compressed(image: torch.Tensor, lots: Lots) -> torch.Tensor:
    """Crops (n, 3, s, s), 0 to 255, as they come out of files of some quality each; sides are multiples of 16."""
    quality = lots.uniform(*QUALITY, len(image))
    scale = torch.where(quality < 50, 5000 / quality, 200 - 2 * quality) / 100
    to_colours = torch.tensor(TO_COLOURS, device=image.device)
    parts = torch.einsum("ij,njrc->nirc", to_colours, image)
    light = _in_steps(parts[:, :1] - 128, _steps(LIGHT, scale)) + 128
    colour = _in_steps(functional.avg_pool2d(parts[:, 1:], 2), _steps(_colour_table(), scale))
    whole = torch.cat((light, functional.interpolate(colour, scale_factor=2, mode="bilinear")), dim=1)
    back = torch.tensor(np.linalg.inv(TO_COLOURS), dtype=torch.float32, device=image.device)
    return torch.clamp(torch.einsum("ij,njrc->nirc", back, whole), 0, 255)


def _in_steps(image: torch.Tensor, steps: torch.Tensor) -> torch.Tensor:
    """Each block's waves, rounded to whole steps (n, 8, 8)."""
    count, channels, height, width = image.shape
    waves = torch.from_numpy(_waves()).to(image.device)
    blocks = image.reshape(count, channels, height // BLOCK, BLOCK, width // BLOCK, BLOCK).transpose(3, 4)
    steps = steps[:, None, None, None]
    kept = torch.round(waves @ blocks @ waves.T / steps) * steps
    return (waves.T @ kept @ waves).transpose(3, 4).reshape(count, channels, height, width)


def _steps(table: object, scale: torch.Tensor) -> torch.Tensor:
    steps = torch.tensor(table, dtype=torch.float32, device=scale.device)
    return torch.clamp(torch.floor(steps * scale[:, None, None] + 0.5), 1, 255)


def _colour_table() -> list[list[int]]:
    table = np.full((BLOCK, BLOCK), 99)
    table[:4, :4] = COLOUR_CORNER
    return table.tolist()


def _waves() -> np.ndarray:
    """The discrete cosine transform of 8 values, orthonormal."""
    wave, at = np.arange(BLOCK)[:, None], np.arange(BLOCK)[None]
    basis = np.sqrt(2 / BLOCK) * np.cos((2 * at + 1) * wave * np.pi / (2 * BLOCK))
    basis[0] = np.sqrt(1 / BLOCK)
    return basis.astype(np.float32)
