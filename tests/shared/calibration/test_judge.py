import dataclasses

import cv2
import numpy as np
import pytest

from schemas.messages import Severity, StereoCalibration
from shared.calibration.judge import judgements, repaired_rotation
from shared.calibration.stated import CalibrationError
from shared.rigid_transforms import exp_so3, inverse, transform


def moved(calibration: StereoCalibration, t: tuple[float, float, float]) -> StereoCalibration:
    return dataclasses.replace(calibration, T_right_left=transform(np.eye(3), np.array(t)))


def codes(calibration: StereoCalibration) -> list[tuple[str, Severity]]:
    return [(judgement.code, judgement.severity) for judgement in judgements(calibration)]


def test_a_plausible_endoscope_gives_no_finding_and_one_from_right_to_left_a_fault(endoscope):
    assert judgements(endoscope) == ()
    (judgement,) = judgements(dataclasses.replace(endoscope, T_right_left=inverse(endoscope.T_right_left)))
    assert (judgement.code, judgement.severity) == ("left_and_right_swapped", Severity.FAULT)
    assert "invert the transform" in judgement.remedy


@pytest.mark.parametrize("seed", range(8))
def test_the_sides_are_judged_as_opencv_rectifies_them(endoscope, seed):
    rng = np.random.default_rng(seed)
    R, t = exp_so3(0.2 * rng.normal(size=3)), rng.normal(size=3) * (4, 1, 1)
    calibration = dataclasses.replace(endoscope, T_right_left=transform(R, t))
    nothing = np.zeros(5)
    P_right = cv2.stereoRectify(endoscope.K_left, nothing, endoscope.K_right, nothing, (960, 540), R, t[:, None])[3]
    try:
        swapped = ("left_and_right_swapped", Severity.FAULT) in codes(calibration)
    except CalibrationError:
        assert np.abs(t[1:]).max() > 0.5 * abs(t[0])
    else:
        assert P_right[1, 3] == 0
        assert swapped == (P_right[0, 3] > 0)


@pytest.mark.parametrize("t,complaint", [((0.1, -5, 0), "above one another"), ((-0.1, 0, 5), "one behind the other")])
def test_cameras_that_do_not_stand_side_by_side_are_refused(endoscope, t, complaint):
    with pytest.raises(CalibrationError, match=complaint):
        judgements(moved(endoscope, t))


@pytest.mark.parametrize("baseline,unit,named", [(5.5, 1.0, True), (0.0055, 1e-3, False), (55.0, 1e-3, False)])
def test_a_baseline_that_no_endoscope_has_is_noticed(endoscope, baseline, unit, named):
    calibration = dataclasses.replace(moved(endoscope, (-baseline, 0, 0)), metres_per_unit=unit)
    (judgement,) = judgements(calibration)
    assert (judgement.code, judgement.severity) == ("baseline_implausible", Severity.WARNING)
    assert ("--unit mm" in judgement.remedy) == named


@pytest.mark.parametrize(
    "row,column,value,code",
    [
        (0, 2, -200.0, "principal_point_off_image"),
        (1, 2, 800.0, "principal_point_off_image"),
        (0, 0, 4.2, "focal_length_implausible"),
        (0, 1, 3.0, "skew_ignored"),
    ],
)
def test_an_implausible_camera_matrix_is_a_warning(endoscope, row, column, value, code):
    K = endoscope.K_right.copy()
    K[row, column] = value
    assert (code, Severity.WARNING) in codes(dataclasses.replace(endoscope, K_right=K))


def test_cameras_that_look_far_apart_are_a_warning(endoscope):
    T = transform(exp_so3(np.array([0, 0, 1.0])), np.array([-5.0, 0, 0]))
    assert ("cameras_turned_apart", Severity.WARNING) in codes(dataclasses.replace(endoscope, T_right_left=T))


def test_the_gravest_finding_comes_first_and_an_unknown_unit_is_a_note(endoscope):
    K = endoscope.K_left * np.array([[1, 1, 9], [1, 1, 1], [1, 1, 1]])
    bad = dataclasses.replace(moved(endoscope, (5, 0, 0)), K_left=K, metres_per_unit=None)
    found = codes(bad)
    assert [severity for _, severity in found] == [Severity.FAULT, Severity.WARNING, Severity.NOTE]
    assert found[-1][0] == "unit_unknown"


def test_an_exact_rotation_stays_and_the_report_of_another_says_how_far_it_is_off():
    R = exp_so3(np.array([0.1, 0.2, 0.3]))
    repaired, findings = repaired_rotation(R)
    assert repaired is R
    assert findings == ()
    _, (finding,) = repaired_rotation(np.diag([1.0, 1.0, 1.0 + np.radians(0.1)]))
    assert "0.100 degrees" in finding.finding


@pytest.mark.parametrize("digits,reported", [(4, False), (2, True)])
def test_a_rounded_rotation_is_repaired_and_reported_if_it_is_coarse(digits, reported):
    R = exp_so3(np.array([0.1, 0.2, 0.3]))
    repaired, findings = repaired_rotation(R.round(digits))
    np.testing.assert_allclose(repaired @ repaired.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(repaired, R, atol=10.0**-digits)
    assert [finding.code for finding in findings] == ["rotation_not_orthonormal"] * reported


@pytest.mark.parametrize("R", [np.zeros((3, 3)), np.diag([1, 1, -1.0]), 1.1 * np.eye(3)])
def test_what_is_no_rotation_is_refused(R):
    with pytest.raises(CalibrationError, match="no rotation"):
        repaired_rotation(R)
