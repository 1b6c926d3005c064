"""What the page's server is given by whoever starts it, since it knows no other agent itself."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from agents.operator.load import Processors, processors
from agents.operator.pictures import Resample
from schemas.messages import StereoCalibration


class Recording(Protocol):
    """A recording that can be begun and ended from the page."""

    def told(self) -> dict[str, Any]:
        """`on`, `can` (the page may begin or end it), `lacks` (something), and `text`: all that in words."""
        ...

    def set(self, on: bool) -> str:
        """Begin or end it; why that is not possible, or nothing. May take seconds."""
        ...


class Trials(Protocol):
    """The list of goals of an experiment, and what came of each."""

    def told(self) -> dict[str, Any]:
        """`next` (thread, s, policy), `left`, `tried`, `causes` and `text`."""
        ...

    def begin(self) -> tuple[float, str]:
        """Place and policy of the next goal.

        Raises:
            RuntimeError: where nothing is left, or nothing can be written.
        """
        ...

    def judged(self, plan: dict[str, Any], held: bool, cause: str, note: str, took_s: float | None) -> str:
        """Write down what came of it; in words.

        Raises:
            RuntimeError: where it cannot be written.
        """
        ...


@dataclass(frozen=True)
class Surroundings:
    """The rig as the page's server sees it.

    Fields:
        arms: by name, as configured.
        audit: writes down a press, before anything follows from it; raises a RuntimeError where it cannot.
        resample: what rectifies the left image; None where it comes rectified.
        processors: how much time this host's had, and how much of it nobody took.
        wellbeing: agents and what is wrong, as `suturegrasp status` tells it.
    """

    rig: str
    arms: tuple[str, ...]
    audit: Callable[..., None]
    resample: Callable[[StereoCalibration], Resample | None] = lambda _calibration: None
    processors: Callable[[], Processors | None] = processors
    wellbeing: Callable[[], dict[str, Any]] = field(default=dict)
    recording: Recording | None = None
    trials: Trials | None = None
