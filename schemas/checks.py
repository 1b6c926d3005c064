"""Checks that a message passes once, when it is made: declared shapes, finite numbers, ranges.

The array annotations of a message are its specification. `Float64[np.ndarray, "n 3"]` says the element type,
the number of axes and their lengths; a name such as `n` means the same length wherever it stands in the message.
"""

import copy
import dataclasses
import functools
import math
import typing
from typing import Annotated, Any, NamedTuple

import numpy as np


class Number(NamedTuple):
    """A field's number on the wire, where it is not its place among the fields: what was added since has no default."""

    number: int


UInt32 = Annotated[int, "uint32"]
UInt64 = Annotated[int, "uint64"]
SInt64 = Annotated[int, "sint64"]
"""What a whole number is on the wire, where it is no `int64`."""


class MessageError(ValueError):
    """A message that may not exist: the text names the field, what is wrong with it, and what was expected."""


@functools.cache
def fields_of(message_type: type) -> dict[str, Any]:
    """The fields of a message type with their annotations, in order of declaration."""
    hints = typing.get_type_hints(message_type)
    return {field.name: hints[field.name] for field in dataclasses.fields(message_type)}


@functools.cache
def is_array(annotation: Any) -> bool:
    """Whether an annotation is one of jaxtyping's array types."""
    return hasattr(annotation, "dim_str") and hasattr(annotation, "dtypes")


def without_none(annotation: Any) -> Any:
    """The `X` of `X | None`; any other annotation as it is."""
    inner = _optional(annotation)
    return annotation if inner is None else inner


@functools.cache
def _optional(annotation: Any) -> Any:
    """The `X` of `X | None`, None of any other annotation: equal ones share a cache, and must not be swapped."""
    parts = typing.get_args(annotation)
    return next(part for part in parts if part is not type(None)) if type(None) in parts else None


@functools.cache
def _specification(message_type: type) -> tuple[tuple[str, str, Any, bool, bool], ...]:
    """Name, place in words, declared type, whether it may be None, and whether it is an array, of every field."""
    declared = ((name, annotation, without_none(annotation)) for name, annotation in fields_of(message_type).items())
    return tuple(
        (name, f"{message_type.__name__}.{name}", inner, inner is not annotation, is_array(inner))
        for name, annotation, inner in declared
    )


@functools.cache
def _holds(dtype: np.dtype, declared: Any) -> bool:
    return dtype.name in declared.dtypes


@functools.cache
def _axes(dim_str: str) -> tuple[tuple[str, int | None], ...]:
    """Each axis with its length, where that is given."""
    return tuple((axis, int(axis) if axis.isdigit() else None) for axis in dim_str.split())


def check_message(message: Any) -> None:
    """Check every field of a frozen message against its annotation and make its arrays read-only.

    Raises:
        MessageError: naming the first field that does not fit.
    """
    sizes: dict[str, int] = {}
    for name, where, declared, optional, array in _specification(type(message)):
        value = getattr(message, name)
        if value is None:
            if not optional:
                raise MessageError(f"{where} is missing")
            continue
        if array:
            object.__setattr__(message, name, _checked_array(where, value, declared, sizes))
        elif declared is float:
            _check_finite_number(where, value)


def with_consumed(message: Any, consumed: tuple[Any, ...]) -> Any:
    """A message that was checked when it was made, with the list of what it was made from: nothing is checked again."""
    listed = copy.copy(message)
    object.__setattr__(listed, "consumed", consumed)
    return listed


def require(condition: bool, message: str) -> None:
    """Raise a MessageError with that text unless the condition holds."""
    if not condition:
        raise MessageError(message)


def _check_finite_number(where: str, value: Any) -> None:
    if not (isinstance(value, float | int) and math.isfinite(value)):
        raise MessageError(f"{where} must be a finite number, not {value!r}")


def _checked_array(where: str, value: Any, declared: Any, sizes: dict[str, int]) -> np.ndarray:
    # the texts are made for what is wrong alone: messages come a hundred times a second
    if not isinstance(value, np.ndarray):
        raise MessageError(f"{where} must be a NumPy array, not {type(value).__name__}")
    if not _holds(value.dtype, declared):
        raise MessageError(f"{where} must hold {declared.dtypes[0]}, not {value.dtype.name}")
    _check_shape(where, value.shape, declared.dim_str, sizes)
    if value.dtype.kind == "f" and not np.isfinite(value).all():
        raise MessageError(f"{where} must be finite, but holds NaN or infinity")
    view = np.ascontiguousarray(value).view()
    view.flags.writeable = False
    return view


def _check_shape(where: str, shape: tuple[int, ...], dim_str: str, sizes: dict[str, int]) -> None:
    axes = _axes(dim_str)
    if len(shape) != len(axes):
        raise MessageError(f"{where} must have shape ({', '.join(dim_str.split())}), not {shape}")
    for (axis, given), length in zip(axes, shape, strict=True):
        expected = sizes.setdefault(axis, length) if given is None else given
        if length != expected:
            needed = ", ".join(dim_str.split())
            raise MessageError(f"{where} has shape {shape} where ({needed}) needs {axis} = {expected}")
