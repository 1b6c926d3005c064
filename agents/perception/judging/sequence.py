"""What only several frames tell: whether a picture stands still, and whether both eyes see the same moment.

How much each eye's picture changes from frame to frame is a signal of its own. Where the scene or the camera moves,
both eyes' signals rise and fall together; where one eye is late, its signal is that of the other one, so many frames
later (the lag at which they correlate best).
"""

import itertools

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.perception.judging.answers import Answer, untold, well, wrong
from schemas.messages import FrameStamp, Severity

FROZEN, TOGETHER = "frozen", "both eyes at one moment"
WIDTH_PX = 160
"""Of the reduced images whose change is looked at."""
FEWEST = 8
"""Frames: fewer tell nothing."""
REPEATED = 5
"""Times in a row that the very same picture may come: a camera that is slower than its output repeats some."""
LONGEST_LAG = 4
LEAST_CHANGE = 1.0
"""Grey levels by which the change itself must vary, to be told from noise."""
CORRELATED, CLEARLY = 0.8, 0.1
"""Of the eyes' signals at the best lag, and by how much more than without any."""
MS = 1e-6

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]


def about_sequence(pairs: list[Pair], stamps: list[FrameStamp]) -> list[Answer]:
    """Whether the pictures of some frames in turn go on, in both eyes, and together."""
    if len(pairs) < FEWEST:
        return [untold(FROZEN, f"only {len(pairs)} frames came"), untold(TOGETHER, f"only {len(pairs)} frames came")]
    left, right = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    changes = np.array([changes_of(left), changes_of(right)])
    sequence = np.array([stamp.sequence for stamp in stamps])
    return [
        about_repeats(longest_repeat(left), longest_repeat(right), len(pairs)),
        about_lag(changes, sequence, stamps),
    ]


def longest_repeat(images: list[UInt8[np.ndarray, "h w *c"]]) -> int:
    """How many times in a row at most the very same picture came again."""
    longest = run = 0
    for before, image in itertools.pairwise(images):
        run = run + 1 if np.array_equal(before, image) else 0
        longest = max(longest, run)
    return longest


def about_repeats(left: int, right: int, frames: int) -> Answer:
    """Whether either eye stands still, by how often it repeated a picture in a row."""
    still = [eye for eye, times in (("left", left), ("right", right)) if times >= REPEATED]
    if not still:
        return well(FROZEN, f"the pictures change, in all of {frames} frames")
    remedy = "restart the camera or its frame grabber; an image from a file stands still, and is no camera"
    if len(still) == 2:
        finding = f"both eyes show the very same picture for {min(left, right) + 1} frames"
        return wrong(FROZEN, "frozen", Severity.WARNING, finding, remedy)
    finding = f"the {still[0]} eye shows the very same picture for {max(left, right) + 1} frames, and the other goes on"
    return wrong(FROZEN, "frozen", Severity.FAULT, finding, remedy)


def changes_of(images: list[UInt8[np.ndarray, "h w *c"]]) -> Float64[np.ndarray, "n"]:
    """Mean change of the grey levels from each frame to the next."""
    small = [_small(image) for image in images]
    return np.array([float(cv2.absdiff(a, b).mean()) for a, b in itertools.pairwise(small)])


def about_lag(changes: Float64[np.ndarray, "2 n"], sequence: np.ndarray, stamps: list[FrameStamp]) -> Answer:
    """Whether both eyes see the same moment, by their stamps and by what moves in them."""
    apart_ms = max(abs(stamp.capture_left_ns - stamp.capture_right_ns) for stamp in stamps) * MS
    period_ms = float(np.median(np.diff([stamp.capture_left_ns for stamp in stamps]))) * MS
    if period_ms > 0 and apart_ms > period_ms:
        finding = f"the eyes were captured up to {apart_ms:.0f} ms apart, and a frame lasts {period_ms:.0f} ms"
        return wrong(TOGETHER, "unsynchronised", Severity.FAULT, finding, "synchronise the eyes of the camera")
    if min(np.ptp(change) for change in changes) < LEAST_CHANGE:
        return untold(TOGETHER, "hardly anything moved; move the camera, and look again")
    if (np.diff(sequence) != 1).any():
        return untold(TOGETHER, "frames were left out on their way here")
    lags = range(-LONGEST_LAG, LONGEST_LAG + 1)
    alike = {lag: correlation_at(changes, lag) for lag in lags}
    best = max(alike, key=alike.__getitem__)
    if best and alike[best] > CORRELATED and alike[best] > alike[0] + CLEARLY:
        late, frames = ("right" if best > 0 else "left"), f"{abs(best)} frame{'s' if abs(best) > 1 else ''}"
        finding = f"the {late} eye is {frames} late: it moves as the other one did before"
        remedy = "start both eyes' grabbers together, or use one that captures both in one image"
        return wrong(TOGETHER, "unsynchronised", Severity.FAULT, finding, remedy)
    if alike[0] < CORRELATED:
        return untold(TOGETHER, "the eyes do not move alike enough to compare")
    return well(TOGETHER, "what moves does so in both eyes in the same frame")


def correlation_at(changes: Float64[np.ndarray, "2 n"], lag: int) -> float:
    """Of the left eye's changes with the right eye's so many frames later."""
    count = changes.shape[1] - abs(lag)
    left, right = changes[0, max(-lag, 0) :][:count], changes[1, max(lag, 0) :][:count]
    if min(np.ptp(left), np.ptp(right)) == 0:
        return 0.0
    return float(np.corrcoef(left, right)[0, 1])


def _small(image: UInt8[np.ndarray, "h w *c"]) -> UInt8[np.ndarray, "h w"]:
    share = min(1.0, WIDTH_PX / image.shape[1])
    size = max(1, round(share * image.shape[1])), max(1, round(share * image.shape[0]))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(small, cv2.COLOR_BGR2GRAY) if small.ndim == 3 else small
