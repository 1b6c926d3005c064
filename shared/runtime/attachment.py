"""What travels beside every message: its sequence number, when it was published, and how long the step took.

The attachment holds measurements, which differ from run to run; the message itself holds only what is a function of
the agent's inputs, so that live and replayed outputs can be compared byte for byte.
"""

import struct
from typing import NamedTuple

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
