"""When a calibration was made, as far as its files state it."""

import pytest

from shared.calibration import read_calibration, write_calibration
from shared.calibration.made import made_ns, made_text
from shared.calibration.written import opencv_text

AT_NS = 1_700_000_000 * 10**9
"""2023-11-14T22:13:20 in UTC."""
BY_OPENCV = '<calibration_time>"Tue Nov 14 22:13:20 2023"</calibration_time>'


def test_our_files_state_it_and_are_read_as_before(endoscope, tmp_path):
    own, opencv = tmp_path / "own.json", tmp_path / "opencv.yaml"
    write_calibration(own, endoscope, AT_NS)
    opencv.write_text(opencv_text(endoscope, AT_NS))
    for path in (own, opencv):
        assert made_ns((path,)) == AT_NS
        read = read_calibration(path, unit=None, image_size=(endoscope.image_width, endoscope.image_height))
        assert (read.calibration.K_left == endoscope.K_left).all()
    assert made_text(AT_NS) == "2023-11-14T22:13:20+00:00"


@pytest.mark.parametrize(
    ("name", "text", "told_ns"),
    [
        ("a.json", '{"made": "2023-11-14T23:13:20+01:00"}', AT_NS),
        ("a.yml", '%YAML:1.0\n---\ncalibration_time: "Tue Nov 14 22:13:20 2023"\nflags: 0\n', AT_NS),
        ("a.xml", f"<opencv_storage>{BY_OPENCV}</opencv_storage>", AT_NS),
        ("b.xml", f"<opencv_storage>{BY_OPENCV}</opencv_storage>".replace('"', ""), AT_NS),
        ("a.json", '{"made": "last week"}', None),
        ("a.json", '{"made": {"on": "2023-11-14"}}', None),
        ("a.json", "no JSON", None),
        ("a.yaml", "K1: 1\n", None),
        ("a.json", '{"made": "9999-12-31T23:59:59+00:00"}', 253402300799 * 10**9),
    ],
)
def test_what_a_file_states_is_understood_or_nobody_knows(tmp_path, name, text, told_ns):
    (tmp_path / name).write_text(text)
    assert made_ns((tmp_path / name,)) == told_ns


def test_of_several_files_the_oldest_counts_and_of_none_nobody_knows(tmp_path):
    for day in (14, 12, 13):
        (tmp_path / f"{day}.json").write_text(f'{{"made": "2023-11-{day}T22:13:20+00:00"}}')
    (tmp_path / "left").mkdir()
    assert made_ns((tmp_path,)) == AT_NS - 2 * 86400 * 10**9
    assert made_ns((tmp_path / "nowhere", tmp_path / "left")) is None
