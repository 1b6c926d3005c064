"""Colours of the viewer, in RGB; confidence runs from red over yellow to green."""

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from schemas.messages import Occluder, Phase

STOPS = np.array([[222, 45, 38], [255, 221, 51], [49, 190, 90]], dtype=np.float64)
"""Colours at confidence 0, 0.5 and 1."""

UNKNOWN = (170, 170, 175)
"""Thread whose confidence nobody has estimated, or that not both images show."""

BACKGROUND = (24, 24, 28)
PANEL = (38, 38, 44)
GRID = (70, 70, 78)
TEXT = (232, 232, 236)
MUTED = (165, 165, 172)
MASK = (0, 190, 255)
OBSERVATION = (255, 255, 255)
CENTRELINE = (255, 255, 255)
LEFT_EYE, RIGHT_EYE = (255, 170, 90), (120, 190, 255)
"""Residuals of either image, where both stand in one plot."""
BAND = (90, 120, 170)
KEPT = (120, 170, 255)
REJECTED = (255, 120, 210)
OUTSIDE = (255, 90, 220)
GOOD = (49, 150, 80)
BAD = (200, 45, 40)
WARNING = (255, 190, 60)
BAD_TEXT = (255, 125, 115)
TRUTH = (150, 150, 158)
CHOSEN = (110, 255, 150)
TOOL = (205, 214, 230)
SHAFT = (120, 128, 145)
AXES = ((240, 80, 80), (90, 220, 110), (90, 140, 255))
"""Of the x, y and z axis."""

REASONS = (
    (255, 110, 90),
    (255, 175, 60),
    (120, 170, 255),
    (235, 110, 255),
    (90, 215, 225),
    (190, 160, 120),
    (255, 120, 190),
    (150, 130, 255),
)
"""What speaks against a capture, in the order in which it was first said."""

CANDIDATES = (
    (70, 225, 240),
    (255, 150, 215),
    (255, 185, 90),
    (165, 150, 255),
    (190, 225, 120),
    (225, 225, 225),
)
"""Of the threads that perception tells apart, the one that is meant first."""

FAINT = 70
"""Opacity, of 255, of what stands behind the thread."""

OCCLUDERS = {Occluder.TOOL: (95, 130, 255), Occluder.NEEDLE: (255, 220, 90), Occluder.UNKNOWN: (200, 110, 230)}
"""Of what may hide thread."""

PHASES = {
    Phase.APPROACH: (150, 160, 255),
    Phase.CAPTURE: (255, 170, 60),
    Phase.SLIDE: (60, 210, 255),
    Phase.GRASP: (235, 110, 255),
    Phase.RETREAT: (140, 145, 165),
    Phase.PULL: (255, 120, 90),
    Phase.RELEASE: (175, 180, 195),
}
"""Parts of a grasp, in none of the colours of confidence."""

STATES = {
    "ok": GOOD,
    "caught": GOOD,
    "finished": GOOD,
    "failed": BAD,
    "missed": BAD,
    "lost": BAD,
    "started": BAND,
    "continued": GOOD,
    "restarted": WARNING,
    "fault": BAD,
    "holding": WARNING,
    "held": WARNING,
    "idle": GRID,
    "disabled": GRID,
    "accepted": BAND,
    "moving": BAND,
    **{phase.name.lower(): rgb for phase, rgb in PHASES.items()},
}
"""What lanes show."""


def candidate_rgb(number: int) -> tuple[int, int, int]:
    """The colour of a candidate, from 0 on; they repeat."""
    return CANDIDATES[number % len(CANDIDATES)]


def confidence_rgb(confidence: Float64[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 3"]:
    """Colours of confidences from 0 (red) over 0.5 (yellow) to 1 (green), grey where it is NaN."""
    known = np.isfinite(confidence)
    at = np.linspace(0.0, 1.0, len(STOPS))
    channels = [np.interp(np.where(known, confidence, 0.0), at, stops) for stops in STOPS.T]
    return np.where(known[:, None], np.rint(np.stack(channels, axis=1)), UNKNOWN).astype(np.uint8)


def thread_rgb(confidence: Float64[np.ndarray, "n"], unseen: Bool[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 3"]:
    """Colours of thread: by confidence, grey where that is unknown or where not both images show the thread."""
    return confidence_rgb(np.where(unseen, np.nan, confidence))
