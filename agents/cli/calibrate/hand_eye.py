"""`suturegrasp calibrate hand-eye`: where an arm's base is before the camera, and what that is worth.

Sightings of a tool and poses of a robot are read from files.
"""

import csv
import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64

from agents.cli.calibrate.options import HandEye
from agents.cli.places import check_new
from agents.cli.recordings.arm_states import arm_states
from agents.launch.process import EXIT_OK
from schemas.messages import StereoCalibration
from shared.calibration import CalibrationError, read_calibration
from shared.calibration.estimation.checking import rectifying
from shared.calibration.hand_eye.estimate import Estimate, Motion, Sightings, estimated
from shared.calibration.hand_eye.file import implausible
from shared.calibration.identity import calibration_id
from shared.calibration.made import MADE, made_text
from shared.calibration.reader import stated_calibration
from shared.camera import camera_matrix, is_rectified
from shared.clock import now_ns
from shared.kinematics.psm import FINGER_M, JOINT_NAMES, forward
from shared.rectification import RectificationError, rectification
from shared.rigid_transforms import rotation_from_quaternion, transform
from shared.terminal import UsageError, complain, say, warn

PIXELS, POINTS = ("left_u", "left_v", "right_u", "right_v"), ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
JOINTS = tuple(name.replace(" ", "_") for name in JOINT_NAMES)
LARGEST_ROWS = 1_000_000
Columns = dict[str, Float64[np.ndarray, "n"]]


def sightings_in(path: Path, calibration: StereoCalibration | None) -> Sightings:
    """What a file of tips tells; pixels become those of rectified images, in metres.

    Raises:
        CalibrationError: where it has not the columns or numbers it needs, or the calibration is wanting.
    """
    table = _table(path)
    if all(name in table for name in POINTS):
        return Sightings(table["time_s"], _stacked(table, POINTS), None)
    if not all(name in table for name in PIXELS):
        raise CalibrationError(f"{path}: give columns {', '.join(PIXELS)}, or {', '.join(POINTS)}, beside time_s")
    if calibration is None:
        raise CalibrationError("pixels need --calibration, the camera's")
    if calibration.metres_per_unit is None:
        raise CalibrationError("the calibration does not say its unit of length; give --unit")
    try:
        camera = rectification(calibration).camera
    except RectificationError as error:
        raise CalibrationError(str(error)) from None
    metres = calibration.metres_per_unit
    camera = dataclasses.replace(camera, baseline=camera.baseline * metres, metres_per_unit=1.0)
    seen = _rectified(_stacked(table, PIXELS), calibration, camera_matrix(camera))
    return Sightings(table["time_s"], seen, camera)


def motion_in(path: Path) -> tuple[Motion, bool]:
    """The robot's poses in a file, and whether they tell how the tool is turned.

    Raises:
        CalibrationError: where it has not the columns or numbers it needs.
    """
    table = _table(path)
    if all(name in table for name in JOINTS):
        return _in_order(table["time_s"], forward(_stacked(table, JOINTS))), True
    if not all(name in table for name in POINTS):
        raise CalibrationError(f"{path}: give columns {', '.join(JOINTS)}, or {', '.join(POINTS)}, beside time_s")
    turned = all(name in table for name in QUATERNION)
    try:
        R = rotation_from_quaternion(_stacked(table, QUATERNION)) if turned else np.eye(3)
    except ValueError as error:
        raise CalibrationError(f"{path}: {error}") from None
    poses = transform(np.broadcast_to(R, (len(table["time_s"]), 3, 3)), _stacked(table, POINTS))
    return _in_order(table["time_s"], poses), turned


def motion_recorded(path: Path, arm: str) -> Motion:
    """The poses of an arm in a recording, its times in seconds since 1970.

    Raises:
        RecordingError, OSError: where it is no recording, or holds no state of that arm.
    """
    states = arm_states(path, arm)
    times = np.array([state.measured_ns for state in states]) * 1e-9
    return _in_order(times, np.stack([state.T_base_tool for state in states]))


def _in_order(time_s: Float64[np.ndarray, "m"], T: Float64[np.ndarray, "m 4 4"]) -> Motion:
    """Poses by their times, one of each."""
    times, first = np.unique(time_s, return_index=True)
    return Motion(times, np.ascontiguousarray(T[first], dtype=np.float64))


def _rectified(
    px: Float64[np.ndarray, "n 4"], calibration: StereoCalibration, K: Float64[np.ndarray, "3 3"]
) -> Float64[np.ndarray, "n 4"]:
    """Pixels of raw images as those of rectified ones: the points' way where `rectification` maps images."""
    if is_rectified(calibration):
        return px
    R_l, R_r, *_ = rectifying(calibration)
    eyes = (
        (px[:, :2], calibration.K_left, calibration.distortion_left, R_l),
        (px[:, 2:], calibration.K_right, calibration.distortion_right, R_r),
    )
    told = [
        cv2.undistortPoints(
            np.ascontiguousarray(part[:, None]), np.array(K_eye), np.array(d) if len(d) else np.zeros(5), R=R, P=K
        )[:, 0]
        for part, K_eye, d, R in eyes
    ]
    return np.hstack(told)


def _stacked(table: Columns, names: Sequence[str]) -> Float64[np.ndarray, "n k"]:
    return np.column_stack([table[name] for name in names])


def _table(path: Path) -> Columns:
    """The columns of a CSV file with a head, all numbers finite."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(row for _, row in zip(range(LARGEST_ROWS), file, strict=False) if row.strip()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "it is no CSV text"
        raise CalibrationError(f"{path}: it cannot be read ({reason})") from None
    head = [name.strip() for name in rows[0]] if rows else []
    if "time_s" not in head or len(set(head)) < len(head):
        raise CalibrationError(f"{path}: its first line must name its columns, each once, time_s among them")
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(head) or not all(_finite(value) for value in row):
            raise CalibrationError(f"{path}: line {line} does not hold {len(head)} finite numbers")
    if len(rows) < 2:
        raise CalibrationError(f"{path}: it holds no rows")
    values = np.array(rows[1:], dtype=np.float64)
    return dict(zip(head, values.T, strict=True))


def _finite(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


EXIT_NONE = 3
GRASPING_M = 0.001
"""What a grasp of thread needs; a registration that is coarser is told so."""
MIDDLE_OF_FIELD = np.array([0.0, 0.0, 0.09])


def run(options: HandEye) -> int:
    """Carry it out; the exit status."""
    if (options.poses is None) == (options.recording is None):
        raise UsageError("give the robot's poses by one of --poses and --recording")
    if options.output is not None:
        check_new(options.output)
    camera, turned = _camera(options), True
    sightings = sightings_in(options.tips, camera)
    if options.recording is not None:
        motion = motion_recorded(options.recording, options.arm)
    else:
        motion, turned = motion_in(options.poses or Path())
    point = np.array(options.point if options.point is not None else (0.0, 0.0, FINGER_M if turned else 0.0))
    try:
        if not turned and (options.unknown_point or options.point is not None):
            raise CalibrationError("poses without a rotation tell nothing of a point of the tool; leave --point out")
        found = estimated(sightings, motion, point, not options.unknown_point)
        if wrong := implausible(found.T_camera_base):
            raise CalibrationError(f"{wrong}: see that tips and poses are in metres, and of one tool")
    except CalibrationError as error:
        return complain(str(error), EXIT_NONE)
    for sentence in _told(found, sightings.camera is not None):
        say(sentence)
    for index in np.flatnonzero(~found.used)[:5]:
        warn(f"the sighting at {sightings.time_s[index]:.3f} s contradicts the others, or has no pose; it was left out")
    if (error_m := float(np.median(found.held_out_m))) > GRASPING_M:
        warn(
            f"{1e3 * error_m:.1f} mm is coarser than a thread: "
            "have the tool corrected from images, docs/tool_tracking.md"
        )
    if options.output is not None:
        if camera is None:
            warn("the file does not say of which camera calibration it is, which a real arm needs: give --calibration")
        options.output.write_text(_file(found, camera), encoding="utf-8")
        say(f"written to {options.output}; set T_camera_base_file to it in the arm's section of the rig")
    return EXIT_OK


def _camera(options: HandEye) -> StereoCalibration | None:
    if not options.calibration:
        return None
    size, stated = options.size, stated_calibration(options.calibration).size
    if size is None and stated is not None:
        size = stated.width, stated.height
    if size is None:
        raise CalibrationError("the calibration does not say how large its images are; give --size")
    return read_calibration(options.calibration, unit=options.unit, image_size=size).calibration


def _told(found: Estimate, pixels: bool) -> list[str]:
    x, y, z = 1e3 * found.T_camera_base[:3, 3]
    residual = f"{np.median(found.residual):.2f} px and " if pixels else ""
    apart = f"{residual}{1e3 * np.median(found.residual_m):.2f} mm"
    held = f"{np.median(found.held_out):.2f} px and " if pixels else ""
    delay = "the delay between camera and joints cannot be told, for the tool hardly moved; 0 was taken"
    if found.delay_s is not None:
        deviation = f"(deviation {1e3 * found.delay_deviation_s:.1f} ms)"
        delay = f"the camera is {1e3 * found.delay_s:+.1f} ms behind the joints {deviation}"
    counted = f"{found.used.sum()} of {len(found.used)} sightings"
    return [
        f"{counted}: the base is at ({x:.2f}, {y:.2f}, {z:.2f}) mm before the camera",
        f"left over: {apart} (median), {1e3 * found.residual_m.max():.2f} mm (most)",
        f"on sightings held out: {held}{1e3 * np.median(found.held_out_m):.2f} mm (median), "
        f"{1e3 * np.percentile(found.held_out_m, 95):.2f} mm (95 %)",
        f"by noise alone a point 90 mm before the camera is known to {1e3 * found.deviation_m(MIDDLE_OF_FIELD):.2f} mm",
        delay,
    ]


def _file(found: Estimate, camera: StereoCalibration | None) -> str:
    told: dict[str, Any] = {
        MADE: made_text(now_ns()),
        "T_camera_base": found.T_camera_base.tolist(),
        "unit": "m",
        "delay_s": found.delay_s,
        "point_tool": found.point_tool.tolist(),
        "covariance": found.covariance.tolist(),
        "residual_mm": 1e3 * float(np.median(found.residual_m)),
        "held_out_mm": 1e3 * float(np.median(found.held_out_m)),
        "sightings": int(found.used.sum()),
    }
    if camera is not None:
        told["calibration_id"] = calibration_id(camera)
    return "{\n" + ",\n".join(f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in told.items()) + "\n}\n"
