"""Which of a recording's keys are published again, and why the others are not.

By default it is everything, so that a viewer shows what there was, except:
- what a live agent of the rig publishes itself: of a recorded session, running agents get only what comes from outside
  of them, such as frames;
- what a robot would act on (plans, heartbeats) and commands. Those have to be named, and agreed to.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase

from agents.replay.contents import Contents, known_topic
from schemas.topics import HEARTBEAT, PLAN, TOPICS, Delivery, Topic

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
