"""Two `camera_info` of ROS, as camera_calibration writes them or as a topic shows them.

Each camera has K, D, a rotation R into the rectified frame, and the projection P of the rectified image (REP 104;
sensor_msgs/CameraInfo). With x_rectified_left = R_l x_left, x_rectified_right = R_r x_right, and

    x_rectified_right = x_rectified_left + t,      t = (P_r[0, 3] / P_r[0, 0], 0, 0),

the way from left to right is x_right = R_rᵀ R_l x_left + R_rᵀ t. Lengths are in metres by convention.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
from jaxtyping import Float64

from schemas.messages import ROTATION_TOLERANCE
from shared.calibration.documents import Document, Node
from shared.calibration.numbers import matrix, vector, whole_number
from shared.calibration.stated import CalibrationError, ImageSize, StatedCalibration
from shared.rigid_transforms import nearest_rotation, orthonormality_error

_NAMES = {
    "K": ("cameramatrix", "k"),
    "D": ("distortioncoefficients", "d"),
    "R": ("rectificationmatrix", "r"),
    "P": ("projectionmatrix", "p"),
    "width": ("imagewidth", "width"),
    "height": ("imageheight", "height"),
    "distortion model": ("distortionmodel", "cameramodel"),
}
_POLYNOMIAL = ("plumb_bob", "rational_polynomial", "radtan", "")
_FISHEYE = ("equidistant", "fisheye", "kannala_brandt", "kannala_brandt4", "thin_prism_fisheye")


@dataclass(frozen=True)
class CameraInfo:
    """One camera of a rectified pair: `R` turns its frame into the rectified one, `P` projects from there."""

    K: Float64[np.ndarray, "3 3"]
    D: Float64[np.ndarray, "d"]
    R: Float64[np.ndarray, "3 3"]
    P: Float64[np.ndarray, "3 4"]
    width: int
    height: int


def is_camera_info(document: Node) -> TypeGuard[Document]:
    """Whether a document is a camera_info: it has a camera matrix with a projection or a rectification."""
    if not isinstance(document, Mapping):
        return False
    known = _by_quantity(document)
    return "K" in known and ("P" in known or "distortion model" in known)


def both_cameras(documents: Sequence[Document]) -> tuple[Document, Document] | None:
    """The left and the right camera where one text holds both: under these names, or as two documents.

    A recorded topic repeats itself, so equal cameras count once.

    Raises:
        CalibrationError: where there are more than two cameras.
    """
    if len(documents) == 1:
        left, right = (_named_like(documents[0], side) for side in ("left", "right"))
        return (left, right) if is_camera_info(left) and is_camera_info(right) else None
    cameras: list[Document] = []
    for document in filter(is_camera_info, documents):
        if all(_by_quantity(document) != _by_quantity(camera) for camera in cameras):
            cameras.append(document)
    if len(cameras) > 2:
        raise CalibrationError(f"it holds {len(cameras)} different cameras; keep the left and the right one")
    if len(cameras) < 2:
        return None
    first, second = cameras
    return (second, first) if "right" in _name(first) and "left" in _name(second) else (first, second)


def camera_info(document: Document, side: str) -> CameraInfo:
    """The camera of one document; `side` is left or right, for the error's text.

    Raises:
        CalibrationError: where something is missing, of the wrong shape, uncalibrated, or a fisheye model.
    """
    known = _by_quantity(document)
    missing = [name for name in ("K", "D", "R", "P", "width", "height") if name not in known]
    if missing:
        found = ", ".join(list(map(str, document))[:20])
        raise CalibrationError(f"the {side} camera_info has no {', '.join(missing)}; it holds {found}")
    _check_model(known.get("distortion model"), side)
    K = matrix(known["K"], f"K of the {side} camera", 3, 3)
    if not K.any():
        raise CalibrationError(f"the {side} camera_info is all zeros: that camera was never calibrated")
    return CameraInfo(
        K=K,
        D=vector(known["D"], f"D of the {side} camera"),
        R=_rectification(known["R"], side),
        P=matrix(known["P"], f"P of the {side} camera", 3, 4),
        width=whole_number(known["width"], f"the width of the {side} camera"),
        height=whole_number(known["height"], f"the height of the {side} camera"),
    )


def ros_pair(left: CameraInfo, right: CameraInfo) -> StatedCalibration:
    """What two camera_info state together.

    Raises:
        CalibrationError: where they are no pair, or the wrong way round.
    """
    if (left.width, left.height) != (right.width, right.height):
        sizes = f"{left.width}x{left.height} and {right.width}x{right.height}"
        raise CalibrationError(f"its cameras have different image sizes ({sizes}); both must have one size")
    t = np.array([_baseline(left, right), 0, 0])
    return StatedCalibration(
        K_left=left.K,
        K_right=right.K,
        distortion_left=left.D,
        distortion_right=right.D,
        R_right_left=right.R.T @ left.R,
        t_right_left=right.R.T @ t,
        size=ImageSize(left.width, left.height, order_is_known=True),
        unit="m",
        unit_by_convention=True,
    )


def _baseline(left: CameraInfo, right: CameraInfo) -> float:
    """The x of the left camera in the rectified right frame."""
    if right.P[0, 3] == 0 and left.P[0, 3] != 0:
        raise CalibrationError(
            "left and right are swapped: the baseline stands in the left P; give the two files in the other order"
        )
    if left.P[0, 3] != 0:
        raise CalibrationError("both P hold a baseline; that of the left camera must have 0 in its fourth column")
    if right.P[1, 3] != 0:
        raise CalibrationError("the right P has a vertical baseline; the cameras must stand side by side")
    if right.P[0, 3] == 0:
        raise CalibrationError(
            "neither P holds a baseline, so these are two single cameras; calibrate them together as a stereo pair"
        )
    if right.P[0, 0] < 1:
        raise CalibrationError(f"the right P has a focal length of {right.P[0, 0]:g} px, so it is no projection")
    return float(right.P[0, 3] / right.P[0, 0])


def _rectification(node: Node, side: str) -> Float64[np.ndarray, "3 3"]:
    R = matrix(node, f"R of the {side} camera", 3, 3)
    if orthonormality_error(R) > ROTATION_TOLERANCE or np.linalg.det(R) < 0:
        raise CalibrationError(f"R of the {side} camera is no rotation; calibrate the pair again")
    return nearest_rotation(R)


def _check_model(node: Node, side: str) -> None:
    model = str(node or "").lower()
    if model in _FISHEYE:
        raise CalibrationError(
            f"the {side} camera has the fisheye model {model}, which cannot be rectified here; "
            "calibrate with plumb_bob or rational_polynomial"
        )
    if model not in _POLYNOMIAL:
        raise CalibrationError(
            f"the {side} camera has the unknown distortion model {model[:40]!r}; "
            "calibrate with plumb_bob or rational_polynomial"
        )


def _named_like(document: Document, side: str) -> Node:
    return next((node for name, node in document.items() if side in str(name).lower()), None)


def _name(document: Document) -> str:
    header = document.get("header")
    frame = header.get("frame_id") if isinstance(header, Mapping) else None
    return str(document.get("camera_name") or frame or "").lower()


def _by_quantity(document: Document) -> dict[str, Node]:
    found: dict[str, Node] = {}
    for name, node in document.items():
        spelling = re.sub(r"[^a-z0-9]", "", str(name).lower())
        quantity = next((quantity for quantity, names in _NAMES.items() if spelling in names), None)
        if quantity is not None:
            found.setdefault(quantity, node)
    return found
