"""What other programs can show of a recording: images, calibration, transforms and curves as Foxglove's messages.

    camera/left/image, camera/right/image            as captured, thinned; frames camera_left and camera_right
    camera/left/calibration, camera/right/calibration
    transforms/camera_left, camera_right, psm1_base  from camera (rectified left)
    transforms/psm1_tool                             from psm1_base
    thread                                           points along the curve, in frame camera

They are copies for the eye: at most 10 images and transforms a second, and of large images so few that they stay within
2 MB/s. Lengths are in metres where the calibration says what its unit is.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import (
    Image,
    ImageEncoding,
    RobotState,
    Status,
    StereoCalibration,
    StereoFrame,
    ThreadReconstruction,
)
from schemas.topics import CALIBRATION, FRAMES, ROBOT_STATE, THREAD, Topic
from shared.camera import is_rectified
from shared.recording.entry import Entry
from shared.recording.foxglove_schemas import CameraCalibration, CompressedImage, FrameTransform, PointCloud, RawImage
from shared.rigid_transforms import inverse, quaternion_from_rotation
from shared.splines import evaluate

PERIOD_NS = 100_000_000
CURVE_POINTS = 400
BYTES_PER_SECOND = 2_000_000
CAMERA, EYES = "camera", ("left", "right")
NS = 1_000_000_000
PLUMB_BOB, RATIONAL = 5, 8
"""Coefficients of the models of distortion that Foxglove knows."""


@dataclass(frozen=True)
class Derived:
    """One message for another program."""

    channel: str
    schema: str
    payload: bytes


class FoxgloveCopies:
    """Makes copies of what is recorded; it remembers when it last made one of each key."""

    def __init__(self) -> None:
        self._due_ns: dict[str, int] = {}

    def of(self, topic: Topic, entry: Entry) -> list[Derived]:
        """The copies of a message: none where its topic has none, it is too soon for another, or it is unreadable."""
        copies = _COPIES.get(topic)
        if copies is None or (topic is not CALIBRATION and entry.received_ns < self._due_ns.get(entry.key, 0)):
            return []
        size_ns = len(entry.payload) * NS // BYTES_PER_SECOND if topic is FRAMES else 0
        self._due_ns[entry.key] = entry.received_ns + max(PERIOD_NS, size_ns)
        try:
            return list(copies(decode(topic.message, entry.payload), entry))
        except (MessageError, cv2.error):
            # what cannot be read is recorded as it is
            return []


def _images(frame: StereoFrame, _: Entry) -> Iterator[Derived]:
    stamp = frame.stamp
    for eye, image, at_ns in (
        ("left", frame.left, stamp.capture_left_ns),
        ("right", frame.right, stamp.capture_right_ns),
    ):
        frame_id = f"{CAMERA}_{eye}"
        copy = (
            _raw(image, at_ns, frame_id) if image.encoding is ImageEncoding.RAW else _compressed(image, at_ns, frame_id)
        )
        yield _derived(f"/{CAMERA}/{eye}/image", copy)


def _compressed(image: Image, at_ns: int, frame_id: str) -> Any:
    return CompressedImage(
        timestamp=_time(at_ns), frame_id=frame_id, data=image.data, format=image.encoding.name.lower()
    )


def _raw(image: Image, at_ns: int, frame_id: str) -> Any:
    return RawImage(
        timestamp=_time(at_ns),
        frame_id=frame_id,
        width=image.width,
        height=image.height,
        encoding="bgr8" if image.channels == 3 else "mono8",
        step=image.width * image.channels,
        data=bytes(image.data),
    )


def _calibration(calibration: StereoCalibration, entry: Entry) -> Iterator[Derived]:
    rectified = _rectified(calibration)
    at_ns, unit = entry.published_ns, calibration.metres_per_unit or 1.0
    T_camera_left, T_left_right = np.eye(4), inverse(calibration.T_right_left)
    T_camera_left[:3, :3] = rectified[0][0]
    for eye, (R, P), K, distortion, T in zip(
        EYES,
        rectified,
        (calibration.K_left, calibration.K_right),
        (calibration.distortion_left, calibration.distortion_right),
        (T_camera_left, T_camera_left @ T_left_right),
        strict=True,
    ):
        P_metres = P * np.array([1.0, 1.0, 1.0, unit])
        model, D = _distortion(distortion)
        copy = CameraCalibration(
            timestamp=_time(at_ns),
            frame_id=f"{CAMERA}_{eye}",
            width=calibration.image_width,
            height=calibration.image_height,
            distortion_model=model,
            D=D,
            K=K.ravel().tolist(),
            R=R.ravel().tolist(),
            P=P_metres.ravel().tolist(),
        )
        yield _derived(f"/{CAMERA}/{eye}/calibration", copy)
        yield _derived(f"/transforms/{CAMERA}_{eye}", _transform(at_ns, CAMERA, f"{CAMERA}_{eye}", T, unit))


def _poses(state: RobotState, _: Entry) -> Iterator[Derived]:
    base, tool, at_ns = f"{state.arm}_base", f"{state.arm}_tool", state.measured_ns
    yield _derived(f"/transforms/{base}", _transform(at_ns, CAMERA, base, state.T_camera_base))
    yield _derived(f"/transforms/{tool}", _transform(at_ns, base, tool, state.T_base_tool))


def _curve(thread: ThreadReconstruction, _: Entry) -> Iterator[Derived]:
    if thread.status is not Status.OK:
        return
    s = np.linspace(0.0, 1.0, CURVE_POINTS)
    points = evaluate(thread.knots, thread.control_points_camera, thread.degree, s)
    data = (points * (thread.camera.metres_per_unit or 1.0)).astype("<f4")
    copy = PointCloud(
        timestamp=_time(thread.stamp.capture_left_ns),
        frame_id=CAMERA,
        pose={"orientation": {"w": 1.0}},
        point_stride=data.strides[0],
        fields=[{"name": name, "offset": 4 * at, "type": "FLOAT32"} for at, name in enumerate("xyz")],
        data=data.tobytes(),
    )
    yield _derived("/thread", copy)


def _rectified(calibration: StereoCalibration) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Rotation to the rectified camera, and its 3x4 projection, of each eye (OpenCV's stereoRectify)."""
    t = np.array(calibration.T_right_left[:3, 3])
    if is_rectified(calibration):
        shift = np.array([[calibration.K_left[0, 0] * t[0]], [0.0], [0.0]])
        left, right = (np.hstack((calibration.K_left, column)) for column in (np.zeros((3, 1)), shift))
        return (np.eye(3), left), (np.eye(3), right)
    R_l, R_r, P_l, P_r, *_ = cv2.stereoRectify(
        np.array(calibration.K_left),
        _coefficients(calibration.distortion_left),
        np.array(calibration.K_right),
        _coefficients(calibration.distortion_right),
        (calibration.image_width, calibration.image_height),
        np.array(calibration.T_right_left[:3, :3]),
        t[:, None],
        alpha=-1,
    )
    return (np.asarray(R_l), np.asarray(P_l)), (np.asarray(R_r), np.asarray(P_r))


def _coefficients(distortion: np.ndarray) -> np.ndarray:
    return np.array(distortion) if len(distortion) else np.zeros(5)


def _distortion(distortion: np.ndarray) -> tuple[str, list[float]]:
    """Name and coefficients; of the longer models what Foxglove knows, the first eight."""
    if len(distortion) <= PLUMB_BOB:
        return "plumb_bob", [*distortion.tolist(), *[0.0] * (PLUMB_BOB - len(distortion))]
    return "rational_polynomial", distortion[:RATIONAL].tolist()


def _transform(
    at_ns: int, parent: str, child: str, T_parent_child: Float64[np.ndarray, "4 4"], unit: float = 1.0
) -> Any:
    w, x, y, z = quaternion_from_rotation(T_parent_child[:3, :3]).tolist()
    tx, ty, tz = (T_parent_child[:3, 3] * unit).tolist()
    return FrameTransform(
        timestamp=_time(at_ns),
        parent_frame_id=parent,
        child_frame_id=child,
        translation={"x": tx, "y": ty, "z": tz},
        rotation={"x": x, "y": y, "z": z, "w": w},
    )


def _time(at_ns: int) -> dict[str, int]:
    seconds, nanos = divmod(at_ns, NS)
    return {"seconds": seconds, "nanos": nanos}


def _derived(channel: str, message: Any) -> Derived:
    return Derived(channel, message.DESCRIPTOR.full_name, message.SerializeToString())


_COPIES: dict[Topic, Any] = {FRAMES: _images, CALIBRATION: _calibration, ROBOT_STATE: _poses, THREAD: _curve}
