"""Sightings of a tool and poses of a robot out of files, for the hand-eye calibration."""

import csv
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64

from schemas.codec import decode
from schemas.messages import RobotState, StereoCalibration
from schemas.topics import ROBOT_STATE, topic_of
from shared.calibration import CalibrationError
from shared.calibration.hand_eye.samples import Motion, Sightings
from shared.camera import camera_matrix, is_rectified
from shared.kinematics.psm import JOINT_NAMES, forward
from shared.recording.entry import RecordingError
from shared.recording.mcap_file import read_recording
from shared.rectification import RectificationError, rectification
from shared.rigid_transforms import rotation_from_quaternion, transform

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
        CalibrationError: where it is no recording, or holds no state of that arm.
    """
    states: list[RobotState] = []
    try:
        for entry in read_recording(path):
            if topic_of(entry.key) is ROBOT_STATE and entry.key.split("/")[3] == arm:
                states.append(decode(RobotState, entry.payload))
    except (RecordingError, OSError) as error:
        raise CalibrationError(f"{path}: {error}") from None
    if not states:
        raise CalibrationError(f"{path}: it holds no state of an arm {arm!r}")
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
    size, T = (calibration.image_width, calibration.image_height), np.array(calibration.T_right_left)
    eyes = [
        (np.array(calibration.K_left), np.array(calibration.distortion_left)),
        (np.array(calibration.K_right), np.array(calibration.distortion_right)),
    ]
    eyes = [(K_eye, d if len(d) else np.zeros(5)) for K_eye, d in eyes]
    R_l, R_r, *_ = cv2.stereoRectify(*eyes[0], *eyes[1], size, T[:3, :3], T[:3, 3:].copy(), alpha=-1)
    told = [
        cv2.undistortPoints(np.ascontiguousarray(px[:, None, part]), *eye, R=R, P=K)[:, 0]
        for part, eye, R in ((slice(0, 2), eyes[0], R_l), (slice(2, 4), eyes[1], R_r))
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
