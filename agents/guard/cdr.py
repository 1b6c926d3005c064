"""The few ROS 2 messages that the monitor reads and writes, in CDR (little endian), by the standard library alone.

Tests compare each with what another library writes, byte for byte.
"""

import struct
from typing import Any

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
MOST_VALUES = 64
"""Of a list: no message here has more, and what claims more is none."""
EMPTY = LITTLE_ENDIAN + b"\x00"
SECOND_NS = 1_000_000_000


class CdrError(ValueError):
    """Bytes that are not the message they should be."""


def joint_positions(data: bytes) -> tuple[float, ...]:
    """The positions of a sensor_msgs/JointState; they may be anything, and any number of them.

    Raises:
        CdrError: where the bytes are no such message.
    """
    read = _Reader(data)
    read.header()
    for _ in range(read.count()):
        read.text()
    positions, _, _ = (read.values("d", 8) for _ in range(3))
    read.end()
    return positions


def pressed(data: bytes) -> bool:
    """Whether the first button of a sensor_msgs/Joy is pressed.

    Raises:
        CdrError: where the bytes are no such message, or it has no button.
    """
    read = _Reader(data)
    read.header()
    _, buttons = read.values("f", 4), read.values("i", 4)
    read.end()
    if not buttons:
        raise CdrError("a sensor_msgs/Joy has no button")
    return buttons[0] == 1


def joint_state(positions: tuple[float, ...], stamp_ns: int) -> bytes:
    """A sensor_msgs/JointState of positions alone."""
    body = _header(stamp_ns) + struct.pack("<II", 0, len(positions))
    body += bytes(-len(body) % 8) + struct.pack(f"<{len(positions)}d", *positions)
    return LITTLE_ENDIAN + body + struct.pack("<II", 0, 0)


def string_stamped(text: str, stamp_ns: int) -> bytes:
    """A crtk_msgs/StringStamped."""
    return LITTLE_ENDIAN + _header(stamp_ns) + _text(text)


def _header(stamp_ns: int) -> bytes:
    seconds, rest_ns = divmod(stamp_ns, SECOND_NS)
    head = struct.pack("<iI", seconds % (1 << 31), rest_ns) + _text("")
    return head + bytes(-len(head) % 4)


def _text(text: str) -> bytes:
    encoded = text.encode() + b"\0"
    return struct.pack("<I", len(encoded)) + encoded


class _Reader:
    """Reads one value after another, each at a multiple of its size behind the four bytes that say the order."""

    def __init__(self, data: bytes) -> None:
        if data[:4] != LITTLE_ENDIAN:
            raise CdrError("it is not CDR in little endian")
        self._data, self._at = data, 4

    def header(self) -> None:
        """A std_msgs/Header, of which nothing is used."""
        self._take("<iI", 8, 4)
        self.text()

    def count(self) -> int:
        """How many values a list has."""
        (found,) = self._take("<I", 4, 4)
        if found > MOST_VALUES:
            raise CdrError(f"a list claims to have {found} values")
        return found

    def text(self) -> None:
        """A string, of which nothing is used."""
        (length,) = self._take("<I", 4, 4)
        if length > len(self._data):
            raise CdrError("a string is longer than its message")
        self._take(f"<{length}s", length, 1)

    def values(self, kind: str, size: int) -> tuple[Any, ...]:
        """A list of numbers."""
        count = self.count()
        return self._take(f"<{count}{kind}", count * size, size) if count else ()

    def end(self) -> None:
        """Nothing follows but padding."""
        if len(self._data) - self._at >= 8:
            raise CdrError("more follows than the message has")

    def _take(self, layout: str, length: int, align: int) -> tuple[Any, ...]:
        self._at += -(self._at - 4) % align
        if self._at + length > len(self._data):
            raise CdrError("the message is cut off")
        found = struct.unpack_from(layout, self._data, self._at)
        self._at += length
        return found
