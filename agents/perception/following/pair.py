"""Both eyes' centrelines where the newest curve and the last observations have them: the quick way through most frames.

All that it goes on from is in those two. Where either eye's thread is not found again for certain, thread is looked for
pixel by pixel in the same frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.perception.both_eyes.apart import drawn_together
from agents.perception.following.appearance import pieces_of
from agents.perception.following.follow import Followed, follow
from agents.perception.following.prediction import expected
from agents.perception.following.stacked import side_by_side
from agents.perception.mask_image import drawn_mask_image
from agents.perception.prompt import followed as followed_prompt
from agents.perception.search import FRAMES_BETWEEN_LOOKS, carried_on, near_is_enough
from schemas.messages import Centrelines, FrameStamp, RectifiedStereo, ThreadObservations, ThreadReconstruction, Trail

SHIFT_BITS = 3
"""OpenCV draws to fractions of a pixel in fixed point."""
EVERY = 3
"""Of the points, which lie a pixel apart, so many make a corner."""
OVER_CUT_WIDTHS = 1.5
"""Pieces are cut about so far before a crossing, which is thread too."""
BORDER_PX = 0.5
"""Pixels on an outline are filled too."""
FULL = 255


def mask_along(followed: Followed, shape: tuple[int, ...]) -> UInt8[np.ndarray, "h w"]:
    """Coverage by the thread, 0 or 255: each piece as wide as it is, on to the crossings that cut it."""
    mask = np.zeros(shape[:2], np.uint8)
    lines, trail = followed.lines, followed.trail
    pieces = pieces_of(lines)
    for k, (a, b) in enumerate(zip(pieces.first.tolist(), pieces.last.tolist(), strict=True)):
        some = np.append(np.arange(a, b, EVERY), b)
        point, width = lines.point_px[some], lines.width_px[some]
        before = () if trail.loose_start[k] else (_beyond(point, width[0]),)
        after = () if trail.loose_end[k] else (_beyond(point[::-1], width[-1]),)
        whole = np.concatenate((*before, point, *after))
        half = np.concatenate((width[: len(before)], width, width[len(width) - len(after) :])) / 2
        outline = _outline(whole, np.maximum(half - BORDER_PX, 0.0))
        fixed = np.rint(outline * (1 << SHIFT_BITS)).astype(np.int32)[:, None]
        cv2.fillPoly(mask, [fixed], FULL, cv2.LINE_8, SHIFT_BITS)
    return mask


def _lost_an_end(before: Sequence[tuple[Centrelines, Trail]], now: Sequence[Followed]) -> bool:
    """Whether either eye's image shows fewer ends of thread than it did: the length of a strand is told by them."""
    told = [(_told(trail), _told(eye.trail)) for (_, trail), eye in zip(before, now, strict=True)]
    return any(then > seen for then, seen in told)


def _told(trail: Trail) -> int:
    return int(trail.told_start.sum() + trail.told_end.sum())


def _outline(point: Float64[np.ndarray, "n 2"], half_px: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "m 2"]:
    """A line's, so far to either side: back along the other one."""
    ahead = np.concatenate((point[1:], point[-1:]))
    u, v = (ahead - np.concatenate((point[:1], point[:-1]))).T
    aside = np.stack((-v, u), axis=1) * (half_px / np.maximum(np.sqrt(u * u + v * v), 1e-9))[:, None]
    return np.concatenate((point + aside, (point - aside)[::-1]))


def _beyond(point: Float64[np.ndarray, "n 2"], width: float) -> Float64[np.ndarray, "1 2"]:
    """Straight on from the first of these points."""
    way = point[0] - point[min(len(point) - 1, 2)]
    return point[:1] + OVER_CUT_WIDTHS * width * way / max(float(np.hypot(*way)), 1e-9)


LONGEST_PAUSE = 150
"""Of the camera's frames: about five seconds. Whether the thread still lies where it was, its profiles say; who looked
at the whole after each pause in which a slow machine sees nothing would be slow for that."""

Pair = tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]


@dataclass(frozen=True)
class FollowedPair:
    """A pair in which the thread was followed.

    Fields:
        observed: with the candidates and occluders of the frame before, and all strands among its centrelines, until
            they are told apart anew.
        coverage: by thread, as drawn.
    """

    observed: ThreadObservations
    coverage: Pair


def follow_pair(
    stamp: FrameStamp,
    camera: RectifiedStereo,
    images: Pair,
    last: ThreadObservations,
    between: int = FRAMES_BETWEEN_LOOKS,
    thread: ThreadReconstruction | None = None,
) -> FollowedPair | None:
    """Observations of a pair by following the last ones, strands included; None where thread is to be looked for.

    Args:
        images: rectified, the right eye put in line as for the last observations.
        between: how many of the camera's frames there are between two looks at the whole.
        thread: the newest curve; None where there is none that can be expected still.
    """
    if last.trail_left is None or last.trail_right is None:
        return None
    if not near_is_enough(last, stamp.sequence, LONGEST_PAUSE, between):
        return None
    before = (
        side_by_side(
            [last.centrelines_left, *(strand.centrelines_left for strand in last.strands)],
            [last.trail_left, *(strand.trail_left for strand in last.strands)],
        ),
        side_by_side(
            [last.centrelines_right, *(strand.centrelines_right for strand in last.strands)],
            [last.trail_right, *(strand.trail_right for strand in last.strands)],
        ),
    )
    where = expected(camera, before, thread, last.stamp.capture_left_ns, stamp.capture_left_ns)
    found = where if isinstance(where, str) else follow(images, where)
    if isinstance(found, str) or (last.strands and _lost_an_end(before, found)):
        return None
    lines = drawn_together(images, (found[0].lines, found[1].lines), shown_px=last.disparities_px)
    left, right = (replace(eye, lines=line) for eye, line in zip(found, lines, strict=True))
    coverage = mask_along(left, images[0].shape), mask_along(right, images[1].shape)
    mask_left, mask_right = (drawn_mask_image(mask) for mask in coverage)
    nothing = np.zeros((0, 3))
    observed = replace(
        last,
        stamp=stamp,
        camera=camera,
        points_camera=nothing,
        half_size_px=nothing[:, :2],
        matched_px=nothing,
        match_cost=nothing[:, :2],
        inlier=np.zeros(0, bool),
        gaps=np.zeros(0, np.int64),
        mask_left=mask_left,
        mask_right=mask_right,
        judgements=carried_on(last),
        centrelines_left=left.lines,
        centrelines_right=right.lines,
        trail_left=left.trail,
        trail_right=right.trail,
        strands=(),
        prompt_px=None if last.prompt_px is None else followed_prompt(last.prompt_px, coverage[0]),
        frames_since_look=last.frames_since_look + 1,
        consumed=(),
    )
    return FollowedPair(observed, coverage)
