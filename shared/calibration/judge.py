"""What is doubtful about a calibration: findings that say what to do, and an error where it cannot be used at all.

Left, right, beside and below are judged as cv2.stereoRectify sees them: it turns each camera half of the way to the
other and takes the baseline there.
"""

import numpy as np
from jaxtyping import Float64

from schemas.messages import ROTATION_TOLERANCE, Judgement, Severity, StereoCalibration
from shared.calibration.stated import CalibrationError
from shared.rigid_transforms import exp_so3, log_so3, nearest_rotation, orthonormality_error
from shared.units import unit_name

_REPAIRED_ABOVE = 1e-9
"""Orthonormality error that is worth a repair; below it, a file that was written here comes back as it was."""

_REPORTED_ABOVE = 2e-4
"""Orthonormality error that rounding to four digits does not explain."""

_ENDOSCOPE_BASELINE_MM = (1.0, 20.0)
_WIDEST_ANGLE_DEG = 30.0
_FOCAL_LENGTH_OF_WIDTH = (0.2, 20.0)
_IMAGE_MARGIN = 0.05
"""Share of the image beside its border that no principal point of a real camera lies in."""

_SKEW_LIMIT_PX = 0.1


def repaired_rotation(R: Float64[np.ndarray, "3 3"]) -> tuple[Float64[np.ndarray, "3 3"], tuple[Judgement, ...]]:
    """The nearest rotation, with a warning where the matrix is further off than rounding explains.

    Raises:
        CalibrationError: where it is no rotation at all.
    """
    error = float(orthonormality_error(R))
    if np.linalg.det(R) < 0 and error < ROTATION_TOLERANCE:
        raise CalibrationError("its R mirrors space (determinant -1), so it is no rotation; calibrate again")
    if error >= ROTATION_TOLERANCE:
        raise CalibrationError(f"its R is no rotation: its rows are not orthonormal (by {error:.2g}); calibrate again")
    if error < _REPAIRED_ABOVE:
        return R, ()
    repaired = nearest_rotation(R)
    if error < _REPORTED_ABOVE:
        return repaired, ()
    off_deg = np.degrees(np.linalg.norm(R - repaired, ord=2))
    finding = f"The rotation between the cameras is not orthonormal: directions are up to {off_deg:.3f} degrees off."
    remedy = "The nearest rotation was taken; write the file with at least six digits, or calibrate again."
    return repaired, (Judgement("rotation_not_orthonormal", Severity.WARNING, finding, remedy),)


def judgements(calibration: StereoCalibration) -> tuple[Judgement, ...]:
    """Everything doubtful about a calibration, the gravest first.

    Raises:
        CalibrationError: where the cameras do not stand side by side.
    """
    found = (
        *_sides(calibration),
        *_angle(calibration),
        *_camera("left", calibration.K_left, calibration),
        *_camera("right", calibration.K_right, calibration),
        *_length(calibration),
    )
    return tuple(sorted(found, key=lambda judgement: -judgement.severity.value))


def _sides(calibration: StereoCalibration) -> tuple[Judgement, ...]:
    x, y, z = _rectified_translation(calibration)
    if abs(y) >= abs(x) or abs(z) >= abs(x):
        direction = "above one another" if abs(y) >= abs(z) else "one behind the other"
        raise CalibrationError(
            f"its cameras stand {direction} rather than side by side; "
            "turn the images upright, or check the order of the translation's components"
        )
    if x < 0:
        return ()
    finding = "The right camera stands to the left of the left one, so every disparity would be negative."
    remedy = "Swap left and right, or invert the transform if the file maps right to left; T must begin negative."
    return (Judgement("left_and_right_swapped", Severity.FAULT, finding, remedy),)


def _rectified_translation(calibration: StereoCalibration) -> Float64[np.ndarray, "3"]:
    half_way_back = exp_so3(-log_so3(calibration.T_right_left[:3, :3]) / 2)
    t = half_way_back @ calibration.T_right_left[:3, 3]
    return t / np.linalg.norm(t)


def _angle(calibration: StereoCalibration) -> tuple[Judgement, ...]:
    angle_deg = float(np.degrees(np.linalg.norm(log_so3(calibration.T_right_left[:3, :3]))))
    if angle_deg < _WIDEST_ANGLE_DEG:
        return ()
    finding = (
        f"The cameras are turned against each other by {angle_deg:.0f} degrees; a stereo endoscope's are by a few."
    )
    remedy = "Check the rotation R, for example whether it was written column by column."
    return (Judgement("cameras_turned_apart", Severity.WARNING, finding, remedy),)


def _camera(side: str, K: Float64[np.ndarray, "3 3"], calibration: StereoCalibration) -> tuple[Judgement, ...]:
    size = np.array([calibration.image_width, calibration.image_height])
    size_text = f"{size[0]}x{size[1]}"
    found: list[Judgement] = []
    if ((K[:2, 2] < _IMAGE_MARGIN * size) | (K[:2, 2] > (1 - _IMAGE_MARGIN) * size)).any():
        point = f"({K[0, 2]:.0f}, {K[1, 2]:.0f})"
        finding = f"The {side} principal point {point} lies at or beyond the edge of a {size_text} image."
        remedy = "Check that the calibration belongs to images of this size, and that they are not cropped."
        found.append(Judgement("principal_point_off_image", Severity.WARNING, finding, remedy))
    shortest, longest = (share * size[0] for share in _FOCAL_LENGTH_OF_WIDTH)
    if not shortest <= K[0, 0] <= longest:
        finding = f"The {side} focal length of {K[0, 0]:.4g} px does not fit a {size_text} image."
        remedy = "Check that the camera matrix is in pixels, and of images of this size."
        found.append(Judgement("focal_length_implausible", Severity.WARNING, finding, remedy))
    skew_px = abs(K[0, 1] / K[1, 1]) * size[1] / 2
    if skew_px > _SKEW_LIMIT_PX:
        finding = f"The {side} camera matrix has a skew, which rectification ignores: up to {skew_px:.1f} px."
        remedy = "Calibrate without skew."
        found.append(Judgement("skew_ignored", Severity.WARNING, finding, remedy))
    return tuple(found)


def _length(calibration: StereoCalibration) -> tuple[Judgement, ...]:
    baseline = float(np.linalg.norm(calibration.T_right_left[:3, 3]))
    if calibration.metres_per_unit is None:
        finding = f"The calibration does not say in which unit its baseline of {baseline:.4g} is."
        remedy = "Name it, for example --unit mm; until then lengths are in that unknown unit and no robot may move."
        return (Judgement("unit_unknown", Severity.NOTE, finding, remedy),)
    baseline_mm = 1000 * baseline * calibration.metres_per_unit
    shortest, longest = _ENDOSCOPE_BASELINE_MM
    if shortest <= baseline_mm <= longest:
        return ()
    finding = f"The baseline of {baseline_mm:.4g} mm is not one of an endoscope ({shortest:.0f} to {longest:.0f} mm)."
    return (Judgement("baseline_implausible", Severity.WARNING, finding, _unit_remedy(calibration, baseline)),)


def _unit_remedy(calibration: StereoCalibration, baseline: float) -> str:
    shortest, longest = _ENDOSCOPE_BASELINE_MM
    if shortest <= baseline <= longest and unit_name(calibration.metres_per_unit) != "mm":
        return "If the file is in millimetres, say --unit mm."
    return "Check the unit of the translation; --unit names it where the file does not."
