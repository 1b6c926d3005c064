"""Damage of a JPEG that can be told without decoding it: ITU-T T.81, annex B, prescribes the order of its markers.

Decoders draw a picture of nearly anything. But entropy-coded data hold no marker apart from restarts, which count from
0 to 7 and round again, one after every so many units (MCUs) of the image; and each component of a sequential image is
coded once. So a byte that became 0xFF, a part that is missing or doubled with a marker, and an end that is missing or,
where there are restarts, comes too early are told. A byte of the entropy-coded data that changed into another one is
not, nor a part that is missing between two markers of an image without restarts, nor a progressive image's last scans.
"""

from bisect import bisect_left
from dataclasses import dataclass, field

import numpy as np

SOI, EOI, SOS, DRI, DHT, DQT, DAC, DNL, COM, TEM = 0xD8, 0xD9, 0xDA, 0xDD, 0xC4, 0xDB, 0xCC, 0xDC, 0xFE, 0x01
RESTARTS = range(0xD0, 0xD8)
FRAMES = {*range(0xC0, 0xD0)} - {DHT, DAC, 0xC8}
PROGRESSIVE = {0xC2, 0xC6, 0xCA, 0xCE}
BETWEEN = {DRI, DHT, DQT, DAC, DNL, COM, *range(0xE0, 0xF0)}
"""Segments that may come before any scan."""
BLOCK_PX = 8


@dataclass
class _Jpeg:
    """What the segments so far say.

    Fields:
        sampling: of each component, by its number: blocks across and down in one unit.
        coded: components that a scan has held.
        interval: units between two restarts; 0 where there are none.
    """

    width: int = 0
    height: int = 0
    progressive: bool = False
    sampling: dict[int, tuple[int, int]] = field(default_factory=dict[int, tuple[int, int]])
    coded: set[int] = field(default_factory=set[int])
    interval: int = 0


class _DamageError(ValueError):
    pass


def jpeg_damage(data: bytes) -> str:
    """What is wrong with the bytes of a JPEG, as what follows "is damaged: "; empty where nothing is found.

    Zeros behind its end, with which capture cards fill their buffers, are no damage.
    """
    try:
        _walk(data)
    except _DamageError as error:
        return str(error)
    return ""


def _walk(data: bytes) -> None:
    if not data.startswith(b"\xff\xd8"):
        raise _DamageError("it does not begin as a JPEG does")
    jpeg, places, at = _Jpeg(), _like_markers(data), 2
    while True:
        marker, at = _marker_at(data, at)
        if marker == EOI:
            break
        if marker not in BETWEEN and marker not in FRAMES and marker != SOS:
            raise _DamageError(f"the marker FF{marker:02X} at byte {at - 2} has no place there")
        segment = _segment(data, at, marker)
        at += 2 + len(segment)
        _read(jpeg, marker, segment)
        if marker == SOS:
            at = _after_scan(data, places, at, jpeg, segment)
    if not jpeg.coded or jpeg.coded != jpeg.sampling.keys():
        raise _DamageError(f"it ends after {len(jpeg.coded)} of {len(jpeg.sampling)} colour components")
    if data[at:].strip(b"\0"):
        raise _DamageError(f"{len(data) - at} bytes follow its end")


def _marker_at(data: bytes, at: int) -> tuple[int, int]:
    """The marker that must be at a place, and the place behind it."""
    if data[at : at + 1] == b"\xff":
        while data[at + 1 : at + 2] == b"\xff":
            at += 1
        if data[at + 1 : at + 2] not in (b"", b"\0"):
            return data[at + 1], at + 2
    what = "it ends" if at >= len(data) - 1 else "there is no marker"
    raise _DamageError(f"{what} at byte {at}, where a segment or the end of the image must follow")


def _like_markers(data: bytes) -> list[int]:
    """Where two bytes could be a marker, within entropy-coded data or not."""
    values = np.frombuffer(data, np.uint8)
    begin = np.flatnonzero(values[:-1] == 0xFF)
    follow = values[begin + 1]
    return begin[(follow != 0) & (follow != 0xFF)].tolist()


def _segment(data: bytes, at: int, marker: int) -> bytes:
    """The content of a segment whose length stands at a place."""
    length = int.from_bytes(data[at : at + 2], "big")
    if length < 2 or at + length > len(data):
        raise _DamageError(f"the segment FF{marker:02X} at byte {at} is cut off or has a wrong length")
    return data[at + 2 : at + length]


def _read(jpeg: _Jpeg, marker: int, segment: bytes) -> None:
    """Note what a segment says of the image."""
    if marker in FRAMES:
        if jpeg.sampling or len(segment) < 6 or len(segment) != 6 + 3 * segment[5]:
            raise _DamageError("its frame header has a wrong length, or there are two")
        jpeg.height, jpeg.width = int.from_bytes(segment[1:3], "big"), int.from_bytes(segment[3:5], "big")
        jpeg.progressive = marker in PROGRESSIVE
        jpeg.sampling = {c: (s >> 4, s & 15) for c, s in zip(segment[6::3], segment[7::3], strict=True)}
        if not all(1 <= n <= 4 for both in jpeg.sampling.values() for n in both) or not jpeg.width:
            raise _DamageError("its frame header is none")
    elif marker == DRI:
        if len(segment) != 2:
            raise _DamageError("its restart interval has a wrong length")
        jpeg.interval = int.from_bytes(segment, "big")
    elif marker == SOS:
        if not segment or not 1 <= segment[0] <= 4 or len(segment) != 4 + 2 * segment[0]:
            raise _DamageError("a scan's header has a wrong length")
        held = set(segment[1 : 1 + 2 * segment[0] : 2])
        if not held <= jpeg.sampling.keys() or (not jpeg.progressive and held & jpeg.coded):
            raise _DamageError("a scan holds a colour component that is not there, or that has been coded before")
        jpeg.coded |= held


def _after_scan(data: bytes, places: list[int], at: int, jpeg: _Jpeg, header: bytes) -> int:
    """The place of the first marker behind the entropy-coded data, once its restarts have been counted."""
    begins, restarts, interval = at, 0, jpeg.interval
    for index in range(bisect_left(places, at), len(places)):
        place = places[index]
        if place == begins:
            raise _DamageError(f"there are no image data before byte {begins}")
        marker = data[place + 1]
        if marker not in RESTARTS:
            wanted = _restarts_wanted(jpeg, header)
            if wanted is not None and restarts != wanted:
                raise _DamageError(f"a scan has {restarts} restart markers in place of {wanted}, so it is not whole")
            return place
        if not interval or marker != RESTARTS[restarts % len(RESTARTS)]:
            raise _DamageError(f"the restart marker at byte {place} is out of order, so part of the image is missing")
        restarts, begins = restarts + 1, place + 2
    raise _DamageError("it ends in the midst of its image data")


def _restarts_wanted(jpeg: _Jpeg, header: bytes) -> int | None:
    """How many restart markers a scan holds; None where nobody knows, since its height is told behind it."""
    if not jpeg.interval:
        return 0
    if not jpeg.height:
        return None
    across, down = (max(sampling[axis] for sampling in jpeg.sampling.values()) for axis in (0, 1))
    held = header[1 : 1 + 2 * header[0] : 2]
    wide, high = BLOCK_PX * across, BLOCK_PX * down
    width, height = jpeg.width, jpeg.height
    if len(held) == 1:
        # the units of a scan of one component are single blocks of that component's own, smaller image
        own_across, own_down = jpeg.sampling[held[0]]
        width, height = -(-width * own_across // across), -(-height * own_down // down)
        wide = high = BLOCK_PX
    units = -(-width // wide) * -(-height // high)
    return -(-units // jpeg.interval) - 1
