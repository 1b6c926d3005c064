import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.messages import StereoCalibration
from shared.calibration import CalibrationError, read_calibration, write_calibration
from shared.rigid_transforms import exp_so3, transform

SIZE = (960, 540)
small = st.floats(-0.1, 0.1)


def assert_identical(read: StereoCalibration, written: StereoCalibration) -> None:
    for field in dataclasses.fields(StereoCalibration):
        np.testing.assert_array_equal(getattr(read, field.name), getattr(written, field.name), err_msg=field.name)


@given(rotation=st.tuples(small, small, small), count=st.sampled_from((0, 4, 5, 8, 12, 14)), baseline=st.floats(1, 20))
@settings(max_examples=20)
def test_any_calibration_survives_the_round_trip(tmp_path_factory, endoscope, rotation, count, baseline):
    written = dataclasses.replace(
        endoscope,
        metres_per_unit=(1.0, 1e-2, 1e-3, 1e-6, None)[count % 5],
        distortion_right=np.random.default_rng(count).normal(size=count),
        covariance=np.diag(np.random.default_rng(count).uniform(size=8)) if count % 2 else None,
        T_right_left=transform(exp_so3(np.array(rotation)), np.array([-baseline, baseline / 9, 0.01])),
    )
    path = tmp_path_factory.mktemp("round") / "calibration.json"
    write_calibration(path, written)
    # as `suturegrasp calibrate` leaves it, beside the same in another format
    (path.parent / "opencv.yaml").write_text("%YAML:1.0\n")
    assert_identical(read_calibration(path.parent, unit=None, image_size=SIZE).calibration, written)


def test_a_given_unit_fills_in_for_an_unknown_one_and_may_not_contradict_a_known_one(tmp_path, endoscope):
    path = tmp_path / "calibration.json"
    write_calibration(path, dataclasses.replace(endoscope, metres_per_unit=None))
    assert read_calibration(path, unit="cm", image_size=SIZE).calibration.metres_per_unit == 1e-2
    (judgement,) = read_calibration(path, unit=None, image_size=SIZE).judgements
    assert judgement.code == "unit_unknown"
    write_calibration(path, endoscope)
    assert read_calibration(path, unit="mm", image_size=SIZE).calibration.metres_per_unit == 1e-3
    with pytest.raises(CalibrationError, match=r"lengths in mm, which contradicts --unit m$"):
        read_calibration(path, unit="m", image_size=SIZE)


def test_an_unknown_unit_is_refused_with_the_known_ones(tmp_path, endoscope):
    path = tmp_path / "calibration.json"
    for stated in (endoscope, dataclasses.replace(endoscope, metres_per_unit=None)):
        write_calibration(path, stated)
        with pytest.raises(CalibrationError, match=r"unknown unit 'furlong'; choose from m, cm, mm, um"):
            read_calibration(path, unit="furlong", image_size=SIZE)


def test_what_cannot_be_written_is_said(tmp_path, endoscope):
    with pytest.raises(CalibrationError, match=r"unit of 0\.0254 m has no name"):
        write_calibration(tmp_path / "x.json", dataclasses.replace(endoscope, metres_per_unit=0.0254))
    with pytest.raises(CalibrationError, match="cannot be written"):
        write_calibration(tmp_path / "nowhere" / "x.json", endoscope)
