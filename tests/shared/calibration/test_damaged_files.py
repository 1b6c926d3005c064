"""Whatever a file holds, reading it gives a calibration or one sentence, and prints nothing."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from shared.calibration import CalibrationError, read_calibration

SIZE = (640, 480)

OPENCV_YAML = b"""%YAML:1.0
---
K1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 8.8e+02, 0., 3.2e+02, 0., 880., 240., 0., 0., 1. ]
M2: !!opencv-matrix { rows: 3, cols: 3, dt: d, data: [ 880., 0., 320., 0., 880., 240., 0., 0., 1. ] }
D1: [ 0.1, 0., 0., 0. ]
D2: [ 0., 0., 0., 0., .0 ]
ImageSize: [ 480, 640 ]  # (height, width)
T: [ -5.9, 0., 0. ]
R: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
"""
OPENCV_XML = b"""<?xml version="1.0"?>
<opencv_storage>
<K1 type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt><data>880. 0. 320. 0. 880. 240. 0. 0. 1.</data></K1>
<K2>880. 0. 320. 0. 880. 240. 0. 0. 1.</K2>
<D1>0. 0. 0. 0.</D1><D2>0. 0. 0. 0.</D2>
<R>1 0 0 0 1 0 0 0 1</R><T><_>-5.9</_><_>0</_><_>0</_></T><imageSize>640 480</imageSize>
</opencv_storage>
"""
OWN_JSON = b"""{"image_width": 640, "image_height": 480, "unit": null,
"K_left": [[880.0, 0, 320], [0, 880, 240], [0, 0, 1]], "K_right": [[880.0, 0, 320], [0, 880, 240], [0, 0, 1]],
"distortion_left": [], "distortion_right": [0, 0, 0, 0],
"T_right_left": [[1, 0, 0, -5.9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}
"""
RECTIFIED_JSON = b"""{"K": [[880.0, 0, 320], [0, 880, 240], [0, 0, 1]], "baseline_mm": 5.5, "width": 640, "height": 480}
"""
ROS_YAML = b"""width: 640
height: 480
distortion_model: plumb_bob
d: [0.1, 0, 0, 0, 0]
k: [880.0, 0, 320, 0, 880, 240, 0, 0, 1]
r: [1, 0, 0, 0, 1, 0, 0, 0, 1]
p: [880.0, 0, 320, 0, 0, 880, 240, 0, 0, 0, 1, 0]
---
width: 640
height: 480
distortion_model: plumb_bob
d: [0, 0, 0, 0, 0]
k: [880.0, 0, 320, 0, 880, 240, 0, 0, 1]
r: [1, 0, 0, 0, 1, 0, 0, 0, 1]
p: [880.0, 0, 320, -4.9, 0, 880, 240, 0, 0, 0, 1, 0]
"""
WHOLE = {"yaml": OPENCV_YAML, "xml": OPENCV_XML, "json": OWN_JSON, "pair": RECTIFIED_JSON, "ros": ROS_YAML}
SPLICES = (
    *(b"", b"\x00", b"\xff\xfe", b"\n", b"\t", b"-", b"]", b"[", b"{", b"}", b":", b"&a ", b"*a", b"<!ENTITY", b"<"),
    *(b".nan", b".Inf", b"1e999", b"NaN", b"-0", b"1e-320", b"99999999999", b"null", b"!!python/object:os.system "),
    *(b"K1: 1\n", b"? [a]\n: 1\n", b"---\n", b"left: ", b"rows: -3\n", b'"', b"'", b"\\ud800", "٣".encode(), b"%"),
)

counter = itertools.count()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("damaged")


def reads_or_explains(path: Path | tuple[Path, ...]) -> bool:
    """Whether it was read; if not, the error must be one sentence. Any other exception escapes and fails the test."""
    try:
        read_calibration(path, unit=None, image_size=SIZE)
    except CalibrationError as error:
        assert 20 < len(str(error)) <= 1000
        assert str(error).isprintable()
        return False
    return True


def written(folder: Path, content: bytes) -> Path:
    path = folder / f"{next(counter)}.calibration"
    path.write_bytes(content)
    return path


def test_every_file_is_read_before_it_is_damaged_and_nothing_is_printed_about_it_afterwards(folder, capfd):
    for content in WHOLE.values():
        assert reads_or_explains(written(folder, content))
        assert not reads_or_explains(written(folder, content[:-40]))
    assert capfd.readouterr() == ("", "")


@settings(max_examples=60, deadline=None)
@given(
    name=st.sampled_from(sorted(WHOLE)),
    edits=st.lists(
        st.tuples(st.floats(0, 1), st.integers(0, 40), st.sampled_from(SPLICES) | st.binary(max_size=6)),
        min_size=1,
        max_size=4,
    ),
)
def test_a_damaged_file_is_read_or_explained(folder, name, edits):
    content = WHOLE[name]
    for place, removed, inserted in edits:
        start = int(place * len(content))
        content = content[:start] + inserted + content[start + removed :]
    reads_or_explains(written(folder, content))


@settings(max_examples=40, deadline=None)
@given(name=st.sampled_from(sorted(WHOLE)), number=st.integers(0, 40), value=st.floats() | st.integers())
def test_any_number_in_any_place_is_read_or_explained(folder, name, number, value):
    words = WHOLE[name].split(b" ")
    numeric = [i for i, word in enumerate(words) if word[:1].isdigit()]
    words[numeric[number % len(numeric)]] = repr(value).encode() + (b"," if name != "xml" else b"")
    reads_or_explains(written(folder, b" ".join(words)))


@settings(max_examples=40, deadline=None)
@given(content=st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
@example(b"[" * 5000)
@example(b"<a>" * 5000 + b"</a>" * 5000)
@example(b"- " * 500)
@example(b'{"K": [' + b"[" * 60 + b"]" * 60 + b"]}")
@example(b"\xef\xbb\xbf")
@example(b'{"image_width": ' + b"1" * 5000 + b"}")
def test_no_calibration_at_all_is_explained(folder, content):
    assert not reads_or_explains(written(folder, content))


@settings(max_examples=15, deadline=None)
@given(
    name=st.sampled_from(("calib.left.intrinsics.txt", "calib.right.intrinsics.txt", "calib.l2r.txt")),
    content=st.binary(max_size=60) | st.text("0123456789.-+e, \n#naif", max_size=80).map(str.encode),
)
def test_a_damaged_folder_of_text_matrices_is_explained(folder, name, content):
    matrices = folder / f"matrices_{next(counter)}"
    matrices.mkdir()
    for side in ("left", "right"):
        (matrices / f"calib.{side}.intrinsics.txt").write_text("880 0 320\n0 880 240\n0 0 1\n0 0 0 0 0\n")
    np.savetxt(matrices / "calib.l2r.txt", [[1, 0, 0, -5], [0, 1, 0, 0], [0, 0, 1, 0]])
    assert reads_or_explains(matrices)
    (matrices / name).write_bytes(content)
    assert not reads_or_explains(matrices)


@pytest.mark.parametrize(
    "content,complaint",
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
        (b'{"\\u001b[31m\\ud800": 2}', r"it holds \?\[31m\?$"),
        (b"a: &b 1\nc: *b\n", "uses YAML aliases"),
        (b"<!DOCTYPE a><a>1</a>", "declares XML entities"),
    ],
)
def test_the_explanation_names_the_file_and_the_trouble(folder, content, complaint):
    path = written(folder, content)
    with pytest.raises(CalibrationError, match=complaint) as caught:
        read_calibration(path, unit=None, image_size=SIZE)
    assert str(path) in str(caught.value)


def test_paths_that_lead_to_no_calibration_are_explained(tmp_path):
    def complaint(path: Path | tuple[Path, ...]) -> str:
        with pytest.raises(CalibrationError) as caught:
            read_calibration(path, unit=None, image_size=SIZE)
        return str(caught.value)

    assert "nowhere.yaml: there is no such file or folder" in complaint(tmp_path / "nowhere.yaml")
    assert "the folder holds no calibration" in complaint(tmp_path)
    for name in ("a.yaml", "b.json"):
        (tmp_path / name).write_text("x: 1\n")
    assert re.search(r"several files .*\(a\.yaml, b\.json\); name one", complaint(tmp_path))
    assert "of two paths, each must be a file" in complaint((tmp_path, tmp_path))
    assert "not 0 paths" in complaint(())
    assert "not 3 paths" in complaint((tmp_path,) * 3)
