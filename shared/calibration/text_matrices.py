"""A folder of plain text matrices, as scikit-surgerycalibration writes them.

`*left*intrinsics*.txt` holds three rows of K, and often a fourth of distortion, which otherwise stands in
`*left*distortion*.txt`; the same for the right camera. `*l2r*.txt` holds the transform from left to right: 4x4, 3x4,
or three rows of R and a fourth with the translation. There is neither an image size nor a unit.
"""

from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Float64

from shared.calibration.documents import read_text
from shared.calibration.named_matrices import split_transform
from shared.calibration.numbers import array
from shared.calibration.stated import CalibrationError, StatedCalibration

Rows: TypeAlias = list[Float64[np.ndarray, "columns"]]


def is_text_matrix_folder(folder: Path) -> bool:
    """Whether a folder holds any of these files."""
    return any(_files(folder, *words) for words in (("l2r",), ("left", "intrinsics"), ("right", "intrinsics")))


def is_text_matrix(text: str) -> bool:
    """Whether a text is nothing but rows of numbers."""
    try:
        return bool(_rows(text, "text"))
    except CalibrationError:
        return False


def text_matrices(folder: Path) -> StatedCalibration:
    """What the files of a folder state together.

    Raises:
        CalibrationError: naming the file that is missing, there twice, or has the wrong form.
    """
    K_left, distortion_left = _camera(folder, "left")
    K_right, distortion_right = _camera(folder, "right")
    R_right_left, t_right_left = _left_to_right(folder)
    return StatedCalibration(
        K_left=K_left,
        K_right=K_right,
        distortion_left=distortion_left,
        distortion_right=distortion_right,
        R_right_left=R_right_left,
        t_right_left=t_right_left,
    )


def _camera(folder: Path, side: str) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "d"]]:
    path = _only_file(folder, side, "intrinsics")
    rows = _read_rows(path)
    separate = _files(folder, side, "distortion")
    if [len(row) for row in rows[:3]] != [3, 3, 3] or len(rows) > 4:
        raise CalibrationError(f"{path.name} must hold three rows of three numbers, then at most one of distortion")
    if len(rows) == 4 and separate:
        raise CalibrationError(f"{path.name} and {separate[0].name} both give the distortion; keep one of them")
    if len(rows) == 4:
        return np.stack(rows[:3]), rows[3]
    return np.stack(rows), np.concatenate(_read_rows(_only_file(folder, side, "distortion")))


def _left_to_right(folder: Path) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]:
    path = _only_file(folder, "l2r")
    rows = _read_rows(path)
    widths = [len(row) for row in rows]
    if widths == [3, 3, 3, 3]:
        return np.stack(rows[:3]), rows[3]
    if widths in ([4, 4, 4], [4, 4, 4, 4]):
        return split_transform(np.stack(rows), path.name)
    raise CalibrationError(f"{path.name} must hold a 4x4 or 3x4 transform, or three rows of R and one of T")


def _only_file(folder: Path, *words: str) -> Path:
    found = _files(folder, *words)
    if len(found) == 1:
        return found[0]
    pattern = f"*{'*'.join(words)}*.txt"
    if not found:
        raise CalibrationError(f"the folder has no {pattern}, which a calibration as text matrices needs")
    names = ", ".join(path.name for path in found[:5])
    raise CalibrationError(f"the folder has several {pattern} ({names}); leave one of them")


def _files(folder: Path, *words: str) -> list[Path]:
    texts = [path for path in folder.iterdir() if path.suffix.lower() == ".txt"]
    return sorted(path for path in texts if all(word in path.name.lower() for word in words))


def _read_rows(path: Path) -> Rows:
    try:
        return _rows(read_text(path), path.name)
    except CalibrationError as error:
        text = str(error)
        raise CalibrationError(text if text.startswith(path.name) else f"{path.name}: {text}") from None


def _rows(text: str, name: str) -> Rows:
    lines = [line.partition("#")[0].replace(",", " ").split() for line in text.splitlines()]
    return [array(words, name) for words in lines if words]
