"""What tells a camera's calibration from a hand-eye file: both may hold an R and a T, and nothing else in common."""

import re
from collections.abc import Iterable

from shared.calibration.documents import Document
from shared.calibration.named_matrices import named_entries

_OF_ANY_POSE = {"rotation", "translation", "unit"}
_OF_RECTIFICATION = {
    *("r1", "r2", "p1", "p2", "rl", "rr", "pl", "pr", "essentialmatrix", "fundamentalmatrix"),
    *("rectificationmatrix", "projectionmatrix", "disparitytodepth", "distortionmodel", "cameramodel"),
}
_FROM_EYE_TO_EYE = {
    *("rrightleft", "trightleft", "stereor", "stereot", "rstereo", "tstereo", "om"),
    *("l2r", "lefttoright", "left2right", "transformlefttoright", "transformrightleft"),
}
NAMED_AT_MOST = 3


def what_cameras_have(documents: Iterable[Document]) -> tuple[str, ...]:
    """Names of a file that only a camera's calibration has: matrices, distortion, image size, both eyes, rectification.

    Raises:
        CalibrationError: where two names give different values for the same thing.
    """
    entries = named_entries(documents)
    found = [name for meaning, (name, _) in entries.by_meaning.items() if meaning not in _OF_ANY_POSE]
    found += [name for name in entries.names if plain(name) in _OF_RECTIFICATION | _FROM_EYE_TO_EYE]
    return tuple(dict.fromkeys(found))[:NAMED_AT_MOST]


def plain(name: object) -> str:
    """A name without regard to case and punctuation; YAML has names that are no text."""
    return re.sub(r"[^a-z0-9]", "", str(name).lower())
