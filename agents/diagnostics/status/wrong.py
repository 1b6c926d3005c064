"""One thing that is wrong with a rig, or that is worth knowing, and how lists of names are said."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Wrong:
    """A sentence about a rig that runs.

    Fields:
        code: stable, for programs; docs/diagnostics.md lists them.
        about: the agent, host or topic.
        text: the sentence, without a full stop.
        grave: whether it makes the exit status 1; otherwise it is only worth knowing.
    """

    code: str
    about: str
    text: str
    grave: bool = True


def listed(names: Iterable[str]) -> str:
    """Names as a sentence lists them."""
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last
