"""Which format a calibration is in, found out from its content, and what it states in that format."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from shared.calibration.documents import Document, parse_documents, read_text
from shared.calibration.named_matrices import NamedEntries, named_entries, stated_size, stated_unit, stereo_calibration
from shared.calibration.numbers import array, matrix, shape_text
from shared.calibration.ros_camera_info import both_cameras, camera_info, is_camera_info, ros_pair
from shared.calibration.stated import CalibrationError, StatedCalibration
from shared.calibration.text_matrices import is_text_matrix, is_text_matrix_folder, text_matrices

_UNIT_IN_NAME = {"baseline_mm": "mm", "baseline_m": "m", "baselinemm": "mm"}


def is_rectified_pair(entries: NamedEntries) -> bool:
    """Whether the entries are one camera matrix, which needs a baseline, rather than two cameras."""
    two = "left camera matrix" in entries or "right camera matrix" in entries
    return "camera matrix" in entries and not two


def rectified_pair(entries: NamedEntries) -> StatedCalibration:
    """What a camera matrix with a baseline states; the right camera sits that far along +x.

    Raises:
        CalibrationError: where the baseline is no positive number, the units contradict, or there is distortion.
    """
    K = matrix(*entries.entry("camera matrix", "K"), 3, 3)
    node, name = entries.entry("baseline", "baseline_mm, beside the one camera matrix of a rectified pair")
    baseline = array(node, name)
    if baseline.size != 1 or baseline.item() <= 0:
        told = f"{baseline.item():g}" if baseline.size == 1 else shape_text(baseline)
        raise CalibrationError(f"{name} must be one positive number, but is {told}")
    if "distortion" in entries and array(*entries.entry("distortion", "D")).any():
        raise CalibrationError("a camera matrix with a baseline is a rectified pair, which has no distortion")
    return StatedCalibration(
        K_left=K,
        K_right=K.copy(),
        distortion_left=np.zeros(0),
        distortion_right=np.zeros(0),
        R_right_left=np.eye(3),
        t_right_left=np.array([-baseline.item(), 0, 0]),
        size=stated_size(entries),
        unit=_unit(name, stated_unit(entries)),
    )


def _unit(name: str, stated: str | None) -> str | None:
    named = _UNIT_IN_NAME.get(name.lower())
    if named and stated and named != stated:
        raise CalibrationError(f"{name} is in {named}, but its unit says {stated}; keep the right one")
    return named or stated


_SUFFIXES = (".yaml", ".yml", ".xml", ".json")


def stated_calibration(paths: Sequence[Path]) -> StatedCalibration:
    """What one file, one folder, or two files state.

    Raises:
        CalibrationError: where they are no calibration in a format that is known here.
    """
    if len(paths) == 2:
        return _of_two_files(*paths)
    (path,) = paths
    return _of_folder(path) if path.is_dir() else _of_file(path)


def _of_folder(folder: Path) -> StatedCalibration:
    try:
        if is_text_matrix_folder(folder):
            return text_matrices(folder)
        files = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)
    except OSError as error:
        raise CalibrationError(f"the folder cannot be read ({error.strerror})") from None
    for words in (("left", "right"), ("intrinsics", "extrinsics")):
        named = [[path for path in files if word in path.name.lower()] for word in words]
        if all(len(group) == 1 for group in named):
            return _of_two_files(named[0][0], named[1][0])
    if len(files) == 1:
        return _of_file(files[0])
    if not files:
        raise CalibrationError("the folder holds no calibration (*.yaml, *.yml, *.xml, *.json, or *l2r*.txt)")
    names = ", ".join(path.name for path in files[:5]) + (", ..." if len(files) > 5 else "")
    raise CalibrationError(f"the folder holds several files that may be the calibration ({names}); name one")


def _of_file(path: Path) -> StatedCalibration:
    text = read_text(path)
    if is_text_matrix(text):
        raise CalibrationError("it is one matrix of several; give the folder that holds them all")
    documents = parse_documents(text)
    pair = both_cameras(documents)
    if pair is not None:
        return _of_pair(*pair)
    if is_camera_info(documents[0]):
        return _of_file_and_sibling(path, documents[0])
    if len(documents) > 1:
        raise CalibrationError(f"it holds {len(documents)} documents where one is expected")
    entries = named_entries(documents)
    return rectified_pair(entries) if is_rectified_pair(entries) else stereo_calibration(entries)


def _of_two_files(first: Path, second: Path) -> StatedCalibration:
    if first.is_file() and second.is_file() and first.samefile(second):
        raise CalibrationError("both paths are one file; name it once, or give the files of both cameras, left first")
    documents = [_first_document(path) for path in (first, second)]
    are_camera_info = [is_camera_info(document) for document in documents]
    if all(are_camera_info):
        return _of_pair(*documents)
    if any(are_camera_info):
        raise CalibrationError("one file is a ROS camera_info and the other is not; give both cameras in one format")
    return stereo_calibration(named_entries(documents))


def _first_document(path: Path) -> Document:
    try:
        if path.is_dir():
            raise CalibrationError("it is a folder; of two paths, each must be a file")
        return parse_documents(read_text(path))[0]
    except CalibrationError as error:
        raise CalibrationError(f"{path.name}: {error}") from None


def _of_file_and_sibling(path: Path, document: Document) -> StatedCalibration:
    """The other camera is in the file whose name differs in left and right alone."""
    for side, other in (("left", "right"), ("right", "left")):
        sibling = path.with_name(_with_other_side(path.name, side, other))
        if sibling != path and sibling.is_file():
            pair = (document, _first_document(sibling))
            return _of_pair(*(pair if side == "left" else pair[::-1]))
    raise CalibrationError("it holds one camera only; give the files of both, the left one first")


def _with_other_side(name: str, side: str, other: str) -> str:
    for spelling in (str.lower, str.capitalize, str.upper):
        name = name.replace(spelling(side), spelling(other))
    return name


def _of_pair(left: Document, right: Document) -> StatedCalibration:
    return ros_pair(camera_info(left, "left"), camera_info(right, "right"))
