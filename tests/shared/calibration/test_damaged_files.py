"""Whatever a file holds, reading it gives a calibration or one sentence, and prints nothing."""

import itertools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from shared.calibration import CalibrationError, read_calibration
from shared.calibration.own_file import calibration_text, camera_info_texts, opencv_text
from tests.rigs.boards import endoscope

SIZE = (960, 540)
OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<K1 type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt><data>880. 0. 320. 0. 880. 240. 0. 0. 1.</data></K1>
<K2>880. 0. 320. 0. 880. 240. 0. 0. 1.</K2>
<D1>0. 0. 0. 0.</D1><D2>0. 0. 0. 0.</D2>
<R>1 0 0 0 1 0 0 0 1</R><T><_>-5.9</_><_>0</_><_>0</_></T><imageSize>960 540</imageSize>
</opencv_storage>
"""
RECTIFIED_JSON = '{"K": [[880.0, 0, 320], [0, 880, 240], [0, 0, 1]], "baseline_mm": 5.5, "width": 960, "height": 540}\n'
WHOLE = {
    "yaml": opencv_text(endoscope()).encode(),
    "xml": OPENCV_XML.encode(),
    "json": calibration_text(endoscope(), "").encode(),
    "pair": RECTIFIED_JSON.encode(),
    "ros": "---\n".join(camera_info_texts(endoscope())).encode(),
}
SPLICES = (
    *(b"", b"\x00", b"\xff\xfe", b"\n", b"\t", b"-", b"]", b"[", b"{", b"}", b":", b"&a ", b"*a", b"<!ENTITY", b"<"),
    *(b".nan", b".Inf", b"1e999", b"NaN", b"-0", b"1e-320", b"99999999999", b"null", b"!!python/object:os.system "),
    *(b"K1: 1\n", b"? [a]\n: 1\n", b"---\n", b"left: ", b"rows: -3\n", b'"', b"'", b"\\ud800", "٣".encode(), b"%"),
)

counter = itertools.count()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("damaged")


def reads_or_explains(path):
    """Whether it was read; if not, the error must be one sentence. Any other exception escapes and fails the test."""
    try:
        read_calibration(path, unit=None, image_size=SIZE)
    except CalibrationError as error:
        assert 20 < len(str(error)) <= 1000
        assert str(error).isprintable()
        return False
    return True


def written(folder, content):
    path = folder / f"{next(counter)}.calibration"
    path.write_bytes(content)
    return path


def test_every_file_is_read_before_it_is_damaged_and_nothing_is_printed_about_it_afterwards(folder, capfd):
    for content in WHOLE.values():
        assert reads_or_explains(written(folder, content))
        assert not reads_or_explains(written(folder, content[: -len(content) // 4]))
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
