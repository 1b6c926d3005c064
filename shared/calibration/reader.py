"""Reads a stereo calibration in any of the known formats, and judges it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from schemas.checks import MessageError
from schemas.messages import Judgement, StereoCalibration
from shared.calibration.documents import Document
from shared.calibration.formats import stated_calibration
from shared.calibration.judge import judgements, repaired_rotation
from shared.calibration.named_matrices import counted_from_centres
from shared.calibration.ros_camera_info import camera_info, ros_pair
from shared.calibration.stated import CalibrationError, OtherSizeError, StatedCalibration
from shared.rigid_transforms import transform
from shared.units import metres_per_unit

_LONGEST_SENTENCE = 1000


@dataclass(frozen=True)
class ReadCalibration:
    """A calibration and everything that is doubtful about it, the gravest first."""

    calibration: StereoCalibration
    judgements: tuple[Judgement, ...]


OWN_FILE = "calibration.json"
"""In a folder that `suturegrasp calibrate` or `scenes render` wrote, beside the same in other formats."""


def read_calibration(
    path_or_paths: Path | tuple[Path, ...], *, unit: str | None, image_size: tuple[int, int]
) -> ReadCalibration:
    """The calibration in a file, in a folder, or in two files (left, right; or intrinsics, extrinsics).

    Args:
        unit: the unit of the baseline, by a name of `shared.units`; None leaves it to the file, which may not know.
        image_size: (width, height) in pixels of the images that it is to be used with.

    A judgement of severity FAULT means that the calibration is well formed but must not be used.

    Raises:
        CalibrationError: where there is no usable calibration; the text says why and what to do. Where it is for images
            of another size, an OtherSizeError.
    """
    paths = (path_or_paths,) if isinstance(path_or_paths, Path) else tuple(path_or_paths)
    if len(paths) not in (1, 2):
        raise CalibrationError(f"a calibration is one file, one folder or two files, not {len(paths)} paths")
    paths = tuple(own if (own := path / OWN_FILE).is_file() else path for path in paths)
    try:
        stated = stated_calibration(paths)
        _check_size(stated, image_size)
        # JSON is this project's own form, which counts pixels from their centres
        foreign = any(path.suffix.lower() != ".json" for path in paths)
        return _judged(stated, _metres_per_unit(stated, unit), image_size, foreign)
    except OtherSizeError as error:
        raise OtherSizeError(_one_line(f"{' and '.join(map(str, paths))}: {error}"), error.size) from None
    except (CalibrationError, MessageError) as error:
        raise CalibrationError(_one_line(f"{' and '.join(map(str, paths))}: {error}")) from None


def calibration_of_camera_infos(
    left: Document, right: Document, *, unit: str | None, image_size: tuple[int, int], name: str
) -> ReadCalibration:
    """The calibration that two camera_info messages of ROS state; `name` is what an error calls their source.

    Raises:
        CalibrationError: as `read_calibration`.
    """
    try:
        stated = ros_pair(camera_info(left, "left"), camera_info(right, "right"))
        _check_size(stated, image_size)
        return _judged(stated, _metres_per_unit(stated, unit), image_size, foreign=True)
    except (CalibrationError, MessageError) as error:
        raise CalibrationError(_one_line(f"{name}: {error}")) from None


def _one_line(sentence: str) -> str:
    """A sentence that any terminal can show, whatever names it quotes from a file."""
    return "".join(char if char.isprintable() else "?" for char in sentence)[:_LONGEST_SENTENCE]


def _judged(
    stated: StatedCalibration, metres: float | None, image_size: tuple[int, int], foreign: bool
) -> ReadCalibration:
    for side, K in (("left", stated.K_left), ("right", stated.K_right)):
        _check_camera_matrix(side, K)
    R, rotation_judgements = repaired_rotation(stated.R_right_left)
    width, height = image_size
    calibration = StereoCalibration(
        image_width=width,
        image_height=height,
        K_left=stated.K_left,
        K_right=stated.K_right,
        distortion_left=stated.distortion_left,
        distortion_right=stated.distortion_right,
        T_right_left=transform(R, stated.t_right_left),
        metres_per_unit=metres,
        covariance=stated.covariance,
    )
    calibration, convention = counted_from_centres(calibration) if foreign else (calibration, ())
    found = (*rotation_judgements, *convention, *judgements(calibration))
    return ReadCalibration(calibration, tuple(sorted(found, key=lambda judgement: -judgement.severity.value)))


def _check_camera_matrix(side: str, K: np.ndarray) -> None:
    if K[2, :2].any() and not K[:2, 2].any():
        raise CalibrationError(f"the {side} camera matrix is transposed, as older MATLAB writes it; transpose it")
    if K[1, 0] != 0 or (K[2] != (0, 0, 1)).any() or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise CalibrationError(f"the {side} camera matrix must be fx s cx, 0 fy cy, 0 0 1 with positive fx and fy")


def _check_size(stated: StatedCalibration, image_size: tuple[int, int]) -> None:
    sizes = _possible_sizes(stated)
    if not sizes or image_size in sizes:
        return
    ours, theirs = (f"{width}x{height}" for width, height in (image_size, sizes[0]))
    remedy = "use the images that it belongs to, or scale them to its size if they were not cropped"
    if (two_in_one := eyes_in_one(*image_size, sizes[0])) is not None:
        what, remedy = two_in_one
        ours += f", {what}"
    raise OtherSizeError(f"the calibration is for {theirs} images, and these are {ours}; {remedy}", sizes[0])


def eyes_in_one(width: int, height: int, wanted: tuple[int, int]) -> tuple[str, str] | None:
    """What half an image shows that was taken for both eyes side by side, with the remedy; None where it is none."""
    if (2 * width, height) == wanted:
        what = "half as wide, as where an image of one eye is taken for both side by side"
        return what, "give both eyes side by side in one file, or each in a file of its own"
    if (2 * width, height) == (wanted[0], 2 * wanted[1]):
        what = "half as wide and twice as high, as where the eyes lie one above the other"
        return what, "give them side by side, left first, or each in a file of its own"
    return None


def _possible_sizes(stated: StatedCalibration) -> list[tuple[int, int]]:
    """Width and height as a file may mean them, the likelier first: a principal point lies near the middle."""
    if stated.size is None:
        return []
    width, height = stated.size.width, stated.size.height
    if stated.size.order_is_known:
        return [(width, height)]
    points = np.array([stated.K_left[:2, 2], stated.K_right[:2, 2]])
    return sorted(
        ((width, height), (height, width)), key=lambda one: float(np.linalg.norm(points - 0.5 * np.array(one)))
    )


def _metres_per_unit(stated: StatedCalibration, unit: str | None) -> float | None:
    """The unit that was given, or else the file's own.

    Raises:
        CalibrationError: where the two contradict each other, or nobody knows a unit of that name.
    """
    try:
        metres = {name: metres_per_unit(name) for name in (unit, stated.unit) if name is not None}
    except ValueError as error:
        raise CalibrationError(str(error)) from None
    if unit and stated.unit and not stated.unit_by_convention and unit != stated.unit:
        raise CalibrationError(f"the file states its lengths in {stated.unit}, which contradicts --unit {unit}")
    name = unit or stated.unit
    return None if name is None else metres[name]
