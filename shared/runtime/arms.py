"""Access rules look at keys alone, so what a message says of an arm must be what its key says."""

from typing import Any

from schemas.checks import require
from schemas.topics import Topic


def check_arm(topic: Topic, key: str, message: Any) -> None:
    """Refuse what speaks of another arm than the one under whose key it was published.

    Raises:
        MessageError: where it does.
    """
    if topic.per_arm:
        of = key.split("/")[-2]
        require(message.arm == of, f"it speaks of the arm {message.arm[:40]!r} under the key of {of}")
