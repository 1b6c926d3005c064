"""How protobuf frames a field of bytes: its number, its length, then the bytes as they are.

Protobuf's library copies a bytes field of a megabyte several times while it makes room for it. The parts that these
functions return are joined once instead, and are byte for byte what the library writes.
"""

from collections.abc import Iterable
from typing import Any

LENGTH_DELIMITED = 2
"""The wire type of bytes, strings and messages."""


def delimited(number: int, parts: Iterable[Any]) -> list[Any]:
    """Parts of a message as the field of that number in another one: the field's head, then the parts."""
    inside = list(parts)
    return [varint(number << 3 | LENGTH_DELIMITED) + varint(sum(map(len, inside))), *inside]


def varint(value: int) -> bytes:
    """A number that is not negative in protobuf's base 128, least significant group first."""
    groups = bytearray()
    while value > 0x7F:
        groups.append(value & 0x7F | 0x80)
        value >>= 7
    groups.append(value)
    return bytes(groups)
