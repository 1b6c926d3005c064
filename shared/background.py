"""Work that is begun in a thread of its own, and asked for later in the same step.

It pays for operations of milliseconds that leave Python's lock alone, as a network's or a matcher's. What comes of it
is the same whenever it ends, since whoever asks for it waits.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import ParamSpec, TypeVar

Given = ParamSpec("Given")
Result = TypeVar("Result")


def begun(function: Callable[Given, Result], *args: Given.args, **options: Given.kwargs) -> Future[Result]:
    """What a pure function will give for these arguments; its `result()` waits, and raises what the function raised."""
    # a thread of its own each time takes a tenth of a millisecond, and nothing is left of it in a process that forks
    thread = ThreadPoolExecutor(1)
    try:
        return thread.submit(function, *args, **options)
    finally:
        thread.shutdown(wait=False)
