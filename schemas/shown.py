"""What a message shows on the timeline, told by the message itself and without Rerun.

A message that is `Shows` is drawn by the viewer with no line of its own there: its curves and places in space and over
both images, its figures as curves over time, its state as a lane, and its sentence in the log.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from schemas.messages.imaging import RectifiedStereo


@dataclass(frozen=True)
class Shown:
    """What is to be seen of a message, by name; in the camera frame and its calibration's unit.

    Fields:
        curves: points along each.
        places: points, each with its covariance.
        figures: what is worth a curve over time.
        state: such as `ok`, `failed` or `lost`.
        sentence: said in the log as often as the state changes; empty for nothing.
    """

    curves: Mapping[str, Float64[np.ndarray, "n 3"]] = field(default_factory=dict)
    places: Mapping[str, tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3 3"]]] = field(default_factory=dict)
    figures: Mapping[str, float] = field(default_factory=dict)
    state: str = ""
    sentence: str = ""


class Shows(ABC):
    """A message that says what it shows."""

    camera: RectifiedStereo

    @abstractmethod
    def shown(self) -> Shown:
        """What is to be seen of it. What is not in it any more, though it was before, has no points."""
