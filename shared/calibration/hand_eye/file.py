"""Hand-eye files: where an arm's base is before the camera, in the forms that laboratories have it in.

- ours: JSON with `T_camera_base`, metres, the camera's axes those of OpenCV (x right, y down, z away).
- dvrk_camera_registration: `"base-frame": {"reference-frame", "transform"}`, camera from base, metres. It writes two
  files, `*-open-cv.json` with OpenCV's axes, and `*-dVRK.json` with da Vinci's (x left, y up, z away), which is a piece
  of a console's file and has no braces around it. For an arm beside an ECM the second is `{"name", "measured_cp"}`: the
  base as seen from the ECM's own base, for the console's fixed set-up joints.
- OpenCV: YAML, XML or JSON with a 4x4 matrix `T_camera_base`, or `R` and `t` of it.

Axes: p_opencv = F p_davinci with F = diag(-1, -1, 1). The camera of an ECM lies at its tip, looking along its z, so

    T_camera_base = F · T_ecm_tip⁻¹ · T_ecm_base,

T_ecm_tip being the ECM's `local/measured_cp` (jhu-dvrk/dvrk_camera_registration, camera_registration.py).
"""

import enum
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from shared.calibration.documents import Document, Node, parse_documents, read_text
from shared.calibration.numbers import matrix, vector
from shared.calibration.stated import CalibrationError
from shared.rigid_transforms import inverse, nearest_rotation, orthonormality_error
from shared.units import METRES_PER_UNIT

FLIP = np.diag((-1.0, -1.0, 1.0, 1.0))
"""OpenCV's axes from da Vinci's, and the other way round."""
ROTATION_TOLERANCE = 1e-3
FARTHEST_M = 2.0
DA_VINCI_NAMES, OPENCV_NAMES = ("dvrk", "davinci", "da-vinci", "da_vinci"), ("opencv", "open-cv", "open_cv")


class Axes(enum.Enum):
    """Whose axes a camera frame has."""

    OPENCV = "opencv"
    DA_VINCI = "da_vinci"


class Reference(enum.Enum):
    """What the base is seen from: the camera, or the base of the endoscope's own arm."""

    CAMERA = "camera"
    ECM_BASE = "ecm_base"


@dataclass(frozen=True, eq=False)
class HandEye:
    """Where the base at an arm's remote centre is.

    Fields:
        reference: what `T` leads to, from the base. With CAMERA it is `T_camera_base` with OpenCV's axes; with
            ECM_BASE it is as the ECM's arm has it, and `T_camera_base` follows from where the ECM is.
        calibration_id: of the camera in whose rectified frame that is (identity.py); empty where the file does not say.
    """

    T: Float64[np.ndarray, "4 4"]
    reference: Reference = Reference.CAMERA
    calibration_id: str = ""

    def before_camera(self, T_ecm_tip: Float64[np.ndarray, "4 4"] | None = None) -> Float64[np.ndarray, "4 4"]:
        """The base before the rectified left camera, metres; `T_ecm_tip` is the ECM's `local/measured_cp`.

        Raises:
            CalibrationError: where the base is told from the ECM, and the ECM's pose is not.
        """
        if self.reference is Reference.CAMERA:
            return self.T.copy()
        if T_ecm_tip is None:
            raise CalibrationError("the base is told from the ECM, whose pose is not known yet")
        return FLIP @ inverse(T_ecm_tip) @ self.T


def carried_by_ecm(
    T_camera_base: Float64[np.ndarray, "4 4"],
    T_ecm_tip_then: Float64[np.ndarray, "4 4"],
    T_ecm_tip_now: Float64[np.ndarray, "4 4"],
) -> Float64[np.ndarray, "4 4"]:
    """The base before the camera once the ECM has moved from one pose of its tip to another.

    The base stands still before the ECM's own base: F E⁻¹ M = T with M = E_then F T_then.
    """
    return FLIP @ inverse(T_ecm_tip_now) @ T_ecm_tip_then @ FLIP @ T_camera_base


def read_hand_eye(path: Path, axes: Axes | None = None) -> HandEye:
    """Read a hand-eye file; `axes` says whose the camera's are, where neither the file nor its name does.

    Raises:
        CalibrationError: where it is none, or does not tell its axes; in one sentence with the path.
    """
    try:
        return _from_text(read_text(path), path.name, axes)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None


def _from_text(text: str, name: str, axes: Axes | None) -> HandEye:
    piece = text.lstrip().startswith('"base-frame"')
    found = parse_documents(f"{{{text.strip().rstrip(',')}}}" if piece else text)[0]
    if "measured_cp" in found:
        return HandEye(_pose(found["measured_cp"], "measured_cp", 1.0), Reference.ECM_BASE)
    frame = found.get("base-frame", found.get("base_frame", found if "transform" in found else None))
    if isinstance(frame, Mapping):
        if "transform" not in frame:
            raise CalibrationError("its base-frame has no transform")
        told = Axes.DA_VINCI if piece else axes or _axes_by_name(name)
        if told is None:
            raise CalibrationError(
                "it does not say whose axes its camera has: name it *-open-cv.json or *-dVRK.json, as "
                "dvrk_camera_registration does, or set the axes beside it"
            )
        return _before_camera(_pose(frame["transform"], "transform", 1.0), told)
    of = found.get("calibration_id", "")
    if not isinstance(of, str):
        raise CalibrationError("its calibration_id is no text")
    return replace(_before_camera(_named(found), axes), calibration_id=of)


def _before_camera(T: Float64[np.ndarray, "4 4"], axes: Axes | None) -> HandEye:
    return HandEye(FLIP @ T if axes is Axes.DA_VINCI else T)


def _axes_by_name(name: str) -> Axes | None:
    lower = name.lower()
    da_vinci, opencv = (any(n in lower for n in names) for names in (DA_VINCI_NAMES, OPENCV_NAMES))
    if da_vinci == opencv:
        return None
    return Axes.DA_VINCI if da_vinci else Axes.OPENCV


def _named(found: Document) -> Float64[np.ndarray, "4 4"]:
    by_name = {key.lower().replace("_", ""): (key, node) for key, node in found.items()}
    unit = str(by_name.get("unit", ("", "m"))[1])
    if unit not in METRES_PER_UNIT:
        raise CalibrationError(f"its unit {unit!r} is unknown; known units: {', '.join(METRES_PER_UNIT)}")
    if "tcamerabase" in by_name:
        name, node = by_name["tcamerabase"]
        return _pose(node, name, METRES_PER_UNIT[unit])
    R = next((by_name[k] for k in ("rcamerabase", "rotation", "r") if k in by_name), None)
    t = next((by_name[k] for k in ("tcamerabasem", "translation", "tvec", "t") if k in by_name), None)
    if R is None or t is None:
        raise CalibrationError(
            "it is no hand-eye file: it has none of base-frame (dvrk_camera_registration), T_camera_base, R and t"
        )
    T = np.eye(4)
    place = vector(t[1], t[0])
    if place.size != 3:
        raise CalibrationError(f"{t[0]} must have three numbers, and has {place.size}")
    T[:3, :3], T[:3, 3] = matrix(R[1], R[0], 3, 3), place
    return _checked(T, f"{R[0]} and {t[0]}", METRES_PER_UNIT[unit])


def _pose(node: Node, name: str, metres: float) -> Float64[np.ndarray, "4 4"]:
    return _checked(matrix(node, name, 4, 4), name, metres)


def _checked(T: Float64[np.ndarray, "4 4"], name: str, metres: float) -> Float64[np.ndarray, "4 4"]:
    """The pose in metres with an exact rotation."""
    if not np.allclose(T[3], (0, 0, 0, 1), rtol=0, atol=1e-9):
        raise CalibrationError(f"the last row of {name} must be 0 0 0 1")
    if orthonormality_error(T[:3, :3]) > ROTATION_TOLERANCE or np.linalg.det(T[:3, :3]) < 0:
        raise CalibrationError(f"{name} holds no rotation: orthonormal to three digits, right-handed")
    place = metres * T[:3, 3]
    if (away := float(np.abs(place).max())) > FARTHEST_M:
        raise CalibrationError(f"{name} has the base {away:g} m from the camera: is it in another unit than metres?")
    exact = np.eye(4)
    exact[:3, :3], exact[:3, 3] = nearest_rotation(T[:3, :3]), place
    return exact
