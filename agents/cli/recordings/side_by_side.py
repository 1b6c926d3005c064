"""A recording and its replay as one Rerun file."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from agents.replay.differences import At, Comparison
from agents.viewer.entity import Moment
from agents.viewer.side_by_side import RECORDED, REPLAYED, SideBySide
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.topics import FRAMES, LOG, Topic, topic_of
from shared.recording.mcap_file import Entry

MOST_CURVES = 4
"""Views of differences beside each other; the others can be opened from the list of entities."""


def write_side_by_side(path: Path, before: list[Entry], after: list[Entry], comparison: Comparison) -> None:
    """Write a Rerun file with both; of the frames those that something was made of.

    Raises:
        ViewerError: where it cannot be written.
    """
    file = SideBySide(path, "replay", curves_of(comparison))
    used = _frames_of(before) | _frames_of(after)
    for side, entries in ((RECORDED, before), (REPLAYED, after)):
        for entry in entries:
            topic = topic_of(entry.key)
            message = None if topic is LOG else _decoded(topic, entry)
            if message is None or (topic is FRAMES and message.stamp.sequence not in used):
                continue
            file.show(side, topic, entry.key, message, entry.published_ns)
    for output in comparison.outputs:
        fields = dict.fromkeys(_paths(comparison, output.topic), 0.0)
        fields |= {f"{output.topic}/{difference.field}": difference.amount for difference in output.fields}
        for field, amount in fields.items():
            file.differ(_moment(output.at), field, amount)
    file.close()


def curves_of(comparison: Comparison) -> tuple[str, ...]:
    """The fields that are shown at once: those beyond their tolerance most often; no two of them nested."""
    rows = [row for row in comparison.rows if "." not in row.field]
    rows.sort(key=lambda row: (-row.beyond, not row.rule.unit))
    return tuple(f"{row.topic}/{row.field}" for row in rows[:MOST_CURVES])


def _paths(comparison: Comparison, topic: str) -> list[str]:
    """Every field of a topic that differs anywhere, so that its curve is 0 where it does not."""
    return [f"{row.topic}/{row.field}" for row in comparison.rows if row.topic == topic]


def _frames_of(entries: Iterable[Entry]) -> set[int]:
    """The frames that anything but a frame descends from."""
    found: set[int] = set()
    for entry in entries:
        topic = topic_of(entry.key)
        if topic is not FRAMES and "stamp" in topic.message.__dataclass_fields__:
            message = _decoded(topic, entry)
            found |= {message.stamp.sequence} if message is not None else set()
    return found


def _decoded(topic: Topic, entry: Entry) -> Any:
    """The message; None where it is none, which what it is compared with has said already."""
    try:
        return decode(topic.message, entry.payload)
    except MessageError:
        return None


def _moment(at: At) -> Moment:
    return Moment(at.published_ns if at.capture_ns is None else at.capture_ns, at.frame)
