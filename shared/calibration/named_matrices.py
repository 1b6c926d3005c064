"""Calibrations as names with matrices: what OpenCV's FileStorage writes, and this project's own JSON.

Everyone names the matrices differently, so a name is taken apart into what it stands for and the side, without
regard to case and punctuation: `K1`, `M1`, `cameraMatrix1`, `camera_matrix_left` and `left: {K: ...}` are one.
The convention is that of OpenCV's stereoCalibrate: `x_right = R x_left + T`.

**Principal points** may count pixels from their corners. Here integer coordinates are pixel centres, so the middle of
an image W pixels wide is (W - 1) / 2. A renderer that looks through the middle of its image calls that W / 2. An
estimated principal point is never exactly there; a stated one that is, in both images and without distortion, is the
middle of the image and is taken as such: the published synthetic scenes show their true curves half a pixel to the
right and below otherwise.
"""

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from schemas.messages import Judgement, Severity, StereoCalibration
from shared.calibration.documents import Document, Node
from shared.calibration.numbers import array, matrix, shape_text, vector, whole_number
from shared.calibration.stated import CalibrationError, ImageSize, StatedCalibration
from shared.calibration.uncertainty import ERRORS
from shared.rigid_transforms import exp_so3

_CAMERA_MATRIX = (
    *("k", "m", "cm", "mtx", "matrix", "cameramatrix", "cammatrix", "cameramtx", "cammtx"),
    *("intrinsic", "intrinsics", "intrinsicmatrix", "intrinsicsmatrix", "cameraintrinsics"),
)
_DISTORTION = (
    *("d", "dist", "distortion", "distcoeff", "distcoeffs", "distcoef", "distcoefs", "distortions"),
    *("distortioncoeff", "distortioncoeffs", "distortioncoefficient", "distortioncoefficients"),
)
_SIZE = ("imagesize", "imgsize", "imsize", "imageresolution", "resolution")
_ROTATION = ("r", "rotation", "rotationmatrix", "rmat", "stereor", "rstereo", "rrightleft", "om")
_TRANSLATION = ("t", "translation", "translationvector", "tvec", "stereot", "tstereo", "trightleft")
_LEFT_TO_RIGHT = ("l2r", "lefttoright", "left2right", "transformlefttoright", "transformrightleft")


def _sided(quantity: str, names: Iterable[str]) -> dict[str, str]:
    """Every spelling of a quantity that each camera has, with what it stands for."""
    spellings: dict[str, str] = {}
    for side, suffixes in (("left", ("1", "l", "left")), ("right", ("2", "r", "right"))):
        for name in names:
            for spelling in (*(name + suffix for suffix in suffixes), side + name, f"{side}camera{name}"):
                spellings[spelling] = f"{side} {quantity}"
    return spellings


_MEANING = {
    **_sided("camera matrix", _CAMERA_MATRIX),
    **_sided("distortion", _DISTORTION),
    **_sided("image size", _SIZE),
    **dict.fromkeys(_SIZE, "image size"),
    **dict.fromkeys(("imagewidth", "width", "imgwidth", "imagesizewidth"), "image width"),
    **dict.fromkeys(("imageheight", "height", "imgheight", "imagesizeheight"), "image height"),
    **dict.fromkeys(_ROTATION, "rotation"),
    **dict.fromkeys((*_TRANSLATION, *_LEFT_TO_RIGHT), "translation"),
    **dict.fromkeys(("unit", "units", "lengthunit"), "unit"),
    "covarianceoferrors": "covariance",
    **dict.fromkeys(("baseline", "baselinem", "baselinemm"), "baseline"),
    **dict.fromkeys(("k", "cameramatrix", "intrinsics", "intrinsicmatrix"), "camera matrix"),
    **dict.fromkeys(_DISTORTION, "distortion"),
}


@dataclass(frozen=True)
class NamedEntries:
    """The entries of a file by what they stand for; `names` are all that the file has, for the error's text."""

    by_meaning: Mapping[str, tuple[str, Node]]
    names: tuple[str, ...]

    def __contains__(self, meaning: str) -> bool:
        return meaning in self.by_meaning

    def entry(self, meaning: str, spelling: str) -> tuple[Node, str]:
        """The value of an entry and the file's name for it.

        Raises:
            CalibrationError: where the file lacks it; the text gives the usual spelling and what was found instead.
        """
        if meaning not in self.by_meaning:
            found = ", ".join(self.names[:20]) + (", ..." if len(self.names) > 20 else "")
            misspelt = "".join(f", where {name} may be misspelt" for name in self._like(meaning)[:1])
            raise CalibrationError(f"it has no {meaning} (usually called {spelling}); it holds {found}{misspelt}")
        name, node = self.by_meaning[meaning]
        return node, name

    def _like(self, meaning: str) -> list[str]:
        """Names of the file that mean nothing and are nearly one of that meaning."""
        known = [spelling for spelling, of in _MEANING.items() if of == meaning]
        unknown = [name for name in self.names if _bare(name) not in _MEANING]
        return [name for name in unknown if difflib.get_close_matches(_bare(name), known, n=1)]


def _bare(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def named_entries(documents: Iterable[Document]) -> NamedEntries:
    """The entries of one or more documents that belong together, such as OpenCV's intrinsics and extrinsics.

    Raises:
        CalibrationError: where two of them give different values for the same thing.
    """
    by_meaning: dict[str, tuple[str, Node]] = {}
    names: list[str] = []
    for name, node in (entry for document in documents for entry in _flat(document)):
        names.append(name)
        meaning = _MEANING.get(_bare(name))
        if meaning is None:
            continue
        earlier, value = by_meaning.setdefault(meaning, (name, node))
        if value != node:
            raise CalibrationError(f"{earlier} and {name} both give the {meaning}, and differ; keep the right one")
    return NamedEntries(by_meaning, tuple(dict.fromkeys(names)))


def stereo_calibration(entries: NamedEntries) -> StatedCalibration:
    """What a file with the matrices of both cameras states.

    Raises:
        CalibrationError: naming what is missing or has the wrong form.
    """
    K_left = matrix(*entries.entry("left camera matrix", "K1, M1 or K_left"), 3, 3)
    K_right = matrix(*entries.entry("right camera matrix", "K2, M2 or K_right"), 3, 3)
    distortion_left = vector(*entries.entry("left distortion", "D1 or distortion_left; zeros if rectified"))
    distortion_right = vector(*entries.entry("right distortion", "D2 or distortion_right; zeros if rectified"))
    R_right_left, t_right_left = _left_to_right(entries)
    return StatedCalibration(
        K_left=K_left,
        K_right=K_right,
        distortion_left=distortion_left,
        distortion_right=distortion_right,
        R_right_left=R_right_left,
        t_right_left=t_right_left,
        size=stated_size(entries),
        unit=stated_unit(entries),
        covariance=_covariance(entries),
    )


def stated_size(entries: NamedEntries) -> ImageSize | None:
    """The image size of a file, None where it states none.

    Raises:
        CalibrationError: where the cameras have different sizes, or the size is no pair of whole numbers.
    """
    if "image width" in entries and "image height" in entries:
        width = whole_number(*entries.entry("image width", "image_width"))
        return ImageSize(width, whole_number(*entries.entry("image height", "image_height")), order_is_known=True)
    pairs = [
        _size_pair(*entries.entry(meaning, "ImageSize"))
        for meaning in ("image size", "left image size", "right image size")
        if meaning in entries
    ]
    if len(set(pairs)) > 1:
        sizes = " and ".join(f"{first}x{second}" for first, second in pairs)
        raise CalibrationError(f"its cameras have different image sizes ({sizes}); both must have one size")
    return ImageSize(*pairs[0], order_is_known=False) if pairs else None


def stated_unit(entries: NamedEntries) -> str | None:
    """The unit that a file states, None where it states none."""
    if "unit" not in entries:
        return None
    node, name = entries.entry("unit", "unit")
    if node in (None, "", "null", "~", []):
        return None
    if not isinstance(node, str):
        raise CalibrationError(f"{name} must be the name of a unit")
    return node.strip("\"'")


def _covariance(entries: NamedEntries) -> Float64[np.ndarray, "8 8"] | None:
    if "covariance" not in entries:
        return None
    return matrix(*entries.entry("covariance", "covariance_of_errors"), len(ERRORS), len(ERRORS))


def _size_pair(node: Node, name: str) -> tuple[int, int]:
    values = vector(node, name)
    if len(values) != 2:
        raise CalibrationError(f"{name} must be two whole numbers, but is {shape_text(values)}")
    first, second = (whole_number(str(value), name) for value in values)
    return first, second


def _left_to_right(entries: NamedEntries) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]:
    node, name = entries.entry("translation", "T, or T_right_left for a whole 4x4")
    values = array(node, name)
    if values.shape in ((3, 4), (4, 4)):
        if "rotation" in entries:
            raise CalibrationError(f"{name} already holds a rotation, and there is another one; keep one of them")
        return split_transform(values, name)
    if values.size != 3:
        raise CalibrationError(f"{name} must be 3 numbers or a 4x4 matrix, but is {shape_text(values)}")
    return _rotation(*entries.entry("rotation", "R")), values.reshape(3)


def split_transform(
    values: Float64[np.ndarray, "rows 4"], name: str
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]:
    """Rotation and translation of a 3x4 or 4x4 matrix.

    Raises:
        CalibrationError: where the fourth row is not 0 0 0 1.
    """
    if len(values) == 4 and (values[3] != (0, 0, 0, 1)).any():
        raise CalibrationError(f"the last row of {name} must be 0 0 0 1, as in a transform of columns")
    return values[:3, :3].copy(), values[:3, 3].copy()


def _rotation(node: Node, name: str) -> Float64[np.ndarray, "3 3"]:
    values = array(node, name)
    return exp_so3(values.reshape(3)) if values.size == 3 else matrix(node, name, 3, 3)


def _flat(document: Document, prefix: str = "") -> Iterator[tuple[str, Node]]:
    for key, node in document.items():
        name = f"{prefix}{key}"
        if isinstance(node, Mapping) and "data" not in node:
            yield from _flat(node, f"{name}_")
        else:
            yield name, node


HALF_PIXEL = 0.5


def counted_from_centres(calibration: StereoCalibration) -> tuple[StereoCalibration, tuple[Judgement, ...]]:
    """The calibration with principal points among pixel centres, and a note where they were not."""
    if not _is_ideal(calibration):
        return calibration, ()
    finding = "The principal point is exactly half the image's size, the middle of it where pixels count from a corner."
    remedy = "Half a pixel was taken off, since integer coordinates are pixel centres here; nothing needs to be done."
    return (
        replace(calibration, K_left=_shifted(calibration.K_left), K_right=_shifted(calibration.K_right)),
        (Judgement("pixels_from_corners", Severity.NOTE, finding, remedy),),
    )


def _is_ideal(calibration: StereoCalibration) -> bool:
    middle = np.array([calibration.image_width, calibration.image_height]) / 2
    exact = all(bool((K[:2, 2] == middle).all()) for K in (calibration.K_left, calibration.K_right))
    return exact and not calibration.distortion_left.any() and not calibration.distortion_right.any()


def _shifted(K: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "3 3"]:
    moved = K.copy()
    moved[:2, 2] -= HALF_PIXEL
    return moved
