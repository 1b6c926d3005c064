"""What a recording holds, from one pass over it: how many messages of which keys, when, and where it is damaged.

By default everything is published again, so that a viewer shows what there was, except:
- what a live agent of the rig publishes itself: of a recorded session, running agents get only what comes from outside
  of them, such as frames;
- what a robot would act on (plans, heartbeats) and commands. Those have to be named, and agreed to.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from datetime import date, datetime, time
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import CommandRecord
from schemas.topics import COMMANDS, HEARTBEAT, PLAN, TOPICS, Delivery, Topic, known_topic
from shared.recording.completeness import no_message_in
from shared.recording.mcap_file import Entry, RecordingError, UntilDamage

LONGEST_COMMAND_NS = 10 * 10**9


@dataclass(frozen=True)
class PastCommand:
    """A command that was carried out or refused: when its receiver got it, and what it was."""

    at_ns: int
    topic: Topic
    instance: str
    message: Any


@dataclass
class Contents:
    """What a recording holds.

    Fields:
        counts: messages by key, of keys that the topic table knows.
        commands: those of which the recording holds the records of whoever received them.
        unknown: messages by key, of keys that it does not know.
        first_ns, last_ns: when the first and the last message were received.
        zero_ns: when the first one was published, which seconds are counted from.
        damage: what keeps the rest from being read; empty where all of it can be.
    """

    counts: Counter[str] = field(default_factory=Counter[str])
    commands: list[PastCommand] = field(default_factory=list[PastCommand])
    unknown: Counter[str] = field(default_factory=Counter[str])
    first_ns: int = 0
    zero_ns: int = 0
    last_ns: int = 0
    damage: str = ""

    @property
    def commands_by_topic(self) -> Counter[str]:
        """How many commands of each topic it holds."""
        return Counter(str(command.topic) for command in self.commands)

    @property
    def rigs(self) -> tuple[str, ...]:
        """The rigs whose messages it holds, that with the most first."""
        rigs: Counter[str] = Counter()
        for key, count in self.counts.items():
            rigs[key.split("/")[1]] += count
        return tuple(rig for rig, _ in rigs.most_common())


def contents_of(path: Path) -> Contents:
    """Look through a recording.

    Raises:
        RecordingError: where nothing of it can be read.
        OSError: where it cannot be opened.
    """
    contents, empty, begun = Contents(), True, False
    recording = UntilDamage(path)
    for entry in recording.entries():
        # what is repeated from before the file began is older than its first moment
        contents.first_ns = contents.first_ns if begun else entry.received_ns
        contents.zero_ns = contents.zero_ns if begun else entry.at_ns
        contents.last_ns, empty, begun = entry.received_ns, False, begun or not entry.repeated
        _count(contents, entry)
    if empty:
        raise RecordingError(no_message_in(path, recording.damage))
    contents.damage = recording.damage
    return contents


def _count(contents: Contents, entry: Entry) -> None:
    known = known_topic(entry.key)
    (contents.counts if known is not None else contents.unknown)[entry.key] += 1
    command = _command(entry) if known is COMMANDS else None
    if command is not None:
        contents.commands.append(command)


def _command(entry: Entry) -> PastCommand | None:
    """The command that a record tells of; None where it cannot be read."""
    try:
        record = decode(CommandRecord, entry.payload)
        topic = next((topic for topic in TOPICS if str(topic) == record.topic), None)
        if topic is None:
            return None
        message = decode(topic.message, record.payload)
    except MessageError:
        return None
    # the record is published when the command has been carried out; clocks of two machines may be apart
    between_ns = entry.received_ns - record.received_ns
    at_ns = record.received_ns if 0 <= between_ns < LONGEST_COMMAND_NS else entry.received_ns
    return PastCommand(at_ns, topic, entry.key.split("/")[3], message)


SECONDS = re.compile(r"\d+(\.\d*)?|\.\d+")
CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}(\.\d{1,6})?)?")


class WindowError(ValueError):
    """A stretch that makes no sense; the text says what to give instead."""


def moment_ns(option: str, written: str, begin_ns: int) -> int:
    """A moment as people write it: `12.5` seconds from the start, `14:30:05` on the day of the start, or a date too.

    Raises:
        WindowError: where it is none of these; the text names the option.
    """
    try:
        if SECONDS.fullmatch(written):
            return begin_ns + round(float(written) * 1e9)
        return _wall_ns(written, begin_ns)
    except (ValueError, OverflowError, OSError):
        examples = "seconds from the start (12.5), a time of its day (14:30:05), or both (2026-11-20T14:30:05)"
        raise WindowError(f"{option} {written!r} is no moment; give {examples}") from None


def _wall_ns(written: str, begin_ns: int) -> int:
    if CLOCK.fullmatch(written):
        day: date = datetime.fromtimestamp(begin_ns * 1e-9).astimezone().date()
        padded = written if written[1] != ":" else f"0{written}"
        moment = datetime.combine(day, time.fromisoformat(padded)).astimezone()
    else:
        moment = datetime.fromisoformat(written)
        moment = moment if moment.tzinfo is not None else moment.astimezone()
    return round(moment.timestamp() * 1e6) * 1000


def window_ns(
    begin: str | None, end: str | None, first_ns: int, last_ns: int, zero_ns: int | None = None
) -> tuple[int, int]:
    """Where to begin and to end in a recording from `first_ns` to `last_ns`, both moments included.

    Seconds are counted from `zero_ns`; from the first moment, if it is None.

    Raises:
        WindowError: where nothing of the recording lies between.
    """
    zero_ns = first_ns if zero_ns is None else zero_ns
    from_ns = first_ns if begin is None else moment_ns("--from", begin, zero_ns)
    to_ns = last_ns if end is None else moment_ns("--to", end, zero_ns)
    length_s = (last_ns - first_ns) * 1e-9
    if from_ns > last_ns:
        raise WindowError(f"--from {begin} lies beyond the end of the recording, which lasts {length_s:.1f} s")
    if to_ns < first_ns:
        raise WindowError(f"--to {end} lies before the recording, which begins at {_shown(first_ns)}")
    if to_ns < from_ns:
        raise WindowError(f"--to {end} lies before --from {begin}")
    return max(from_ns, first_ns), min(to_ns, last_ns)


def _shown(at_ns: int) -> str:
    return datetime.fromtimestamp(at_ns * 1e-9).astimezone().isoformat(" ", "seconds")


ACTED_ON = tuple(topic for topic in TOPICS if topic.delivery is Delivery.COMMAND or topic in (PLAN, HEARTBEAT))
"""What an agent would act on, a robot before all."""
WILDCARDS = frozenset("*?[")


class SelectionError(ValueError):
    """Topics that cannot be published again; the text says which, and what to do."""


@dataclass(frozen=True)
class Selection:
    """What is published again.

    Fields:
        keys: as recorded.
        commands: topics of the commands that are sent again.
        left_out: what the recording holds besides, with the reason.
    """

    keys: tuple[str, ...]
    commands: tuple[Topic, ...]
    left_out: dict[str, str]

    @property
    def acted_on(self) -> tuple[str, ...]:
        """The names of those that an agent would act on."""
        named = [name_of(key) for key in self.keys if known_topic(key) in ACTED_ON]
        return tuple(dict.fromkeys((*named, *map(str, self.commands))))


def select(contents: Contents, patterns: Collection[str] | None, present: Iterable[str]) -> Selection:
    """What to publish of a recording: what the patterns name (None: the default), on a rig where `present` agents are.

    Raises:
        SelectionError: where a pattern names nothing, or something that a live agent publishes.
    """
    alive = frozenset(present)
    if patterns is not None:
        return _named(contents, patterns, alive)
    left_out = dict.fromkeys(contents.unknown, "the topic table does not know it")
    keys: list[str] = []
    for key in contents.counts:
        if owner_of(key) in alive:
            left_out[key] = f"{owner_of(key)} is live"
        elif known_topic(key) in ACTED_ON:
            left_out[key] = "would be acted on"
        else:
            keys.append(key)
    left_out |= dict.fromkeys(contents.commands_by_topic, "would be acted on")
    return Selection(tuple(keys), (), left_out)


def name_of(key: str) -> str:
    """A key as people name it, without rig and instance: `camera/frames`."""
    parts = key.split("/")
    return f"{parts[2]}/{parts[4]}" if len(parts) == 5 else key


def owner_of(key: str) -> str:
    """Whose key it is, as `kind/instance`."""
    return "/".join(key.split("/")[2:4])


def _named(contents: Contents, patterns: Collection[str], alive: frozenset[str]) -> Selection:
    keys: list[str] = []
    commands: list[Topic] = []
    for pattern in patterns:
        found = [key for key in contents.counts if _names(pattern, name_of(key), known_topic(key))]
        sent = [
            t
            for t in TOPICS
            if str(t) == pattern and t.delivery is Delivery.COMMAND and contents.commands_by_topic[pattern]
        ]
        if not found and not sent:
            raise SelectionError(_nothing(pattern, contents))
        keys += found
        commands += sent
    for key in keys:
        if owner_of(key) in alive:
            both = f"{owner_of(key)} is live on this rig and publishes {name_of(key)} itself"
            raise SelectionError(f"{both}: stop it, leave that topic out of --topics, or give another --rig")
    chosen = tuple(key for key in contents.counts if key in keys)
    return Selection(
        chosen, tuple(dict.fromkeys(commands)), dict.fromkeys(set(contents.counts) - set(keys), "not named")
    )


def _names(pattern: str, name: str, topic: Topic | None) -> bool:
    """Whether a pattern names a topic; what is acted on must be spelt out."""
    return name == pattern if topic in ACTED_ON or not WILDCARDS & set(pattern) else fnmatchcase(name, pattern)


def _nothing(pattern: str, contents: Contents) -> str:
    known = any(pattern == str(t) or fnmatchcase(str(t), pattern) or pattern == t.name for t in TOPICS)
    held = ", ".join(sorted({*map(name_of, contents.counts), *contents.commands_by_topic}))
    why = "is not in this recording" if known else "is no topic"
    return f"--topics {pattern} {why}; it holds {held}"
