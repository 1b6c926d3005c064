"""What replayed outputs say differently from recorded ones: a row for each field, and the course of it over time."""

import dataclasses
import functools
import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from agents.replay.compare import AS_IT_IS, OTHER, Difference, Rule, Rules, differences
from agents.replay.tolerances import exact, tolerant
from schemas.codec import decode
from schemas.messages import FrameStamp, GraspPlan, Status
from schemas.topics import TOPICS, topic_of
from shared.runtime.replay import Replayed

FIGURES = re.compile(r"\d+(\.\d+)?")


class At(NamedTuple):
    """When an output was recorded, and the frame it descends from, if any."""

    published_ns: int
    capture_ns: int | None
    frame: int | None


@dataclass(frozen=True)
class Compared:
    """One output beside what it is now: by how much each field differs, of those that do.

    Fields:
        became: its status with the reason, or its plan, then and now, where they differ.
        turned: whether it failed then or now and not both times, so that all else in it follows and is not compared.
        untold: fields that are empty as another version made it, which may not have known them.
    """

    topic: str
    at: At
    is_same: bool
    fields: tuple[Difference, ...] = ()
    became: str = ""
    turned: bool = False
    untold: tuple[str, ...] = ()


@dataclass(frozen=True)
class Row:
    """How one field differs over all outputs of a topic.

    Fields:
        messages: outputs that were compared, those of equal bytes included.
        beyond: of them, those that differ by more than the tolerance.
        median, worst: over all of them, in the rule's unit; infinite where no number tells the two apart.
        where: of the worst one.
        words: what the worst one was and is, where words tell the two apart.
    """

    topic: str
    field: str
    rule: Rule
    messages: int
    beyond: int
    median: float
    worst: float
    where: At
    words: str = ""


@dataclass(frozen=True)
class Comparison:
    """What was compared, and what differs.

    Fields:
        outputs: in the order in which they were replayed.
        made_no_more: outputs that were recorded, and that the replay does not make of the same.
        unrecorded: outputs that the replay makes and that were not recorded.
    """

    outputs: tuple[Compared, ...]
    rows: tuple[Row, ...]
    made_no_more: int
    unrecorded: int

    @property
    def is_same(self) -> bool:
        """Whether nothing differs by more than its tolerance."""
        return not (
            self.made_no_more
            or self.unrecorded
            or any(row.beyond for row in self.rows)
            or any(output.turned for output in self.outputs)
        )


def compared(
    outputs: Iterable[Replayed], published_ns: Callable[[Replayed], int], exactly: bool, of_another: bool = False
) -> Comparison:
    """Compare what was replayed with what was recorded; what could not be repeated is left out.

    Exactly: nothing may differ, not a byte; otherwise within the tolerances for other versions and settings.
    Of another: another version made them, which may not have known every field.

    Raises:
        MessageError: where a recorded output cannot be read.
    """
    rules = functools.cache(exact if exactly else tolerant)
    found: list[Compared] = []
    made_no_more = unrecorded = 0
    for output in outputs:
        unrecorded += output.unrecorded
        if output.missing:
            continue
        if output.now is None:
            made_no_more += 1
            continue
        topic = topic_of(output.key)
        # what is the same is decoded too: a curve of differences needs its time
        then = decode(topic.message, output.then)
        now = then if output.same else decode(topic.message, output.now)
        turned = (getattr(then, "status", None) is Status.FAILED) != (getattr(now, "status", None) is Status.FAILED)
        fields = () if output.same or turned else _differences(then, now, rules(topic.message), exactly)
        empty = _empty(then) if of_another and not exactly else set[str]()
        untold = tuple(d.field for d in fields if d.field in empty)
        fields = tuple(d for d in fields if d.field not in empty)
        at = _at(then, published_ns(output))
        found.append(Compared(str(topic), at, output.same, fields, _became(then, now), turned, untold))
    of_topic = {str(topic): rules(topic.message) for topic in TOPICS}
    return Comparison(tuple(found), _rows(found, of_topic), made_no_more, unrecorded)


def _became(then: Any, now: Any) -> str:
    if isinstance(then, GraspPlan) and then.status is now.status is Status.OK:
        # there figures are what it is about
        return f"{then.in_words} → {now.in_words}" if then.in_words != now.in_words else ""
    one, other = (_status(message) for message in (then, now))
    # figures may differ where the words say the same
    return f"{one} → {other}" if FIGURES.sub("#", one) != FIGURES.sub("#", other) else ""


def _status(message: Any) -> str:
    """Status and reason in words; nothing of messages that have none."""
    status, reason = getattr(message, "status", None), getattr(message, "reason", "")
    if not isinstance(status, Status):
        return ""
    return f"{status.name.lower()}: {reason}" if reason else status.name.lower()


def _empty(message: Any) -> set[str]:
    """The fields that hold what they hold where nobody sends them."""
    return {f.name for f in dataclasses.fields(message) if _is_default(f, getattr(message, f.name))}


def _is_default(field: Any, value: Any) -> bool:
    if field.default is not dataclasses.MISSING:
        return value is None if field.default is None else bool(value == field.default)
    return field.default_factory is not dataclasses.MISSING and hasattr(value, "__len__") and len(value) == 0


def _differences(then: Any, now: Any, rules: Rules, exactly: bool) -> tuple[Difference, ...]:
    fields = tuple(d for d in differences(then, now, rules) if d.amount)
    # such as a zero of the other sign
    return (Difference("bytes", OTHER),) if exactly and not fields else fields


def _rows(outputs: list[Compared], rules: dict[str, Rules]) -> tuple[Row, ...]:
    messages = Counter(output.topic for output in outputs)
    found: defaultdict[tuple[str, str], list[tuple[float, At, str]]] = defaultdict(list)
    for output in outputs:
        for field, amount, words in output.fields:
            found[output.topic, field].append((amount, output.at, words))
    rows = [
        _row(topic, field, rules[topic].get(field, AS_IT_IS), messages[topic], of)
        for (topic, field), of in found.items()
    ]
    return tuple(sorted(rows, key=lambda row: (row.topic, -row.beyond, row.field)))


def _row(topic: str, field: str, rule: Rule, messages: int, found: list[tuple[float, At, str]]) -> Row:
    amounts = np.zeros(messages)
    amounts[: len(found)] = [amount for amount, _, _ in found]
    worst, where, words = max(found, key=lambda one: one[0])
    beyond = int((amounts > rule.tolerance).sum())
    return Row(topic, field, rule, messages, beyond, _median(amounts), worst, where, words)


def _median(amounts: np.ndarray) -> float:
    """The upper one of two: there is no mean of a number and of what is none."""
    return float(np.sort(amounts)[len(amounts) // 2]) if len(amounts) else math.nan


def _at(message: Any, published_ns: int) -> At:
    stamp = getattr(message, "stamp", None)
    if isinstance(stamp, FrameStamp):
        return At(published_ns, stamp.capture_left_ns, stamp.sequence)
    return At(published_ns, None, None)
