"""What a recording is made of: messages as they travelled, and notes about them."""

from dataclasses import dataclass

PROFILE = "suturegrasp"
"""What the files call themselves, so that those of other programs are told apart."""
LONGEST_WAY_NS = 1_000_000_000
"""From publisher to recorder."""


class RecordingError(ValueError):
    """A file that is no recording, or is damaged; the text says what is wrong with it."""


@dataclass(frozen=True)
class Entry:
    """One recorded message; `epoch` tells the runs of its publisher apart.

    Fields:
        repeated: from before the file began, for a part of a recording to be whole by itself.
    """

    key: str
    epoch: int
    sequence: int
    payload: bytes
    published_ns: int
    received_ns: int
    repeated: bool = False

    @property
    def at_ns(self) -> int:
        """When it was published; when it was received, where that is no way that a message takes.

        A state may have been published long before, and another host's clock may be off.
        """
        return self.published_ns if 0 <= self.received_ns - self.published_ns < LONGEST_WAY_NS else self.received_ns


@dataclass(frozen=True)
class Note:
    """Facts about a recording, under the name that its recorder gave them."""

    name: str
    facts: dict[str, str]
