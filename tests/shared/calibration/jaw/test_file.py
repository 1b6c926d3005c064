"""Jaw files are read as they were written, and what is none of them is refused in a sentence."""

import json

import pytest

from shared.calibration import CalibrationError
from shared.calibration.jaw.file import JawZero, jaw_zero_text, read_jaw_zero

ZERO = JawZero("psm1", "LARGE_NEEDLE_DRIVER:400006", 0.08, 0.06, 0.004, 5, 1_700_000_000 * 10**9)


def test_a_file_is_read_as_it_was_written(tmp_path):
    (tmp_path / "jaw.json").write_text(jaw_zero_text(ZERO))
    assert read_jaw_zero(tmp_path / "jaw.json") == ZERO


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"closes_rad": 4.6, "told_rad": 4.6}, "are they in degrees"),
        ({"told_rad": 0.5}, "within 0.3 rad of each other"),
        ({"closes_rad": "x"}, "does not hold numbers"),
        ({"closes_rad": [0.1, 0.2]}, "must be one number"),
        ({"closes_rad": None}, "not a finite number"),
        ({"deviation_rad": 0}, "deviation_rad must lie above 0"),
        ({"deviation_rad": 0.2}, "up to 0.1"),
        ({"closings": 2}, "found by 2 closings, and 3 are needed"),
        ({"closings": 2.5}, "closings must be one positive whole number"),
        ({"arm": ""}, "does not say of which arm"),
        ({"instrument": None}, "does not say of which instrument"),
    ],
)
def test_what_no_jaw_does_is_refused_in_a_sentence_with_the_path(tmp_path, change, told):
    path = tmp_path / "jaw.json"
    path.write_text(json.dumps(json.loads(jaw_zero_text(ZERO)) | change))
    with pytest.raises(CalibrationError, match=told) as refused:
        read_jaw_zero(path)
    assert str(refused.value).startswith(str(path))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('{"T_camera_base": [1]}', "it is no jaw file"),
        ('{"arm": "psm1", "instrument": "a"}', "it has no closes_rad"),
        ("", "it is empty"),
        ("{", "not valid JSON"),
    ],
)
def test_what_is_no_jaw_file_is_told_so(tmp_path, text, told):
    (tmp_path / "jaw.json").write_text(text)
    with pytest.raises(CalibrationError, match=told):
        read_jaw_zero(tmp_path / "jaw.json")


def test_when_it_was_made_is_not_known_where_the_file_does_not_say(tmp_path):
    told = json.loads(jaw_zero_text(ZERO))
    del told["made"]
    (tmp_path / "jaw.json").write_text(json.dumps(told))
    assert read_jaw_zero(tmp_path / "jaw.json").made_ns == 0
