"""What a message may not say: every check of schemas/messages.py, provoked on an otherwise good message."""

import contextlib
import dataclasses

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from schemas.checks import MessageError
from schemas.messages import (
    Centrelines,
    FrameStamp,
    Image,
    ImageEncoding,
    RectifiedStereo,
    ReliabilityRegions,
    Status,
    StereoCalibration,
    StereoFrame,
    ThreadObservations,
    ThreadReconstruction,
)
from schemas.messages.grasping import POSE_TOLERANCE, check_pose

STAMP = FrameStamp(3, 100, 110, "bench")
IMAGE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))
CAMERA = RectifiedStereo(4, 2, 100.0, 100.0, 2.0, 1.0, 5.0, 1e-3)
T_RIGHT_LEFT = np.eye(4) + np.eye(4, k=3) * -5.0
CALIBRATION = StereoCalibration(
    4, 2, np.diag([9.0, 9, 1]), np.diag([9.0, 9, 1]), np.zeros(5), np.zeros(0), T_RIGHT_LEFT, None
)
OBSERVATIONS = ThreadObservations(
    stamp=STAMP,
    camera=CAMERA,
    status=Status.OK,
    reason="",
    segmenter="truth",
    points_camera=np.array([[0.0, 0, 9], [1, 0, 9], [2, 0, 9]]),
    half_size_px=np.ones((3, 2)),
    matched_px=np.ones((2, 3)),
    match_cost=np.ones((2, 2)),
    inlier=np.ones(2, bool),
    mask_left=IMAGE,
    mask_right=IMAGE,
    gaps=np.array([1]),
)
CENTRELINES = Centrelines(np.ones((2, 2)), np.array([0, 1]), np.ones(2), np.ones(2))
REGIONS = ReliabilityRegions(np.array([0.0, 1]), np.ones((2, 3)), np.ones((2, 2)), np.ones(2), np.zeros(2))
RECONSTRUCTION = ThreadReconstruction(
    stamp=STAMP,
    camera=CAMERA,
    status=Status.OK,
    reason="",
    method="paper",
    degree=1,
    knots=np.array([0.0, 0, 1, 1]),
    control_points_camera=np.ones((2, 3)),
    regions=REGIONS,
    confidence_s=np.array([0.0, 1]),
    confidence=np.array([0.0, 1]),
)


def with_entry(matrix, index, value):
    changed = np.array(matrix)
    changed[index] = value
    return changed


REFUSED = {
    "an image without width": (IMAGE, {"width": 0}, "Image size must be positive, not 0x2"),
    "an image of two channels": (IMAGE, {"channels": 2}, "channels must be 1 or 3, not 2"),
    "a raw image with pixels missing": (IMAGE, {"data": bytes(7)}, "holds 7 bytes where .* has 8"),
    "an empty PNG": (IMAGE, {"encoding": ImageEncoding.PNG, "data": b""}, r"Image\.data is empty"),
    "a negative sequence": (STAMP, {"sequence": -1}, "sequence must not be negative, and is -1"),
    "eyes of two sizes": (
        StereoFrame(STAMP, IMAGE, IMAGE),
        {"right": Image(ImageEncoding.RAW, 2, 4, 1, bytes(8))},
        "left is 4x2, right is 2x4",
    ),
    "a calibration without size": (CALIBRATION, {"image_height": 0}, "must be positive, not 4x0"),
    "a calibration for absurd images": (
        CALIBRATION,
        {"image_width": 16385},
        "16385x2 px, and no side may exceed 16384",
    ),
    "a negative focal length": (
        CALIBRATION,
        {"K_right": np.diag([9.0, -9, 1])},
        "right focal lengths must be positive",
    ),
    "a camera matrix that is not affine": (
        CALIBRATION,
        {"K_left": with_entry(CALIBRATION.K_left, (2, 0), 1.0)},
        "last row of the left camera matrix",
    ),
    "six distortion coefficients": (CALIBRATION, {"distortion_left": np.zeros(6)}, "left camera has 6 distortion"),
    "a transform that is not affine": (
        CALIBRATION,
        {"T_right_left": with_entry(T_RIGHT_LEFT, (3, 0), 1.0)},
        "last row of T_right_left",
    ),
    "a shear for a rotation": (
        CALIBRATION,
        {"T_right_left": with_entry(T_RIGHT_LEFT, (0, 1), 0.1)},
        "not orthonormal",
    ),
    "a mirror for a rotation": (
        CALIBRATION,
        {"T_right_left": with_entry(T_RIGHT_LEFT, (0, 0), -1.0)},
        "no rotation",
    ),
    "cameras in one place": (CALIBRATION, {"T_right_left": np.eye(4)}, "baseline between the cameras is zero"),
    "a unit of no length": (CALIBRATION, {"metres_per_unit": 0.0}, "metres_per_unit must be positive, not 0.0"),
    "a rectified camera without size": (CAMERA, {"image_width": 0}, "rectified image size"),
    "a rectified camera without focal length": (CAMERA, {"fy_px": 0.0}, "rectified focal lengths"),
    "eyes that are swapped": (CAMERA, {"baseline": -5.0}, "baseline must be positive, not -5.0"),
    "a rectified unit of negative length": (CAMERA, {"metres_per_unit": -1.0}, "metres_per_unit must be positive"),
    "a failure without reason": (OBSERVATIONS, {"status": Status.FAILED}, "a failure needs a reason"),
    "a success with a reason": (OBSERVATIONS, {"reason": "too dark"}, "a success has none"),
    "an observation behind the camera": (
        OBSERVATIONS,
        {"points_camera": with_entry(OBSERVATIONS.points_camera, (1, 2), -9.0)},
        "behind the camera",
    ),
    "an observation of no size": (OBSERVATIONS, {"half_size_px": np.zeros((3, 2))}, "half_size_px must be positive"),
    "a gap after the last observation": (OBSERVATIONS, {"gaps": np.array([2])}, "a gap must lie between"),
    "a piece in two places": (CENTRELINES, {"piece": np.array([1, 0])}, "points of each piece must follow"),
    "a piece without number": (CENTRELINES, {"piece": np.array([-1, 0])}, "pieces are numbered from 0"),
    "a centreline of no width": (CENTRELINES, {"width_px": np.zeros(2)}, "width of the thread must be positive"),
    "a centreline beyond doubt": (CENTRELINES, {"deviation_px": np.zeros(2)}, "deviation of a point must be positive"),
    "regions out of order": (REGIONS, {"s": np.array([1.0, 0])}, "parameters of the regions must not decrease"),
    "a region of no width": (REGIONS, {"bound_px": np.zeros((2, 2))}, "bounds must be positive"),
    "a region of no depth": (REGIONS, {"bound_depth": np.zeros(2)}, "bounds must be positive"),
    "negative slack": (REGIONS, {"slack": np.array([0.0, -1])}, "slack must not be negative"),
    "a failed reconstruction without reason": (RECONSTRUCTION, {"status": Status.FAILED}, "a failure needs a reason"),
    "too much confidence": (RECONSTRUCTION, {"confidence": np.array([0.0, 1.1])}, "confidence must lie within 0 and 1"),
    "too few control points": (RECONSTRUCTION, {"degree": 2}, "degree 2 needs more than 2 control points"),
    "too few knots": (RECONSTRUCTION, {"knots": np.array([0.0, 0, 1])}, "need 4 knots, not 3"),
    "knots that are not clamped": (RECONSTRUCTION, {"knots": np.array([0.0, 0.5, 1, 1])}, "first and the last 2 knots"),
    "knots within that do not increase": (
        RECONSTRUCTION,
        {"knots": np.array([0.0, 0, 0.5, 0.5, 1, 1]), "control_points_camera": np.ones((4, 3))},
        "the knots within must increase",
    ),
    "a spline of degree 0": (RECONSTRUCTION, {"degree": 0}, "degree of a spline must be at least 1"),
    "a failure with a curve": (
        RECONSTRUCTION,
        {"status": Status.FAILED, "reason": "too dark"},
        "a failed reconstruction has no control points",
    ),
    "confidence beyond the thread": (RECONSTRUCTION, {"confidence_s": np.array([0.0, 1.1])}, "confidence_s must lie"),
    "an unseen stretch beyond the thread": (RECONSTRUCTION, {"unseen": np.array([[-0.1, 0.2]])}, "unseen must lie"),
    "a region beyond the thread": (REGIONS, {"s": np.array([0.0, 1.1])}, "regions.s must lie"),
}


@pytest.mark.parametrize(("message", "changes", "text"), REFUSED.values(), ids=REFUSED)
def test_a_message_is_refused_that_holds(message, changes, text):
    with pytest.raises(MessageError, match=text):
        dataclasses.replace(message, **changes)


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
