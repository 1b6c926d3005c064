"""The parts of both images in the order in which they are glanced at."""

from dataclasses import dataclass

from schemas.messages import ThreadObservations

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


def next_part(last: ThreadObservations) -> Part:
    """The part that is glanced at next, the eyes in turn."""
    number = last.glances % PARTS
    return Part(number % 2, number // 4, number // 2 % 2)
