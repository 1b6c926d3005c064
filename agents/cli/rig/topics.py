"""What a rig does otherwise with a topic than the table says: a section for each, by the topic's name in quotes."""

from collections.abc import Mapping
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator

from schemas.topics import TOPICS
from shared.runtime.config import Settings


class TopicSection(Settings):
    """One topic."""

    recorded: bool


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
    known = [str(topic) for topic in TOPICS]
    for name in topics:
        if name not in known:
            raise ValueError(f"there is no topic {name!r}; known are {', '.join(known)}")
    return topics


TopicSections = Annotated[dict[str, TopicSection], BeforeValidator(_quoted), AfterValidator(_of_the_table)]
