"""What a rig does otherwise with a topic than the table says: a section for each, by the topic's name in quotes.

Only what weakens nothing that moves a robot: commands travel as they do, events wait for the network as they do and are
kept no shorter, and what an arm is held by goes first.
"""

import dataclasses
import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from schemas.messages import TopicOverride
from schemas.topics import ANY_AGENT, COMMANDS, EVENTS_KEPT, TOPICS, Delivery, Priority, Topic
from shared.runtime.config import Settings

MOST_KEPT = 100_000
"""Of each publisher's events; some 100 MB."""
ROWS = {str(topic): topic for topic in TOPICS}


class TopicSection(Settings):
    """One topic; what is left out is as the table has it."""

    recorded: bool | None = None
    priority: Priority | None = None
    kept: int | None = Field(default=None, le=MOST_KEPT)

    @model_validator(mode="after")
    def _says_something(self) -> "TopicSection":
        if not self.told:
            raise ValueError(f"it says nothing; set {', '.join(TopicSection.model_fields)}, or leave the section out")
        return self

    @property
    def told(self) -> dict[str, bool | int | Priority]:
        """What it says, by key."""
        return {key: value for key, value in self if value is not None}


@dataclass(frozen=True)
class Override:
    """One thing that a rig does otherwise; values are as its file writes them, `table` what the table says."""

    topic: str
    setting: str
    value: bool | int | str
    table: bool | int | str

    @property
    def told(self) -> TopicOverride:
        """As processes tell it."""
        return TopicOverride(self.topic, self.setting, str(self.value).lower())

    def __str__(self) -> str:
        return in_words(self.told)


def rows_otherwise(topics: Mapping[str, TopicSection]) -> tuple[Topic, ...]:
    """The rows of the table that a rig has otherwise, as it has them."""
    return tuple(dataclasses.replace(ROWS[name], **section.told) for name, section in topics.items())


def overrides(topics: Mapping[str, TopicSection]) -> tuple[Override, ...]:
    """Everything that a rig does otherwise; what it says as the table does is left out."""
    told = ((name, key, value) for name, section in topics.items() for key, value in section.told.items())
    compared = (Override(name, key, _plain(value), _plain(getattr(ROWS[name], key))) for name, key, value in told)
    return tuple(one for one in compared if one.value != one.table)


def _plain(value: bool | int | Priority) -> bool | int | str:
    return value.value if isinstance(value, Enum) else value


def in_words(told: TopicOverride) -> str:
    """An override as people read it."""
    return f"{told.topic} {told.setting} {told.value}"


def _quoted(told: object) -> object:
    """Without quotes TOML makes two sections of agent and topic."""
    for agent, section in _sections(told):
        inner = [name for name, _ in _sections(section)]
        if inner and "/" not in agent:
            raise ValueError(f'a topic is written in quotes: [topics."{agent}/{inner[0]}"]')
    return told


def _sections(told: object) -> list[tuple[str, object]]:
    """The sections within a section, before anything of it was checked."""
    keys: Mapping[str, object] = told if isinstance(told, dict) else {}
    return [(name, value) for name, value in keys.items() if isinstance(value, dict)]


def _of_the_table(topics: dict[str, TopicSection]) -> dict[str, TopicSection]:
    for name, section in topics.items():
        if name not in ROWS:
            raise ValueError(f"there is no topic {name!r}; {_meant(name)}known are {', '.join(ROWS)}")
        faults = (_recorded_fault, _priority_fault, _kept_fault)
        if found := next((said for fault in faults if (said := fault(ROWS[name], section))), ""):
            raise ValueError(found)
    return topics


def _meant(name: str) -> str:
    everyones = f"{ANY_AGENT}/{name.split('/')[-1]}"
    near = [everyones] if everyones in ROWS else difflib.get_close_matches(name, ROWS, n=1)
    return f"did you mean {near[0]}? " if near else ""


def _recorded_fault(topic: Topic, section: TopicSection) -> str:
    """Why a rig may not say so of what is recorded of a topic; empty where it may, or says nothing."""
    if section.recorded is None or topic.delivery is not Delivery.COMMAND:
        return ""
    return f"{topic}.recorded: recordings hold a command as its receiver tells it, as {COMMANDS}; set it there"


def _priority_fault(topic: Topic, section: TopicSection) -> str:
    """Why a rig may not say so of a topic's priority; empty where it may, or says nothing."""
    if section.priority is None:
        return ""
    if topic.delivery is not Delivery.LATEST:
        what = "an event" if topic.delivery is Delivery.EVENT else f"a {topic.delivery.name.lower()}"
        return f"{topic}.priority: {what} waits for the network, each in its turn; leave priority out"
    if topic.never_later and section.priority is not topic.priority:
        return f"{topic}.priority: an arm that moves is held or watched by it, so it goes first; leave priority out"
    return ""


def _kept_fault(topic: Topic, section: TopicSection) -> str:
    """Why a publisher may not keep so many; empty where it may, or where nothing is said."""
    if section.kept is None:
        return ""
    if topic.delivery is not Delivery.EVENT:
        events = ", ".join(name for name, row in ROWS.items() if row.delivery is Delivery.EVENT)
        return f"{topic}.kept: only events are kept for those who were away ({events}); leave kept out"
    if section.kept < EVENTS_KEPT:
        less = f"with fewer than {EVENTS_KEPT} a router's restart could lose events of a robot"
        return f"{topic}.kept = {section.kept}: {less}; write {EVENTS_KEPT} to {MOST_KEPT}"
    return ""


TopicSections = Annotated[dict[str, TopicSection], BeforeValidator(_quoted), AfterValidator(_of_the_table)]
