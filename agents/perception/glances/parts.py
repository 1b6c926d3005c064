"""The parts of both images in the order in which they are glanced at, and how many of them are due."""

from dataclasses import dataclass

from schemas.messages import ThreadObservations

FRAMES_BETWEEN = 10
"""Of the camera: all eight parts take 80 of them, which is less than three seconds. A part costs about half as much as
a followed frame."""
FRAMES_BEFORE = 30
"""Of the camera, after a look at the whole, which has seen all."""
MOST_AT_ONCE = 3
"""Where so many of the camera's frames are left out that more parts are due."""
PARTS = 8
CONTEXT_PX = 48
"""Around a part that is looked at too."""


@dataclass(frozen=True)
class Part:
    """A quarter of one image.

    Fields:
        eye: 0 for the left one, 1 for the right one.
        row, column: of the quarter, 0 or 1.
    """

    eye: int
    row: int
    column: int

    def inner(self, shape: tuple[int, ...]) -> tuple[slice, slice]:
        """Its rows and columns in an image of that shape."""
        return _half(self.row, shape[0]), _half(self.column, shape[1])

    def outer(self, shape: tuple[int, ...]) -> tuple[slice, slice]:
        """The same with what is looked at around it."""
        rows, columns = (
            slice(max(0, side.start - CONTEXT_PX), min(size, side.stop + CONTEXT_PX))
            for side, size in zip(self.inner(shape), shape, strict=False)
        )
        return rows, columns


def _half(which: int, size: int) -> slice:
    return slice(size // 2, size) if which else slice(0, size // 2)


def parts_due(sequence: int, last: ThreadObservations) -> list[Part]:
    """The parts that are glanced at in a frame, the eyes in turn.

    Args:
        sequence: of the frame.
        last: the observations before it.
    """
    if sequence - last.looked_sequence < FRAMES_BEFORE:
        return []
    since = FRAMES_BETWEEN if last.glanced_sequence is None else sequence - last.glanced_sequence
    count = max(0, min(MOST_AT_ONCE, since // FRAMES_BETWEEN))
    numbers = [(last.glances + k) % PARTS for k in range(count)]
    return [Part(number % 2, number // 4, number // 2 % 2) for number in numbers]
