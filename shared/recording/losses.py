"""What a recording lacks: told when it happens, and summed up at the end.

Whoever is killed cannot sum up, so each loss is noted in the file at once, under `lost`; the note `losses` at the end
holds the number of messages by key, and whether the recording is complete.
"""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

from shared.recording.entry import Note

LOST = "lost"
"""A note of losses that have just happened: by key `4: 812-814 on the way, 820 no room`."""
LOSSES = "losses"
"""The note at the end: how many messages the file lacks, by key, and `complete`."""
COMPLETE = "complete"
AT = "at_ns"
LONGEST_NOTE = 50
"""Stretches of one key in one note; the count goes on."""
ON_THE_WAY, NO_ROOM, NOT_WRITTEN, TOLD_BY_ZENOH = "on the way", "no room", "not written", "told by Zenoh"


@dataclass(frozen=True)
class Loss:
    """A stretch of one key's sequence that is not in the file, both ends included, and why.

    Fields:
        first, last: numbers in the sequence; for what Zenoh tells, 1 and the number of messages.
        at_ns: when it was noticed.
    """

    key: str
    first: int
    last: int
    why: str
    at_ns: int

    @property
    def count(self) -> int:
        """Of messages."""
        return self.last - self.first + 1


def joined(losses: Iterable[Loss]) -> list[Loss]:
    """The same with stretches that follow each other made one."""
    found: list[Loss] = []
    for loss in sorted(losses, key=lambda loss: (loss.key, loss.first)):
        before = found[-1] if found else None
        if before and (before.key, before.why, before.last + 1) == (loss.key, loss.why, loss.first):
            found[-1] = Loss(loss.key, before.first, loss.last, loss.why, before.at_ns)
        else:
            found.append(loss)
    return found


def by_key(losses: Iterable[Loss]) -> dict[str, int]:
    """How many messages of each key are lost."""
    counts: defaultdict[str, int] = defaultdict(int)
    for loss in losses:
        counts[loss.key] += loss.count
    return dict(counts)


def as_note(losses: Iterable[Loss], at_ns: int) -> Note:
    """Losses that have just happened, as the file holds them."""
    stretches: defaultdict[str, list[str]] = defaultdict(list)
    losses = joined(losses)
    for loss in losses:
        numbers = f"{loss.first}" if loss.count == 1 else f"{loss.first}-{loss.last}"
        stretches[loss.key].append(f"{numbers} {loss.why}")
    counts = by_key(losses)
    told = {key: f"{counts[key]}: {_listed(found)}" for key, found in stretches.items()}
    return Note(LOST, {AT: str(at_ns), **told})


def sentence(losses: Iterable[Loss]) -> str:
    """Losses in one line."""
    facts = as_note(losses, 0).facts
    return "lost " + "; ".join(
        f"{told.split(':')[0]} of {key} ({told.split(': ')[1]})" for key, told in facts.items() if key != AT
    )


def counts_of(note: Note) -> dict[str, int]:
    """How many messages a note of the name `lost` or `losses` tells of, by key."""
    counts = {key: told.partition(":")[0] for key, told in note.facts.items() if key not in (AT, COMPLETE)}
    return {key: int(count) for key, count in counts.items() if count.isdecimal() and int(count)}


def _listed(stretches: list[str]) -> str:
    more = f", and {len(stretches) - LONGEST_NOTE} more" if len(stretches) > LONGEST_NOTE else ""
    return ", ".join(stretches[:LONGEST_NOTE]) + more
