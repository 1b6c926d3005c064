"""Each message names the key that it was sent under; what comes under another key than its own is refused.

After a link to the router broke, Zenoh has taken numbers that stand for keys for those of before: messages, commands
too, came under keys of other topics and other arms, which nothing in their bytes contradicts (docs/faults.md). So the
key stands a second time in Zenoh's encoding, behind the message's type. What names none, as earlier versions do, is
taken as before.
"""

from typing import Any

from schemas.codec import encoding_name

_KEY = ";key="


def encoding_of(message_type: type, key: str) -> str:
    """What travels as Zenoh's encoding: the type of a message, and the key that it is sent under."""
    return f"{encoding_name(message_type)}{_KEY}{key}"


def other_key(encoding: Any, key: str) -> str:
    """The key that a message names, where it came under another one; empty where it names that one, or none."""
    named = str(encoding).partition(_KEY)[2]
    return "" if named == key else named


def why_refused(named: str) -> str:
    """What is wrong with a message that names another key."""
    return f"it was sent under {named[:200]}: after a link broke, Zenoh has taken one key for another"
