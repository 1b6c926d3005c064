"""The few ROS 2 messages that the monitor reads and writes, in CDR (little endian), by the standard library alone.

Tests compare each with what another library writes, byte for byte.
"""

import struct
from typing import Any

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""Which encoding it is, and two bytes of options that readers leave alone."""
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
    positions, _, _ = (read.values("d") for _ in range(3))
    read.end()
    return positions


def pressed(data: bytes) -> bool:
    """Whether the first button of a sensor_msgs/Joy is pressed.

    Raises:
        CdrError: where the bytes are no such message, or it has no button.
    """
    read = _Reader(data)
    read.header()
    _, buttons = read.values("f"), read.values("i")
    read.end()
    if not buttons:
        raise CdrError("a sensor_msgs/Joy has no button")
    return buttons[0] == 1


def joint_state(positions: tuple[float, ...], stamp_ns: int) -> bytes:
    """A sensor_msgs/JointState of positions alone."""
    # 24 bytes of header, no names and the count: doubles follow without padding
    counted = struct.pack(f"<II{len(positions)}dII", 0, len(positions), *positions, 0, 0)
    return LITTLE_ENDIAN + _header(stamp_ns) + counted


def string_stamped(text: str, stamp_ns: int) -> bytes:
    """A crtk_msgs/StringStamped."""
    encoded = text.encode() + b"\0"
    return LITTLE_ENDIAN + _header(stamp_ns) + struct.pack("<I", len(encoded)) + encoded


def _header(stamp_ns: int) -> bytes:
    """A std_msgs/Header of no frame, padded to four bytes."""
    seconds, rest_ns = divmod(stamp_ns, SECOND_NS)
    return struct.pack("<iII4x", seconds % (1 << 31), rest_ns, 1)


class _Reader:
    """Reads one value after another, each at a multiple of its size behind the four bytes that say the order."""

    def __init__(self, data: bytes) -> None:
        if data[:2] != LITTLE_ENDIAN[:2]:
            raise CdrError("it is not CDR in little endian")
        self._data, self._at = data, len(LITTLE_ENDIAN)

    def header(self) -> None:
        """A std_msgs/Header, of which nothing is used."""
        self._take("iI")
        self.text()

    def count(self) -> int:
        """How many values a list has."""
        (found,) = self._take("I")
        if found > MOST_VALUES:
            raise CdrError(f"a list claims to have {found} values")
        return found

    def text(self) -> None:
        """A string, of which nothing is used."""
        (length,) = self._take("I")
        self._at += length

    def values(self, kind: str) -> tuple[Any, ...]:
        """A list of numbers."""
        count = self.count()
        return self._take(kind * count) if count else ()

    def end(self) -> None:
        """Nothing follows but padding."""
        if len(self._data) - self._at >= 8:
            raise CdrError("more follows than the message has")

    def _take(self, kinds: str) -> tuple[Any, ...]:
        """Numbers of equal size, behind padding to a multiple of it."""
        self._at += (len(LITTLE_ENDIAN) - self._at) % struct.calcsize(f"<{kinds[0]}")
        end = self._at + struct.calcsize(f"<{kinds}")
        if end > len(self._data):
            raise CdrError("the message is cut off")
        found = struct.unpack_from(f"<{kinds}", self._data, self._at)
        self._at = end
        return found
