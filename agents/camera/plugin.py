"""Cameras that others have written a source for, as a package of their own (docs/extending.md)."""

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from typing import Any, Protocol

import numpy as np

from agents.camera.sources import Pair, SourceError
from shared.clock import now_ns

GROUP = "suturegrasp.camera_sources"
"""The group of entry points that names what opens a camera."""
Stamped = tuple[np.ndarray, np.ndarray, int, int]
"""Left and right image (BGR, uint8, (h, w, 3)), and when each was captured, in ns since 1970."""


class StampedSource(Protocol):
    """What an entry point opens.

    Fields:
        size: width and height of one eye's image.
    """

    size: tuple[int, int]

    def read(self) -> Stamped | None:
        """The newest pair; None where no new one is there yet. May wait for one, but not for longer than a second."""
        ...

    def close(self) -> None:
        """Let go of the camera."""
        ...


class PluginSource:
    """A source whose pairs carry times of their own, such as those of cameras whose clocks follow PTP."""

    def __init__(self, name: str, options: Mapping[str, Any]) -> None:
        """Open the source that is installed under a name.

        Raises:
            SourceError: where none is, or it cannot be opened.
        """
        self._name, self.taken_ns = name, (0, 0)
        try:
            self._source = _installed(name)(dict(options))
            width, height = self._source.size
        except SourceError:
            raise
        except Exception as error:
            raise SourceError(f"camera.plugin {name!r} does not open: {type(error).__name__}: {error}") from error
        self._size = int(width), int(height)

    def size(self) -> tuple[int, int]:
        """Width and height of one eye's image."""
        return self._size

    def read(self) -> Pair | None:
        """The next pair.

        Raises:
            SourceError: where the plugin fails, or gives what is no pair.
        """
        asked_ns = now_ns()
        try:
            stamped = self._source.read()
        except Exception as error:
            raise SourceError(f"camera.plugin {self._name!r}: {type(error).__name__}: {error}") from error
        if stamped is None:
            return None
        left, right, left_ns, right_ns = stamped
        for side, image in (("left", left), ("right", right)):
            shape, kind = np.shape(image), getattr(image, "dtype", type(image).__name__)
            if shape != (self._size[1], self._size[0], 3) or kind != np.uint8:
                wanted = f"uint8 of shape ({self._size[1]}, {self._size[0]}, 3)"
                raise SourceError(
                    f"camera.plugin {self._name!r}: the {side} image is {kind} of shape {shape}, not {wanted}"
                )
        ahead_s = (max(int(left_ns), int(right_ns)) - now_ns()) * 1e-9
        if ahead_s > 0:
            # an image that looks newer than it is would look recent enough to move an arm by
            clock = f"the clock of its camera is {ahead_s:.3f} s or more ahead of this machine's"
            raise SourceError(f"camera.plugin {self._name!r}: {clock}; synchronise both, by PTP or chrony")
        self.taken_ns = int(left_ns) - asked_ns, int(right_ns) - asked_ns
        return left, right

    def close(self) -> None:
        """Let go of the camera."""
        self._source.close()


def _installed(name: str) -> Callable[[dict[str, Any]], StampedSource]:
    found = {entry.name: entry for entry in entry_points(group=GROUP)}
    if name not in found:
        there = ", ".join(sorted(found)) or "none"
        raise SourceError(f"camera.plugin {name!r} is not installed here; installed under {GROUP}: {there}")
    return found[name].load()
