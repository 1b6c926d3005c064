"""What a hostile case came to."""

from typing import NamedTuple


class Found(NamedTuple):
    """Its kind, whether its plan or command was accepted, and whether that was allowed."""

    kind: str
    accepted: bool
    allowed: bool
