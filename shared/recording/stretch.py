"""A stretch of a recording that means something by itself."""

from collections.abc import Iterable, Iterator

from schemas.topics import Delivery, known_topic
from shared.recording.entry import Entry


def stretch(entries: Iterable[Entry], from_ns: int | None, to_ns: int | None) -> Iterator[Entry]:
    """What was received between two moments, both included, after the states that held when that begins.

    Without the newest state of each key (such as the calibration) what follows cannot be understood. None leads from
    the very beginning, or until the end.
    """
    states: dict[str, Entry] = {}
    for entry in entries:
        if to_ns is not None and entry.received_ns > to_ns:
            break
        if from_ns is None or entry.received_ns >= from_ns:
            yield from states.values()
            states.clear()
            yield entry
        elif _is_state(entry.key):
            states[entry.key] = entry
    yield from states.values()


def _is_state(key: str) -> bool:
    topic = known_topic(key)
    return topic is not None and topic.delivery is Delivery.STATE
