"""Places of the ground that both images of a pair show: matched at a reduced size, then found to a fraction of a pixel.

ORB features (Rublee et al. 2011) are matched where each is the other's best. They are found in images of `WIDTH_PX`,
where it takes a few milliseconds; what is kept of them is followed at full size from there (Lucas and Kanade 1981),
forth and back.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

WIDTH_PX = 480
"""Of the reduced images. Smaller ones are taken as they are."""
LEAST_SIDE_PX = 64
"""Smaller images have no room for features: one and its surroundings take half of that."""
FEATURES = 600
THREAD_MARGIN_PX = 16
"""Features closer to the thread than half their own window would be of the thread."""
WINDOW_PX = 21
ITERATIONS, STEP_PX = 20, 0.02
RETURNS_PX = 0.3
"""How close to its beginning a place must come that is followed to the other image and back."""

Places = Float64[np.ndarray, "n 2"]
Grey = UInt8[np.ndarray, "h w"]


@dataclass(frozen=True)
class Matched:
    """Places (u, v) in full-size pixels of the left and of the right image that look alike, to about a pixel.

    Fields:
        features: how many there were in the image that has fewer.
    """

    left: Places
    right: Places
    features: int

    def __len__(self) -> int:
        return len(self.left)

    @property
    def exchanged(self) -> "Matched":
        """With left and right exchanged."""
        return Matched(self.right, self.left, self.features)

    def only(self, which: Bool[np.ndarray, "n"]) -> "Matched":
        """Some of them."""
        return Matched(self.left[which], self.right[which], self.features)


NOTHING = Matched(np.zeros((0, 2)), np.zeros((0, 2)), 0)


def grey(image: UInt8[np.ndarray, "h w *c"]) -> Grey:
    """The image without its colours."""
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image


def matched_features(
    left: Grey,
    right: Grey,
    thread_left: Bool[np.ndarray, "h w"] | None = None,
    thread_right: Bool[np.ndarray, "h w"] | None = None,
) -> Matched:
    """Features of the ground that are each other's best match, wherever they lie.

    The thread itself is left out where it is given: each of its features looks like the next one along it.
    """
    if min(left.shape) < LEAST_SIDE_PX:
        return NOTHING
    at_left, described_left = _features(left, thread_left)
    at_right, described_right = _features(right, thread_right)
    features = min(len(at_left), len(at_right))
    if not features:
        return NOTHING
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(described_left, described_right)
    which = np.array([(m.queryIdx, m.trainIdx) for m in pairs], int).reshape(-1, 2)
    return Matched(at_left[which[:, 0]], at_right[which[:, 1]], features)


def followed(left: Grey, right: Grey, matched: Matched) -> Matched:
    """Those matches that are found again to a fraction of a pixel at full size, and lead back to where they began."""
    if not len(matched):
        return matched
    begin, end = (np.ascontiguousarray(at, np.float32)[:, None] for at in (matched.left, matched.right))
    there, seen = _flow(left, right, begin, end)
    back, seen_back = _flow(right, left, there, begin)
    returns = np.linalg.norm((back - begin)[:, 0], axis=1) < RETURNS_PX
    stays = np.linalg.norm((there - end)[:, 0], axis=1) < WINDOW_PX
    kept = returns & stays & seen & seen_back
    return Matched(matched.left[kept], there[kept, 0].astype(np.float64), matched.features)


def _flow(
    image: Grey, other: Grey, begin: Float32[np.ndarray, "n 1 2"], near: Float32[np.ndarray, "n 1 2"]
) -> tuple[Float32[np.ndarray, "n 1 2"], Bool[np.ndarray, "n"]]:
    """Where places of an image are in the other one, near where they are expected, and whether they are there."""
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        image,
        other,
        begin,
        near.copy(),
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=1,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, ITERATIONS, STEP_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found, np.float32), np.asarray(status)[:, 0] > 0


def _features(image: Grey, thread: Bool[np.ndarray, "h w"] | None) -> tuple[Places, np.ndarray]:
    """Where they are, in full-size pixels, and their descriptors."""
    share = min(1.0, WIDTH_PX / image.shape[1])
    size = max(1, round(share * image.shape[1])), max(1, round(share * image.shape[0]))
    small = image if share == 1 else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    ground = None
    if thread is not None:
        covered = cv2.resize(thread.astype(np.uint8), size, interpolation=cv2.INTER_AREA)
        ground = np.where(cv2.dilate(covered, np.ones((2 * THREAD_MARGIN_PX + 1,) * 2, np.uint8)), 0, 255)
        ground = ground.astype(np.uint8)
    found, described = cv2.ORB.create(nfeatures=FEATURES).detectAndCompute(small, ground)
    at = np.array([feature.pt for feature in found], np.float64).reshape(-1, 2)
    per_pixel = np.array(image.shape[::-1]) / size
    return (at + 0.5) * per_pixel - 0.5, described
