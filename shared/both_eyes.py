"""The same work for both eyes at once, on two cores.

It pays where single operations take milliseconds, as when an image is coded or segmented. Where they take microseconds,
as along centrelines, two threads wait for Python's lock more than they work, and both eyes take longer than one after
the other: twice the time of the processor, and a third more of the clock's.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

Result = TypeVar("Result")


def of_both(function: Callable[..., Result], left: tuple[Any, ...], right: tuple[Any, ...]) -> tuple[Result, Result]:
    """What a pure function gives for the arguments of the left and of the right eye.

    Raises:
        Exception: whatever the function raises for either.
    """
    # a thread of its own each time takes a tenth of a millisecond, and nothing is left of it in a process that forks
    with ThreadPoolExecutor(1) as other:
        of_right = other.submit(function, *right)
        of_left = function(*left)
        return of_left, of_right.result()
