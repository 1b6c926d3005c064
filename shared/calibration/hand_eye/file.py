"""Hand-eye files: where an arm's base is before the camera, in the forms that laboratories have it in.

- ours: JSON with `T_camera_base`, metres, the camera's axes those of OpenCV (x right, y down, z away).
- dvrk_camera_registration: `"base-frame": {"reference-frame", "transform"}`, camera from base, metres. It writes two
  files, `*-open-cv.json` with OpenCV's axes, and `*-dVRK.json` with da Vinci's (x left, y up, z away), which is a piece
  of a console's file and has no braces around it. For an arm beside an ECM the second is `{"name", "measured_cp"}`: the
  base as seen from the ECM's own base, for the console's fixed set-up joints.
- OpenCV: YAML, XML or JSON with a 4x4 matrix `T_camera_base`; or with `R_camera_base` and `t_camera_base`; or with a
  bare `R` and `t` and `pose: T_camera_base`, which says what they are of. OpenCV's stereo calibrations have an R and a
  T of the same size, which lead from eye to eye.

Axes: p_opencv = F p_davinci with F = diag(-1, -1, 1). The camera of an ECM lies at its tip, looking along its z, so

    T_camera_base = F · T_ecm_tip⁻¹ · T_ecm_base,

T_ecm_tip being the ECM's `local/measured_cp` (jhu-dvrk/dvrk_camera_registration, camera_registration.py).
"""

import enum
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from shared.calibration.documents import Document, Node, parse_documents, read_text
from shared.calibration.named_matrices import named_entries, stated_unit
from shared.calibration.numbers import array, matrix, vector
from shared.calibration.stated import CalibrationError
from shared.rigid_transforms import inverse, nearest_rotation, orthonormality_error
from shared.units import METRES_PER_UNIT

_OF_ANY_POSE = {"rotation", "translation", "unit"}
_OF_RECTIFICATION = {
    *("r1", "r2", "p1", "p2", "rl", "rr", "pl", "pr", "essentialmatrix", "fundamentalmatrix"),
    *("rectificationmatrix", "projectionmatrix", "disparitytodepth", "distortionmodel", "cameramodel"),
}
_FROM_EYE_TO_EYE = {
    *("rrightleft", "trightleft", "stereor", "stereot", "rstereo", "tstereo", "om"),
    *("l2r", "lefttoright", "left2right", "transformlefttoright", "transformrightleft"),
}
NAMED_AT_MOST = 3


def what_cameras_have(documents: Iterable[Document]) -> tuple[str, ...]:
    """Names of a file that only a camera's calibration has: matrices, distortion, image size, both eyes, rectification.

    Raises:
        CalibrationError: where two names give different values for the same thing.
    """
    entries = named_entries(documents)
    found = [name for meaning, (name, _) in entries.by_meaning.items() if meaning not in _OF_ANY_POSE]
    found += [name for name in entries.names if plain(name) in _OF_RECTIFICATION | _FROM_EYE_TO_EYE]
    return tuple(dict.fromkeys(found))[:NAMED_AT_MOST]


def plain(name: object) -> str:
    """A name without regard to case and punctuation; YAML has names that are no text."""
    return re.sub(r"[^a-z0-9]", "", str(name).lower())


FLIP = np.diag((-1.0, -1.0, 1.0, 1.0))
"""OpenCV's axes from da Vinci's, and the other way round."""
ROTATION_TOLERANCE = 1e-3
NEAREST_M = 0.02
"""From the camera to an arm's remote centre. The one is at the tip of an endoscope of 8 to 12 mm, the other within a
cannula of about 13 mm: nearer than 13 mm they would be inside each other."""
FARTHEST_M = 0.85
"""An instrument is 0.4162 m of shaft and 0.02 m of wrist and fingers, so that its tip is at most 0.44 m from the remote
centre; and it is of use within the camera's working distance, 0.04 to 0.4 m.

Within both bounds a length whose unit is wrong by 100 or more is found out: metres called mm or cm, mm or cm called
metres. One that is wrong by ten may pass."""
FARTHEST_FROM_ECM_M = FARTHEST_M + 0.25
"""The camera is at most 0.25 m, the insertion of its arm, from that arm's own remote centre."""
DA_VINCI_NAMES, OPENCV_NAMES = ("dvrk", "davinci", "da-vinci", "da_vinci"), ("opencv", "open-cv", "open_cv")
POSE, T_NUMBERS = "tcamerabase", 16
"""`T_camera_base`, and `t_camera_base`, without regard to case and punctuation."""
BARE_R, BARE_T = ("rotation", "r"), ("translation", "tvec", "t")
NAMES = (POSE, "rcamerabase", "pose", *BARE_R, *BARE_T)


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
        arm: whose base it is, as the console calls the arm; empty where neither the file nor its name says.
    """

    T: Float64[np.ndarray, "4 4"]
    reference: Reference = Reference.CAMERA
    calibration_id: str = ""
    arm: str = ""

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


def implausible(T: Float64[np.ndarray, "4 4"], reference: Reference = Reference.CAMERA) -> str:
    """What is wrong with how far a base is from what it is told from, metres; empty where nothing is."""
    by_ecm = reference is Reference.ECM_BASE
    farthest_m, what = (FARTHEST_FROM_ECM_M, "the ECM's base") if by_ecm else (FARTHEST_M, "the camera")
    if NEAREST_M <= (away_m := float(np.linalg.norm(T[:3, 3]))) <= farthest_m:
        return ""
    return f"the base would be {away_m:.3g} m from {what}, and {NEAREST_M:g} to {farthest_m:g} m make sense"


def read_hand_eye(path: Path, axes: Axes | None = None) -> HandEye:
    """Read a hand-eye file; `axes` says whose the camera's are, where neither the file nor its name does.

    Raises:
        CalibrationError: where it is none, does not tell its axes, or has the base where none can be; in one sentence
            with the path.
    """
    try:
        found = _from_text(read_text(path), path.name, axes)
        if wrong := implausible(found.T, found.reference):
            raise CalibrationError(f"{wrong}: is it in another unit than it says (metres, where it says nothing)?")
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None
    return found


def _from_text(text: str, name: str, axes: Axes | None) -> HandEye:
    piece = text.lstrip().startswith('"base-frame"')
    documents = parse_documents(f"{{{text.strip().rstrip(',')}}}" if piece else text)
    if of_cameras := what_cameras_have(documents):
        raise CalibrationError(
            f"it is no hand-eye file but the calibration of a camera or of both eyes, for it has "
            f"{', '.join(of_cameras)}: give the arm's own registration, in a file of its own (docs/camera.md)"
        )
    if len(documents) != 1:
        raise CalibrationError(f"it holds {len(documents)} documents where one is expected")
    (found,) = documents
    metres = _metres_per_unit(found)
    if "measured_cp" in found:
        return _from_ecm(found, metres)
    registered = re.match(r"(\w+)-registration-", name)
    arm = registered[1] if registered else ""
    frame = found.get("base-frame", found.get("base_frame", found if "reference-frame" in found else None))
    if isinstance(frame, Mapping):
        if "transform" not in frame:
            raise CalibrationError("its base-frame has no transform")
        told = Axes.DA_VINCI if piece else axes or _axes_by_name(name)
        if told is None:
            raise CalibrationError(
                "it does not say whose axes its camera has: name it *-open-cv.json or *-dVRK.json, as "
                "dvrk_camera_registration does, or set the axes beside it"
            )
        return replace(_before_camera(_pose(frame["transform"], "transform", metres), told), arm=arm)
    of = found.get("calibration_id", "")
    if not isinstance(of, str):
        raise CalibrationError("its calibration_id is no text")
    return replace(_before_camera(_named(found, metres), axes), calibration_id=of.strip("\"'"), arm=arm)


def _from_ecm(found: Document, metres: float) -> HandEye:
    arm = found.get("name")
    if not isinstance(arm, str):
        raise CalibrationError(
            "it has a measured_cp without the name of an arm, so it may be any pose: give the file that "
            "dvrk_camera_registration writes beside an ECM"
        )
    return HandEye(_pose(found["measured_cp"], "measured_cp", metres), Reference.ECM_BASE, arm=arm)


def _before_camera(T: Float64[np.ndarray, "4 4"], axes: Axes | None) -> HandEye:
    return HandEye(FLIP @ T if axes is Axes.DA_VINCI else T)


def _axes_by_name(name: str) -> Axes | None:
    lower = name.lower()
    da_vinci, opencv = (any(n in lower for n in names) for names in (DA_VINCI_NAMES, OPENCV_NAMES))
    if da_vinci == opencv:
        return None
    return Axes.DA_VINCI if da_vinci else Axes.OPENCV


def _metres_per_unit(found: Document) -> float:
    unit = stated_unit(named_entries([found])) or "m"
    if unit not in METRES_PER_UNIT:
        raise CalibrationError(f"its unit {unit!r} is unknown; known units: {', '.join(METRES_PER_UNIT)}")
    return METRES_PER_UNIT[unit]


def _named(found: Document, metres: float) -> Float64[np.ndarray, "4 4"]:
    by_name: dict[str, tuple[str, Node]] = {}
    for key, node in ((key, node) for key, node in found.items() if plain(key) in NAMES):
        earlier, _ = by_name.setdefault(plain(key), (key, node))
        if earlier != key:
            raise CalibrationError(f"{earlier} and {key} differ in nothing but how they are written; keep one")
    whole, turned = by_name.get(POSE), by_name.get("rcamerabase")
    if whole is not None and (turned is None or array(whole[1], whole[0]).size == T_NUMBERS):
        return _pose(whole[1], whole[0], metres)
    return _parts(turned, whole, metres) if turned is not None and whole is not None else _bare(by_name, metres)


def _bare(by_name: Mapping[str, tuple[str, Node]], metres: float) -> Float64[np.ndarray, "4 4"]:
    """The pose of a rotation and a translation whose names do not say what they are of, where something else does."""
    R = next((by_name[k] for k in BARE_R if k in by_name), None)
    t = next((by_name[k] for k in BARE_T if k in by_name), None)
    if R is None or t is None:
        raise CalibrationError(
            "it is no hand-eye file: it has none of base-frame (dvrk_camera_registration), T_camera_base, "
            "R_camera_base and t_camera_base"
        )
    if plain(str(by_name.get("pose", ("", ""))[1])) != POSE:
        raise CalibrationError(
            f"it does not say what {R[0]} and {t[0]} are of: those of two eyes look the same; if they lead from the "
            "arm's base to the camera, call them R_camera_base and t_camera_base"
        )
    return _parts(R, t, metres)


def _parts(R: tuple[str, Node], t: tuple[str, Node], metres: float) -> Float64[np.ndarray, "4 4"]:
    """The pose of a rotation and a translation, each with its name."""
    T = np.eye(4)
    place = vector(t[1], t[0])
    if place.size != 3:
        raise CalibrationError(f"{t[0]} must have three numbers, and has {place.size}")
    T[:3, :3], T[:3, 3] = matrix(R[1], R[0], 3, 3), place
    return _checked(T, f"{R[0]} and {t[0]}", metres)


def _pose(node: Node, name: str, metres: float) -> Float64[np.ndarray, "4 4"]:
    return _checked(matrix(node, name, 4, 4), name, metres)


def _checked(T: Float64[np.ndarray, "4 4"], name: str, metres: float) -> Float64[np.ndarray, "4 4"]:
    """The pose in metres with an exact rotation."""
    if not np.allclose(T[3], (0, 0, 0, 1), rtol=0, atol=1e-9):
        raise CalibrationError(f"the last row of {name} must be 0 0 0 1")
    if orthonormality_error(T[:3, :3]) > ROTATION_TOLERANCE or np.linalg.det(T[:3, :3]) < 0:
        raise CalibrationError(f"{name} holds no rotation: orthonormal to three digits, right-handed")
    exact = np.eye(4)
    exact[:3, :3], exact[:3, 3] = nearest_rotation(T[:3, :3]), metres * T[:3, 3]
    return exact
