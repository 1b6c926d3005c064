"""What is no calibration is refused by one sentence, which names the file and what is wrong with it."""

import json

import pytest

from shared.calibration import CalibrationError, read_calibration

SIZE = (960, 540)
NAMES = ("K1", "D1", "K2", "D2", "R", "T")


def refused(given, complaint, unit=None):
    with pytest.raises(CalibrationError, match=complaint) as caught:
        read_calibration(given, unit=unit, image_size=SIZE)
    return str(caught.value)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "it is empty"),
        (b"\x89PNG\r\n\x1a\n\x00\xff", "not a text file"),
        (b"some words\n", "holds no names with values"),
        (b'{"K": [1, 2}', r"not valid JSON \(line 1\)"),
        (b"a: b\nc: d: e\n", r"not valid YAML \(line 2\)"),
        (b"<a>\n<b></a>", r"not valid XML \(line 2\)"),
        (b"a: 1\nb: 2\n", "it has no left camera matrix .* it holds a, b"),
        (b"#" * (1 << 20) + b"#", "larger than 1 MB"),
        (b"1 2 3\n4 5 6\n", "one matrix of several"),
        (b"K1: {rows: 3, cols: 3, data: [1, 2]}\n", "K1 has 2 numbers where 3 rows of 3 need 9"),
        (b"a: 1\n---\nb: 2\n", "it holds 2 documents where one is expected"),
        (b'{"K\\n1": 1, "x\\ud800": 2}', r"K\?1 must be 3x3, but is one number"),
        (b"a: &b 1\nc: *b\n", "uses YAML aliases"),
        (b"<!DOCTYPE a><a>1</a>", "declares XML entities"),
    ],
)
def test_a_file_that_holds_something_else(tmp_path, content, complaint):
    path = tmp_path / "one.calibration"
    path.write_bytes(content)
    assert str(path) in refused(path, complaint)


@pytest.mark.parametrize(
    ("paths", "complaint"),
    [
        (("nowhere.yaml",), r"nowhere\.yaml: there is no such file or folder"),
        (("empty",), "the folder holds no calibration"),
        ((".",), r"several files .*\(a\.yaml, b\.json\); name one"),
        ((".", "."), "of two paths, each must be a file"),
        (("a.yaml", "./a.yaml"), "both paths are one file; name it once"),
        ((), "not 0 paths"),
        ((".", ".", "."), "not 3 paths"),
    ],
)
def test_paths_that_lead_to_no_calibration(tmp_path, paths, complaint):
    (tmp_path / "empty").mkdir()
    for name in ("a.yaml", "b.json"):
        (tmp_path / name).write_text("x: 1\n")
    refused(tuple(tmp_path / path for path in paths), complaint)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        *(({name: None}, rf"it has no .*\(usually called {name}\b.*; it holds ") for name in NAMES),
        ({"K1": [[1, 0], [0, 1]]}, "K1 must be 3x3, but is 2x2"),
        ({"D2": [[0, 0, 0], [0, 0, 0]]}, "D2 must be one row of numbers, but is 2x3"),
        ({"D2": [0, 0, 0]}, "the right camera has 3 distortion coefficients"),
        ({"R": [[0] * 4] * 4}, "R must be 3x3, but is 4x4"),
        ({"T": [[0]] * 5}, "T must be 3 numbers or a 4x4 matrix, but is 5x1"),
        ({"K2": [[float("nan")] * 3] * 3}, "K2"),
        ({"K2": [[1e10, 0, 0], [0, 1, 0], [0, 0, 1]]}, "K2 holds a number beyond"),
        ({"K1": [[800, 0, 0], [0, 800, 0], [480, 270, 1]]}, "left camera matrix is transposed"),
        ({"K1": [[-800, 0, 0], [0, 800, 0], [0, 0, 1]]}, "left camera matrix must be fx s cx"),
        ({"M1": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "K1 and M1 both give the left camera matrix, and differ"),
        ({"R": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "mirrors space"),
        ({"ImageSize": [960, 540, 3]}, "ImageSize must be two whole numbers"),
        ({"ImageSize": [960.5, 540]}, "ImageSize must be one positive whole number"),
        ({"image_size_left": SIZE, "image_size_right": [640, 480]}, "different image sizes"),
    ],
)
def test_a_wrong_matrix(named, write, changes, complaint):
    entries = {name: value for name, value in (named | changes).items() if value is not None}
    refused(write(**{"stereo.yml": entries}), f"stereo.yml: .*{complaint}")


@pytest.mark.parametrize(
    ("changes", "unit", "complaint"),
    [
        ({}, "m", "lengths in mm, which contradicts --unit m"),
        ({"unit": "m"}, None, "baseline_mm is in mm, but its unit says m"),
        ({"baseline_mm": -5.5}, None, "baseline_mm must be one positive number"),
        ({"baseline_mm": [1, 2]}, None, "baseline_mm must be one positive number, but is 2 numbers"),
        ({"baseline_mm": "long"}, None, "baseline_mm does not hold numbers only"),
        ({"D": [0.1, 0, 0, 0]}, None, "rectified pair, which has no distortion"),
        ({"width": 0}, None, "width must be one positive whole number"),
        ({"K": None}, None, "it has no left camera matrix"),
        ({"baseline_mm": None}, None, "it has no baseline .usually called baseline_mm, beside the one camera matrix"),
        ({"baseline_mm": None, "basline_mm": 5.5}, None, "no baseline .* where basline_mm may be misspelt"),
    ],
)
def test_a_rectified_pair_that_contradicts_itself(write, changes, unit, complaint):
    K = [[1000.0, 0.0, 479.5], [0.0, 1000.0, 269.5], [0.0, 0.0, 1.0]]
    scene = {"width": 960, "height": 540, "K": K, "baseline_mm": 5.5} | changes
    told = json.dumps({name: value for name, value in scene.items() if value is not None})
    refused(write(**{"scene.json": told}), complaint, unit)


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("calib.left.intrinsics.txt", None, "the folder has no .*left.*intrinsics"),
        ("calib.l2r.txt", None, "the folder has no .*l2r"),
        ("calib.left.intrinsics.txt", "1 0 0\n0 1 0\n0 0 1\n", "the folder has no .*left.*distortion"),
        ("calib.left.intrinsics.txt", "1 2\n3 4\n", "calib.left.* must hold three rows of three numbers"),
        (
            "calib.left.intrinsics.txt",
            "1 0 0\n0 1 0\n0 0 1\n0 0 0 0\n0 0 0 0\n",
            "calib.left.* at most one of distortion",
        ),
        ("calib.left.intrinsics.txt", "", "calib.left.*it is empty"),
        ("calib.left.intrinsics.txt", "a b c\n", "calib.left.*does not hold numbers only"),
        ("calib.left.intrinsics.txt", "800 0 nan\n0 800 270\n0 0 1\n0 0 0 0\n", "calib.left.*not a finite number"),
        ("calib.l2r.txt", "1 0 0\n0 1 0\n0 0 1\n", "calib.l2r.txt must hold a 4x4 or 3x4 transform"),
        ("calib.l2r.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n-5 0 0 1\n", "last row of calib.l2r.txt must be 0 0 0 1"),
        ("other.left.intrinsics.txt", "1\n", "several .*left.*intrinsics"),
        ("calib.left.distortion.txt", "0 0 0 0 0\n", "both give the distortion"),
    ],
)
def test_a_folder_of_text_matrices_of_which_one_is_wrong(tmp_path, text_matrices, write, name, content, complaint):
    write(**{each: text for each, text in (text_matrices | {name: content}).items() if text is not None})
    refused(tmp_path, complaint)


def put(side, name, index, value):
    return lambda cameras: cameras[side][name]["data"].__setitem__(index, value)


LEFT, RIGHT, P = 0, 1, "projection_matrix"


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (put(RIGHT, P, 3, 0.0), "neither P holds a baseline.*calibrate them together"),
        (put(RIGHT, P, 7, -500.0), "vertical baseline"),
        (put(LEFT, P, 3, -500.0), "both P hold a baseline"),
        (put(RIGHT, P, 0, 0.0), "focal length of 0 px"),
        (put(LEFT, "rectification_matrix", 0, 3.0), "R of the left camera is no rotation"),
        (lambda cameras: cameras.reverse(), r"swapped: .* give the two files in the other order"),
        (lambda cameras: cameras[LEFT].update(distortion_model="equidistant"), "fisheye model equidistant.*plumb_bob"),
        (lambda cameras: cameras[LEFT].update(camera_matrix=[0] * 9), "left camera_info is all zeros"),
        (
            lambda cameras: cameras[RIGHT].pop("rectification_matrix"),
            "right camera_info has no R; it holds image_width",
        ),
        (lambda cameras: cameras[RIGHT].update(image_width=640), "different image sizes"),
        (lambda cameras: cameras.__setitem__(RIGHT, {"R": [1]}), "give both cameras in one format"),
        (lambda cameras: cameras.pop(), "holds one camera only; give the files of both"),
    ],
)
def test_what_is_no_pair_of_calibrated_cameras(cameras, write, spoil, complaint):
    spoil(cameras)
    refused(write(**dict(zip(("left.yaml", "right.yaml"), cameras, strict=False))), complaint)
