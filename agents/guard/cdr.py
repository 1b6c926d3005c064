"""The few ROS 2 messages that the monitor reads and writes, in CDR (little endian), by the standard library alone."""

import struct
from typing import Any

LITTLE_ENDIAN, MOST_VALUES = b"\x00\x01\x00\x00", 64
"""Which encoding it is, with two bytes that readers leave alone; of a list: what claims to have more is no message."""
EMPTY = LITTLE_ENDIAN + b"\x00"


class CdrError(ValueError):
    """Bytes that are not the message they should be: what each reader raises."""


def joint_positions(data: bytes) -> tuple[float, ...]:
    """The positions of a sensor_msgs/JointState; they may be anything, and any number of them."""
    return _lists(data, "sddd")[0]


def pressed(data: bytes) -> bool:
    """Whether the first button of a sensor_msgs/Joy is pressed."""
    _, buttons = _lists(data, "fi")
    if not buttons:
        raise CdrError("a sensor_msgs/Joy has no button")
    return buttons[0] == 1


def joint_state(positions: tuple[float, ...], stamp_ns: int) -> bytes:
    """A sensor_msgs/JointState of positions alone."""
    # 24 bytes of header, no names and the count: doubles follow without padding
    return _header(stamp_ns) + struct.pack(f"<II{len(positions)}dII", 0, len(positions), *positions, 0, 0)


def string_stamped(text: str, stamp_ns: int) -> bytes:
    """A crtk_msgs/StringStamped."""
    encoded = text.encode() + b"\0"
    return _header(stamp_ns) + struct.pack("<I", len(encoded)) + encoded


def _header(stamp_ns: int) -> bytes:
    """A std_msgs/Header of no frame, padded to four bytes."""
    seconds, rest_ns = divmod(stamp_ns, 1_000_000_000)
    return LITTLE_ENDIAN + struct.pack("<iII4x", seconds % (1 << 31), rest_ns, 1)


def _lists(data: bytes, kinds: str) -> list[tuple[Any, ...]]:
    """The lists behind a std_msgs/Header: of numbers, as struct names them, or of texts (s), which are left out."""
    if data[:2] != LITTLE_ENDIAN[:2]:
        raise CdrError("it is not CDR in little endian")
    found, at = list[tuple[Any, ...]](), len(LITTLE_ENDIAN)

    def take(numbers: str) -> tuple[Any, ...]:
        nonlocal at
        # each at a multiple of its size behind the four bytes that say the order
        size = 8 if "d" in numbers else 4
        at += (len(LITTLE_ENDIAN) - at) % size
        values = struct.unpack_from(f"<{numbers}", data, at)
        at += size * len(numbers)
        return values

    try:
        take("iI")
        # a frame's name is a text of its own
        for kind in f"t{kinds}":
            (count,) = (1,) if kind == "t" else take("I")
            if count > MOST_VALUES:
                raise CdrError(f"a list claims to have {count} values")
            if kind in "ts":
                for _ in range(count):
                    (length,) = take("I")
                    at += length
            else:
                found.append(take(kind * count))
    except struct.error:
        raise CdrError("the message is cut off") from None
    if len(data) - at >= 8:
        raise CdrError("more follows than the message has")
    return found
