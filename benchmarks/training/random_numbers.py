"""The random numbers of a training: of counts and choices, and of what lies on the device that trains."""
# pyright: reportMissingImports=false
# PyTorch is there for training alone (extra `train`), so that the checks of everyone else run without it.

from dataclasses import dataclass

import numpy as np
import torch


@dataclass(frozen=True)
class Lots:
    """Two sources that a seed begins: NumPy's for choices, whose counts must be known at once; the device's for values.

    The same seed gives the same numbers on the same kind of device.
    """

    rng: np.random.Generator
    generator: torch.Generator

    @property
    def device(self) -> torch.device:
        """Where the values lie."""
        return self.generator.device

    def uniform(self, low: float, high: float, *shape: int) -> torch.Tensor:
        """Values on the device, alike anywhere between two bounds."""
        return low + (high - low) * torch.rand(shape, generator=self.generator, device=self.device)

    def normal(self, deviation: float, *shape: int) -> torch.Tensor:
        """Normally distributed values on the device, about 0."""
        return deviation * torch.randn(shape, generator=self.generator, device=self.device)

    def indices(self, below: int, *shape: int) -> torch.Tensor:
        """Whole numbers on the device from 0."""
        return torch.randint(below, shape, generator=self.generator, device=self.device)

    def some(self, count: int, share: float) -> torch.Tensor:
        """Numbers of a share of so many crops, all different, without waiting for the device."""
        wanted = int(share * count + self.rng.uniform())
        return torch.from_numpy(self.rng.permutation(count)[:wanted]).to(self.device)


def lots_of(seed: int, device: torch.device) -> Lots:
    """The random numbers that a seed begins."""
    generator = torch.Generator(device)
    generator.manual_seed(seed)
    return Lots(np.random.default_rng([seed, 21]), generator)
