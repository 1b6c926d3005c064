"""What travels beside every message: its sequence number, when it was published, how long the step took, and its key.

The attachment holds measurements, which differ from run to run; the message itself holds only what is a function of
the agent's inputs, so that live and replayed outputs can be compared byte for byte.

After a link to the router broke, Zenoh has taken numbers that stand for keys for those of before: messages, commands
too, came under keys of other topics and other arms, which nothing in their bytes contradicts (docs/faults.md). So the
key stands a second time in Zenoh's encoding, behind the message's type, and what comes under another key than its own
is refused. What names none, as earlier versions do, is taken as before. At 1 kB a hop takes as long without all this;
at 2.8 MB 0.1 ms less (`benchmarks.latency --only parts`).
"""

import struct
from typing import Any, NamedTuple

from schemas.codec import encoding_name

LAYOUT = struct.Struct("<QQqd")


class Attachment(NamedTuple):
    """Beside a message; each is taken apart where it arrives, so it is of what Python makes soonest.

    Fields:
        epoch: of the publisher's process, so that a restart is no gap.
        sequence: counts the messages of one key from 0.
        published_ns: on the publisher's clock.
        step_ms: how long the agent's step took.
    """

    epoch: int
    sequence: int
    published_ns: int
    step_ms: float


def pack(attachment: Attachment) -> bytes:
    """The attachment as it travels."""
    return LAYOUT.pack(attachment.epoch, attachment.sequence, attachment.published_ns, attachment.step_ms)


def unpack(data: bytes) -> Attachment | None:
    """The attachment in these bytes, None where they hold none."""
    return Attachment(*LAYOUT.unpack(data)) if len(data) == LAYOUT.size else None


def beside_of(sample: Any, key: str) -> Attachment | None:
    """What came beside a sample under that key; None where that cannot be read, or it is one message for many keys."""
    # such a message has a number in the sequence of none of them
    return unpack(sample.attachment.to_bytes()) if sample.attachment is not None and "*" not in key else None


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
