"""How far two messages of one type are apart, field by field.

A rule may say how a field is measured, how much it may differ, or why it is left out. Without one a field is compared
as it is: numbers and arrays by their largest difference, all else by whether it is equal.
"""

import dataclasses
import enum
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

OTHER = math.inf
"""The difference between what no number tells apart: another word, another shape, or something beside nothing."""

Measure = Callable[[Any, Any], float]


@dataclass(frozen=True)
class Rule:
    """How one field of a message type is compared.

    Fields:
        tolerance: the largest difference that counts as none, in `unit`.
        measure: the difference of the two values; of the two whole messages where the rule's name is that of no field.
        ignored: why the field is not compared; empty where it is.
        told: what of a whole message is measured, in words, for where no number tells two apart.
    """

    tolerance: float = 0.0
    unit: str = ""
    measure: Measure | None = None
    ignored: str = ""
    told: Callable[[Any], str] | None = None


Rules = Mapping[str, Rule]
"""By field, such as `stamp.sequence`; what holds for a field holds for all below it."""

AS_IT_IS = Rule()


class Difference(NamedTuple):
    """How far one field differs, in the unit of its rule; 0 where it is the same.

    Fields:
        words: what it was and is, where no number tells the two apart and words do.
    """

    field: str
    amount: float
    words: str = ""


def differences(then: Any, now: Any, rules: Rules) -> Iterator[Difference]:
    """Every field that is compared, with how far it differs; both messages are of one type."""
    names = {f.name for f in dataclasses.fields(then)}
    for name, rule in rules.items():
        if rule.measure is not None and name.partition(".")[0] not in names:
            amount = rule.measure(then, now)
            told = rule.told if amount == OTHER else None
            yield Difference(name, amount, f"{told(then)} → {told(now)}" if told else "")
    yield from _of_fields("", then, now, rules)


def _of_fields(prefix: str, then: Any, now: Any, rules: Rules) -> Iterator[Difference]:
    for field in dataclasses.fields(then):
        path = f"{prefix}{field.name}"
        rule = rules.get(path, AS_IT_IS)
        if rule.ignored:
            continue
        a, b = getattr(then, field.name), getattr(now, field.name)
        if rule.measure is not None:
            yield Difference(path, rule.measure(a, b), _words(a, b))
        elif dataclasses.is_dataclass(a) and dataclasses.is_dataclass(b):
            yield from _of_fields(f"{path}.", a, b, rules)
        else:
            yield Difference(path, apart(a, b), _words(a, b))


def _words(a: Any, b: Any) -> str:
    """Both values, where each is a word, a truth or nothing, and they differ; what else there is beside nothing.

    Of lists, how many each holds, where that differs.
    """
    if (a is None) != (b is None):
        return f"{_word(a)} → {_word(b)}"
    if all(isinstance(value, tuple | np.ndarray) for value in (a, b)) and len(a) != len(b):
        return f"{len(a)} → {len(b)} of them"
    if not all(isinstance(value, str | bool | enum.Enum | None) for value in (a, b)) or a == b:
        return ""
    return f"{_word(a)} → {_word(b)}"


def _word(value: Any) -> str:
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if value is None:
        return "nothing"
    if isinstance(value, str | bool | int | float):
        return str(value) or "nothing"
    held = (getattr(value, f.name) for f in dataclasses.fields(value)) if dataclasses.is_dataclass(value) else ()
    return next((one.name.lower() for one in held if isinstance(one, enum.Enum)), "something")


def apart(a: Any, b: Any) -> float:
    """The largest difference of two values of any kind that messages have."""
    if isinstance(a, tuple) and isinstance(b, tuple):
        same_length = len(a) == len(b)
        return max((apart(x, y) for x, y in zip(a, b, strict=True)), default=0.0) if same_length else OTHER
    if dataclasses.is_dataclass(a) and dataclasses.is_dataclass(b):
        return max((d.amount for d in _of_fields("", a, b, {})), default=0.0)
    if _is_number(a) and _is_number(b):
        return abs(float(a - b)) if a != b else 0.0
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return _arrays_apart(a, b)
    if a is None or b is None:
        return 0.0 if a is b else OTHER
    return 0.0 if a == b else OTHER


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool | enum.Enum)


def _arrays_apart(a: np.ndarray, b: np.ndarray) -> float:
    if a.shape != b.shape:
        return OTHER
    difference = np.abs(a.astype(np.float64) - b.astype(np.float64))
    return float(difference[~((a == b) | (np.isnan(a) & np.isnan(b)))].max(initial=0.0))
