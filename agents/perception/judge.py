"""First judgements of a stereo pair, before any thread in it is trusted.

Inputs go wrong more often than algorithms do: images exchanged, rows that do not correspond. Texture tells best, so
feature matches are asked first; on a plain ground the two masks are all there is, and a thread seen by both eyes
covers the same rows in both.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from schemas.messages import Judgement, Severity

NO_DISPARITY_PX = 0.5
"""A thread as far away as this disparity says is out of any instrument's reach."""
LEAST_MATCHES = 25
"""Fewer agreeing feature matches say nothing about an image."""
LEAST_SIDE_PX = 64
"""Smaller images have no room for features: one and its surroundings take half of that."""
THREAD_MARGIN_PX = 16
"""Features closer to the thread than half their own window would be of the thread."""
ROW_SEARCH_SHARE = 0.04
"""How far rows are searched for each other, as a share of the image's height."""
LEAST_AGREEMENT, CLEARLY_BETTER = 0.4, 1.05
"""Of the row profiles of two masks: to say anything at all, and to say that another shift fits better than none.
Clean pairs stay below 1.01 and pairs that are 4 px apart lie above 1.06, unless the thread fills its rows evenly."""
ROW_NOTE_PX, ROW_FAULT_SHARE = 1.0, 0.01
"""A row residual above the first is worth a warning; above that share of the height, rows cannot be matched."""


@dataclass(frozen=True)
class Correspondence:
    """How the two images lie to each other, as far as they tell.

    Fields:
        row_residual_px: left row minus right row of what corresponds; None where unknown.
        disparity_px: typical left minus right column; None where unknown.
    """

    row_residual_px: float | None
    disparity_px: float | None


def correspondence_of_texture(
    left: UInt8[np.ndarray, "h w 3"],
    right: UInt8[np.ndarray, "h w 3"],
    segmented_left: Bool[np.ndarray, "h w"],
    segmented_right: Bool[np.ndarray, "h w"],
) -> Correspondence | None:
    """From matched features of the ground near the same rows; None where too few agree.

    The thread itself is left out: each of its features looks like the next one along it.
    """
    if min(left.shape[:2]) < LEAST_SIDE_PX:
        return None
    keypoints_left, descriptors_left = _ground_features(left, segmented_left)
    keypoints_right, descriptors_right = _ground_features(right, segmented_right)
    if min(len(keypoints_left), len(keypoints_right)) < LEAST_MATCHES:
        return None
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(descriptors_left, descriptors_right)
    at_left = np.array([keypoints_left[m.queryIdx].pt for m in matches])
    at_right = np.array([keypoints_right[m.trainIdx].pt for m in matches])
    shift = at_left - at_right
    middle = _densest(shift[:, 1], window=4.0)
    agreeing = np.abs(shift[:, 1] - middle) < 2.0
    if abs(middle) > ROW_SEARCH_SHARE * left.shape[0] or agreeing.sum() < max(LEAST_MATCHES, 0.25 * len(matches)):
        return None
    return Correspondence(float(np.median(shift[agreeing, 1])), float(np.median(shift[agreeing, 0])))


def correspondence_of_masks(
    segmented_left: Bool[np.ndarray, "h w"], segmented_right: Bool[np.ndarray, "h w"]
) -> Correspondence:
    """From the thread alone: the shift of rows at which both masks fill rows alike, then the columns of those rows."""
    count_left, count_right = segmented_left.sum(axis=1), segmented_right.sum(axis=1)
    if not count_left.any() or not count_right.any():
        return Correspondence(None, None)
    reach = max(2, round(ROW_SEARCH_SHARE * len(count_left)))
    shift = _row_shift(count_left, count_right, reach)
    columns = np.arange(segmented_left.shape[1])
    both = (count_left > 0) & (count_right > 0)
    if not both.any():
        return Correspondence(shift, None)
    mean_left = (segmented_left[both] @ columns) / count_left[both]
    mean_right = (segmented_right[both] @ columns) / count_right[both]
    return Correspondence(shift, float(np.median(mean_left - mean_right)))


def judge(seen: Correspondence, image_height: int) -> tuple[Judgement, ...]:
    """What is wrong with the pair, each with its remedy; a FAULT means that its matches mean nothing."""
    findings: list[Judgement] = []
    if seen.disparity_px is not None and seen.disparity_px < -1.0:
        findings.append(
            Judgement(
                "left_right_swapped",
                Severity.FAULT,
                f"left and right look exchanged: things lie {-seen.disparity_px:.0f} px further left in the left image",
                "exchange --left and --right, or the two halves of the side-by-side image",
            )
        )
    if seen.disparity_px is not None and abs(seen.disparity_px) <= NO_DISPARITY_PX:
        findings.append(
            Judgement(
                "no_disparity",
                Severity.FAULT,
                "both images show everything in the same columns, as one image given twice does",
                "give the left and the right image of one frame",
            )
        )
    if seen.row_residual_px is not None and abs(seen.row_residual_px) > ROW_NOTE_PX:
        fault = abs(seen.row_residual_px) > ROW_FAULT_SHARE * image_height
        findings.append(
            Judgement(
                "row_residual",
                Severity.FAULT if fault else Severity.WARNING,
                f"what corresponds lies {abs(seen.row_residual_px):.1f} px apart in rows, so the calibration does not "
                "fit these images",
                "use the calibration taken with this camera and focus, or calibrate again; check any cropping",
            )
        )
    return tuple(findings)


def _ground_features(image: np.ndarray, segmented: np.ndarray) -> tuple[Sequence[cv2.KeyPoint], np.ndarray]:
    beside = cv2.dilate(segmented.astype(np.uint8), np.ones((2 * THREAD_MARGIN_PX + 1,) * 2, np.uint8))
    detector = cv2.ORB.create(nfeatures=800)
    return detector.detectAndCompute(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.where(beside, 0, 255).astype(np.uint8))


def _densest(values: Float64[np.ndarray, "n"], window: float) -> float:
    """The middle of the window that holds the most values."""
    ordered = np.sort(values)
    inside = np.searchsorted(ordered, ordered + window, side="right") - np.arange(len(ordered))
    start = int(np.argmax(inside))
    return float(np.median(ordered[start : start + int(inside[start])]))


def _row_shift(count_left: np.ndarray, count_right: np.ndarray, reach: int) -> float | None:
    """The shift of rows at which both profiles agree best, 0 unless another is clearly better; None if none agrees."""
    shifts = np.arange(-reach, reach + 1)
    padded = np.pad(count_right, reach)
    shifted = np.array([padded[reach - shift : reach - shift + len(count_left)] for shift in shifts])
    agreement = np.minimum(count_left, shifted).sum(axis=1) / np.maximum(count_left, shifted).sum(axis=1)
    if agreement.max() < LEAST_AGREEMENT:
        return None
    if agreement.max() < CLEARLY_BETTER * agreement[reach]:
        return 0.0
    return float(np.median(shifts[agreement == agreement.max()]))
