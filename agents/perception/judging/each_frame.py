"""What is judged in every frame, in half a millisecond: exposure, and whether a picture stands still.

That a picture is the very same as that of the frame before is told by a checksum of its bytes, which travels with the
observations: all that one frame needs of those before it is in them.
"""

import zlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from agents.perception.judging.answers import judgements
from agents.perception.judging.picture import about_exposure
from schemas.messages import Judgement, Severity, StereoFrame, ThreadObservations

STILL_FRAMES, ONE_STILL_FRAMES = 30, 15
"""Of the camera: about a second, and half of one, in which no noise changed a single pixel."""
CODES = frozenset(("frozen", "no_picture", "too_dark", "too_bright", "exposures_differ"))
"""Of what is judged in every frame anew."""

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]


@dataclass(frozen=True)
class Pictured:
    """Which pictures a frame brought.

    Fields:
        sequence: of the frame.
        left, right: checksums of its pictures.
        left_since, right_since: sequence of the first frame in turn that had the same picture.
    """

    sequence: int
    left: int
    right: int
    left_since: int
    right_since: int


def pictured(frame: StereoFrame, last: ThreadObservations | None) -> Pictured:
    """The pictures of a frame, and since when they have been the same."""
    sequence = frame.stamp.sequence
    left, right = zlib.crc32(frame.left.data), zlib.crc32(frame.right.data)
    left_since = right_since = sequence
    if last is not None and last.stamp.sequence < sequence:
        left_since = last.picture_left_since if left == last.picture_left else sequence
        right_since = last.picture_right_since if right == last.picture_right else sequence
    return Pictured(sequence, left, right, left_since, right_since)


def one_eye_stands_still(seen: Pictured) -> str:
    """Why a frame cannot be used of which one eye stands still while the other one goes on; empty where it can."""
    for eye, since, other in (
        ("left", seen.left_since, seen.right_since),
        ("right", seen.right_since, seen.left_since),
    ):
        if seen.sequence - since >= ONE_STILL_FRAMES and other == seen.sequence:
            return (
                f"the {eye} eye has shown the very same picture since frame {since}, and the other one goes on; "
                "restart the camera or its frame grabber"
            )
    return ""


def judge_each(seen: Pictured, images: Pair) -> tuple[Judgement, ...]:
    """What is wrong with the pictures of a frame."""
    exposed = judgements([about_exposure(*images)])
    since = max(seen.left_since, seen.right_since)
    if seen.sequence - since < STILL_FRAMES:
        return exposed
    finding = f"both eyes have shown the very same picture since frame {since}"
    remedy = "restart the camera or its frame grabber; an image from a file stands still, and is no camera"
    return (*exposed, Judgement("frozen", Severity.WARNING, finding, remedy))


def lasting(found: tuple[Judgement, ...]) -> tuple[Judgement, ...]:
    """Those judgements that were not of one frame alone."""
    return tuple(judgement for judgement in found if judgement.code not in CODES)
