"""A rig's file as digests of its sections: all its hosts need the same one, and so can tell where theirs differ."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any

from agents.configuration.rig import RigConfig
from schemas.messages import RigSection

OWN = ("host", "topics")
"""What each host has of its own, and what is compared word by word (topics.py)."""
NAMED = ("hosts", "robot")
"""Of these each section by its name is one."""


def rig_sections(rig: RigConfig) -> tuple[RigSection, ...]:
    """The sections of a rig's file but for what each host has of its own; what is at its default is as if left out."""
    told = rig.model_dump(mode="json", exclude_defaults=True)
    # where certificates lie was made this host's own when the file was read
    told.get("security", {}).pop("certificates", None)
    return tuple(RigSection(name, _digest(content)) for name, content in _sections(told) if name not in OWN)


def differing(here: tuple[RigSection, ...], theirs: tuple[RigSection, ...]) -> tuple[str, ...]:
    """The names of sections in which two files differ, in their order."""
    one, other = ({section.name: section.digest for section in sections} for sections in (here, theirs))
    return tuple(name for name in (one | other) if one.get(name) != other.get(name))


def _sections(told: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, content in told.items():
        if name in NAMED:
            yield from ((f"{name}.{inner}", section) for inner, section in content.items())
        else:
            yield name, content


def _digest(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]
