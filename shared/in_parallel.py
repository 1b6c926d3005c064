"""The same work for both eyes at once, on two cores.

It pays where single operations take milliseconds, as when an image is coded or segmented. Where they take microseconds,
as along centrelines, two threads wait for Python's lock more than they work, and both eyes take longer than one after
the other: twice the time of the processor, and a third more of the clock's.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from shared.background import begun

Result = TypeVar("Result")


def of_both(function: Callable[..., Result], left: tuple[Any, ...], right: tuple[Any, ...]) -> tuple[Result, Result]:
    """What a pure function gives for the arguments of the left and of the right eye.

    Raises:
        Exception: whatever the function raises for either.
    """
    of_right = begun(function, *right)
    of_left = function(*left)
    return of_left, of_right.result()
