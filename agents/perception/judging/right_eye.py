"""A right eye that is out of line, put in line before anything is looked for, where the pair itself tells by how much.

What corresponds lies in one row of a rectified pair. Of a right eye that is turned, magnified or lower against the left
one, the rows (`y` in the left image) follow from the places (u, v) in the right one as a plane,

    y − v = −t + q1 (u − cx) + q2 (v − cy),    q1 = −sin θ / m,    q2 = cos θ / m − 1,

so that the plane through many places tells all three (`shared.right_eye`). What one pair can't tell, a shift along the
rows and vergence, is not touched: depth may still be off by what moved the rows.
"""

from dataclasses import replace

import numpy as np

from agents.perception.judging.alignment import CERTAIN, ROW_FAULT_SHARE, ROW_NOTE_PX
from agents.perception.judging.correspondence import Correspondence, Plane
from schemas.messages import Judgement, RectifiedStereo, RightEye, Severity
from shared.right_eye import from_in_line, is_rows_alone, moved

SURE_PX, REFERENCE_WIDTH_PX = 0.15, 960
"""Standard deviation of an offset that is certain, in an image of that width."""
SCATTERED_PX = 0.6
"""Median distance from the plane, in such an image."""
KEPT_WITHIN_PX = 0.75
"""What was put in line before stays as it is while no corner would move by more, in such an image."""


def is_certain(seen: Correspondence | None, width: int) -> bool:
    """Whether places agree so well that what they say needs no thread to confirm it."""
    if seen is None or seen.row_deviation_px is None or seen.scatter_px is None:
        return False
    larger = max(1.0, width / REFERENCE_WIDTH_PX)
    return seen.row_deviation_px < SURE_PX * larger and seen.scatter_px < SCATTERED_PX * larger


def out_of_line(seen: Correspondence, camera: RectifiedStereo, before: RightEye | None = None) -> RightEye | None:
    """By how much the right eye is out of line; None where by too little to matter, or by more than may be mended.

    Turns and magnifications that move no border by more than a pixel are left to reconstruction, and so is what is left
    of rows: then whole rows are moved, which blurs nothing.

    Args:
        seen: certain, of the images as they come.
        before: what was put in line before.
    """
    if seen.from_right is None:
        return None
    eye = _of_plane(seen.from_right, camera)
    height, width = camera.image_height, camera.image_width
    turned_px = abs(np.radians(eye.turned_deg)) * width / 2
    larger_px = abs(eye.magnified - 1.0) * height / 2
    if max(abs(eye.rows_px), turned_px, larger_px) > ROW_FAULT_SHARE * height:
        return None
    # a plane tells its middle best
    rows = -(seen.row_residual_px or 0.0)
    by_rows = RightEye(rows, 0.0, 1.0)
    if before is not None:
        now = by_rows if is_rows_alone(before) else eye
        if _corners_apart(now, before, camera) < KEPT_WITHIN_PX * max(1.0, width / REFERENCE_WIDTH_PX):
            return before
    if max(turned_px, larger_px) > ROW_NOTE_PX and _is_turned(seen, eye):
        return eye
    return RightEye(float(round(rows)), 0.0, 1.0) if abs(rows) > ROW_NOTE_PX else None


def _is_turned(seen: Correspondence, eye: RightEye) -> bool:
    """Whether the turn, or the magnification, is no chance of where the few places lie."""
    turned = abs(eye.turned_deg) > CERTAIN * (seen.rotation_deviation_deg or 0.0)
    return turned or abs(eye.magnified - 1.0) > CERTAIN * (seen.magnification_deviation or 0.0)


def _of_plane(plane: Plane, camera: RectifiedStereo) -> RightEye:
    """What a plane about the middle of the image says, about the principal point."""
    middle = np.array([camera.image_width - 1, camera.image_height - 1]) / 2
    at_point = plane[0] + plane[1:] @ (np.array([camera.cx_px, camera.cy_px]) - middle)
    turned = np.degrees(np.arctan2(-plane[1], 1.0 + plane[2]))
    return RightEye(float(-at_point), float(turned), float(1.0 / np.hypot(plane[1], 1.0 + plane[2])))


def _corners_apart(one: RightEye, other: RightEye, camera: RectifiedStereo) -> float:
    """The greatest distance between where both put a corner, px."""
    right, bottom = camera.image_width - 1, camera.image_height - 1
    corners = np.array([(0, 0), (right, 0), (0, bottom), (right, bottom)], np.float64)
    places = [moved(corners, from_in_line(eye, camera)) for eye in (one, other)]
    return float(np.linalg.norm(places[0] - places[1], axis=1).max())


def put_in_line(eye: RightEye | None) -> tuple[Judgement, ...]:
    """What is said about an eye that was put in line."""
    if eye is None:
        return ()
    parts: list[str] = []
    if eye.rows_px:
        parts.append(f"{abs(eye.rows_px):.1f} px {'lower' if eye.rows_px > 0 else 'higher'} than in the left one")
    if eye.turned_deg:
        parts.append(f"turned by {eye.turned_deg:.2f} degrees")
    if eye.magnified != 1:
        parts.append(f"{abs(eye.magnified - 1):.2%} {'larger' if eye.magnified > 1 else 'smaller'}")
    finding = f"everything is {', '.join(parts)} in the right image; it was put in line before anything was looked for"
    remedy = "calibrate again: something has moved since, and depth may be off as well"
    return (Judgement("row_offset", Severity.WARNING, finding, remedy),)


def left_over(seen: Correspondence, eye: RightEye | None) -> Correspondence:
    """What the images still show once the right one is in line."""
    if eye is None:
        return seen
    if eye.turned_deg == 0:
        return replace(seen, row_residual_px=(seen.row_residual_px or 0.0) + eye.rows_px, off_rows_px=None)
    return replace(seen, row_residual_px=0.0, off_rows_px=None, rotation_deg=0.0, magnification=1.0)
