"""What a message may not say: every check of schemas/messages.py, provoked on an otherwise good message."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from schemas import messages
from schemas.checks import MessageError
from schemas.messages import Status
from schemas.messages.grasping import POSE_TOLERANCE, check_pose
from tests.schemas.drawn_messages import RECORDED


def recorded(name):
    return RECORDED[getattr(messages, name)][0]


STAMP, IMAGE, CAMERA, FRAME = map(recorded, ("FrameStamp", "Image", "RectifiedStereo", "StereoFrame"))
CALIBRATION, SEEN = recorded("StereoCalibration"), np.array([[0.0, 0, 9], [1, 0, 9], [2, 0, 9]])
SOME = {"points_camera": SEEN, "half_size_px": np.ones((3, 2)), "gaps": np.array([1])}
OBSERVATIONS = replace(recorded("ThreadObservations"), **SOME)
CENTRELINES = messages.Centrelines(np.ones((2, 2)), np.array([0, 1]), np.ones(2), np.ones(2))
REGIONS = messages.ReliabilityRegions(np.array([0.0, 1]), np.ones((2, 3)), np.ones((2, 2)), np.ones(2), np.zeros(2))
CURVE = {"degree": 1, "knots": np.array([0.0, 0, 1, 1]), "control_points_camera": np.ones((2, 3))}
CONFIDENT = {"confidence_s": np.array([0.0, 1]), "confidence": np.array([0.0, 1])}
RECONSTRUCTION = replace(recorded("ThreadReconstruction"), **CURVE, **CONFIDENT)
T_RIGHT_LEFT = np.eye(4) + np.eye(4, k=3) * -5.0


def with_entry(matrix, index, value):
    changed = np.array(matrix)
    changed[index] = value
    return changed


DOUBLED = {"knots": np.array([0.0, 0, 0.5, 0.5, 1, 1]), "control_points_camera": np.ones((4, 3))}
REFUSED = [
    (IMAGE, {"width": 0}, "Image size must be positive, not 0x2"),
    (IMAGE, {"channels": 2}, "channels must be 1 or 3, not 2"),
    (IMAGE, {"data": bytes(7)}, "holds 7 bytes where .* has 6"),
    (IMAGE, {"encoding": messages.ImageEncoding.PNG, "data": b""}, r"Image\.data is empty"),
    (STAMP, {"sequence": -1}, "sequence must not be negative, and is -1"),
    (FRAME, {"right": replace(IMAGE, width=2, height=3)}, "left is 3x2, right is 2x3"),
    (CALIBRATION, {"image_height": 0}, "must be positive, not .*x0"),
    (CALIBRATION, {"image_width": 16385}, "16385x.* px, and no side may exceed 16384"),
    (CALIBRATION, {"K_right": np.diag([9.0, -9, 1])}, "right focal lengths must be positive"),
    (CALIBRATION, {"K_left": with_entry(CALIBRATION.K_left, (2, 0), 1.0)}, "last row of the left camera matrix"),
    (CALIBRATION, {"distortion_left": np.zeros(6)}, "left camera has 6 distortion"),
    (CALIBRATION, {"T_right_left": with_entry(T_RIGHT_LEFT, (3, 0), 1.0)}, "last row of T_right_left"),
    (CALIBRATION, {"T_right_left": with_entry(T_RIGHT_LEFT, (0, 1), 0.1)}, "not orthonormal"),
    (CALIBRATION, {"T_right_left": with_entry(T_RIGHT_LEFT, (0, 0), -1.0)}, "no rotation"),
    (CALIBRATION, {"T_right_left": np.eye(4)}, "baseline between the cameras is zero"),
    (CALIBRATION, {"metres_per_unit": 0.0}, "metres_per_unit must be positive, not 0.0"),
    (CAMERA, {"image_width": 0}, "rectified image size"),
    (CAMERA, {"fy_px": 0.0}, "rectified focal lengths"),
    (CAMERA, {"baseline": -5.0}, "baseline must be positive, not -5.0"),
    (OBSERVATIONS, {"status": Status.FAILED}, "a failure needs a reason"),
    (OBSERVATIONS, {"reason": "too dark"}, "a success has none"),
    (OBSERVATIONS, {"points_camera": with_entry(np.ones((3, 3)), (1, 2), -9.0)}, "behind the camera"),
    (OBSERVATIONS, {"half_size_px": np.zeros((3, 2))}, "half_size_px must be positive"),
    (OBSERVATIONS, {"gaps": np.array([2])}, "a gap must lie between"),
    (CENTRELINES, {"piece": np.array([1, 0])}, "points of each piece must follow"),
    (CENTRELINES, {"piece": np.array([-1, 0])}, "pieces are numbered from 0"),
    (CENTRELINES, {"width_px": np.zeros(2)}, "width of the thread must be positive"),
    (CENTRELINES, {"deviation_px": np.zeros(2)}, "deviation of a point must be positive"),
    (REGIONS, {"s": np.array([1.0, 0])}, "parameters of the regions must not decrease"),
    (REGIONS, {"s": np.array([0.0, 1.1])}, "regions.s must lie"),
    (REGIONS, {"bound_px": np.zeros((2, 2))}, "bounds must be positive"),
    (REGIONS, {"bound_depth": np.zeros(2)}, "bounds must be positive"),
    (REGIONS, {"slack": np.array([0.0, -1])}, "slack must not be negative"),
    (RECONSTRUCTION, {"status": Status.FAILED}, "a failure needs a reason"),
    (RECONSTRUCTION, {"status": Status.FAILED, "reason": "too dark"}, "a failed reconstruction has no control points"),
    (RECONSTRUCTION, {"confidence": np.array([0.0, 1.1])}, "confidence must lie within 0 and 1"),
    (RECONSTRUCTION, {"confidence_s": np.array([0.0, 1.1])}, "confidence_s must lie"),
    (RECONSTRUCTION, {"unseen": np.array([[-0.1, 0.2]])}, "unseen must lie"),
    (RECONSTRUCTION, {"degree": 0}, "degree of a spline must be at least 1"),
    (RECONSTRUCTION, {"degree": 2}, "degree 2 needs more than 2 control points"),
    (RECONSTRUCTION, {"knots": np.array([0.0, 0, 1])}, "need 4 knots, not 3"),
    (RECONSTRUCTION, {"knots": np.array([0.0, 0.5, 1, 1])}, "first and the last 2 knots"),
    (RECONSTRUCTION, DOUBLED, "the knots within must increase"),
]


@pytest.mark.parametrize(("message", "changes", "text"), REFUSED)
def test_a_message_that_contradicts_itself_is_refused(message, changes, text):
    with pytest.raises(MessageError, match=text):
        replace(message, **changes)


@given(
    turn=hnp.arrays(float, 3, elements=st.floats(-3, 3)),
    spoilt=hnp.arrays(
        float, (3, 3), elements=st.sampled_from([0.0, 0.0, 0.0, 1e-7, 1e-3, 1.0, 1e200, -2.0, np.nan, np.inf])
    ),
)
def test_a_pose_is_judged_as_its_matrix_is(turn, spoilt):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(turn).as_matrix() + spoilt
    R = T[:3, :3]
    with np.errstate(all="ignore"):
        off = np.abs(R @ R.T - np.eye(3)).max()
        is_rotation = bool(off < POSE_TOLERANCE and np.linalg.det(R) > 0)
    assume(not 0.9 < off / POSE_TOLERANCE < 1.1)
    with contextlib.nullcontext() if is_rotation else pytest.raises(MessageError, match="no rotation"):
        check_pose("it", T)
