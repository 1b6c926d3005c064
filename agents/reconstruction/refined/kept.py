"""Arrays that follow from a few numbers alone: computed once, and given to everybody who asks."""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np

KEPT = 64
"""Of each, for so many arguments."""

_Given = ParamSpec("_Given")
_Array = TypeVar("_Array", bound="np.ndarray[Any, Any]")


def kept(compute: Callable[_Given, _Array]) -> Callable[_Given, _Array]:
    """The same function, computed once for each argument; what was written into it all later frames would get."""

    @functools.wraps(compute)
    def once(*given: _Given.args, **named: _Given.kwargs) -> _Array:
        array = compute(*given, **named)
        array.setflags(write=False)
        return array

    return cast(Callable[_Given, _Array], functools.lru_cache(KEPT)(once))
