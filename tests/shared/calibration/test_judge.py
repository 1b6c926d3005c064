import dataclasses

import cv2
import numpy as np
import pytest

from schemas.messages import Severity
from shared.calibration.judge import judgements, repaired_rotation
from shared.calibration.stated import CalibrationError
from shared.rigid_transforms import exp_so3, inverse, transform


def moved(calibration, *t):
    return dataclasses.replace(calibration, T_right_left=transform(np.eye(3), np.array(t)))


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
        swapped = "left_and_right_swapped" in {judgement.code for judgement in judgements(calibration)}
    except CalibrationError:
        assert np.abs(t[1:]).max() > 0.5 * abs(t[0])
    else:
        assert P_right[1, 3] == 0
        assert swapped == (P_right[0, 3] > 0)


@pytest.mark.parametrize("t,complaint", [((0.1, -5, 0), "above one another"), ((-0.1, 0, 5), "one behind the other")])
def test_cameras_that_do_not_stand_side_by_side_are_refused(endoscope, t, complaint):
    with pytest.raises(CalibrationError, match=complaint):
        judgements(moved(endoscope, *t))


def spoilt(row, column, value):
    def changed(endoscope):
        K = endoscope.K_right.copy()
        K[row, column] = value
        return dataclasses.replace(endoscope, K_right=K)

    return changed


def turned(endoscope):
    T = transform(exp_so3(np.array([0, 0, 1.0])), np.array([-5.0, 0, 0]))
    return dataclasses.replace(endoscope, T_right_left=T)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (spoilt(0, 2, -200.0), "principal_point_off_image"),
        (spoilt(1, 2, 800.0), "principal_point_off_image"),
        (spoilt(0, 0, 4.2), "focal_length_implausible"),
        (spoilt(0, 1, 3.0), "skew_ignored"),
        (turned, "cameras_turned_apart"),
        (lambda endoscope: moved(endoscope, -55.0, 0, 0), "baseline_implausible"),
        (lambda endoscope: moved(endoscope, -0.0055, 0, 0), "baseline_implausible"),
    ],
)
def test_what_is_implausible_is_a_warning(endoscope, change, code):
    (judgement,) = judgements(change(endoscope))
    assert (judgement.code, judgement.severity) == (code, Severity.WARNING)
    assert "--unit mm" not in judgement.remedy


def test_the_gravest_finding_comes_first_and_an_unknown_unit_is_a_note(endoscope):
    K = endoscope.K_left * np.array([[1, 1, 9], [1, 1, 1], [1, 1, 1]])
    bad = dataclasses.replace(moved(endoscope, 5, 0, 0), K_left=K, metres_per_unit=None)
    assert [judgement.severity for judgement in judgements(bad)] == [Severity.FAULT, Severity.WARNING, Severity.NOTE]
    assert judgements(bad)[-1].code == "unit_unknown"
    (judgement,) = judgements(dataclasses.replace(moved(endoscope, -5.5, 0, 0), metres_per_unit=1.0))
    assert "--unit mm" in judgement.remedy


def test_a_rotation_is_repaired_and_reported_where_rounding_does_not_explain_it():
    R = exp_so3(np.array([0.1, 0.2, 0.3]))
    exact, findings = repaired_rotation(R)
    assert exact is R
    assert findings == ()
    for digits, reported in ((4, []), (2, ["rotation_not_orthonormal"])):
        repaired, findings = repaired_rotation(R.round(digits))
        np.testing.assert_allclose(repaired @ repaired.T, np.eye(3), atol=1e-14)
        np.testing.assert_allclose(repaired, R, atol=10.0**-digits)
        assert [finding.code for finding in findings] == reported
    _, (finding,) = repaired_rotation(np.diag([1.0, 1.0, 1.0 + np.radians(0.1)]))
    assert "0.100 degrees" in finding.finding
    for none in (np.zeros((3, 3)), np.diag([1, 1, -1.0]), 1.1 * np.eye(3)):
        with pytest.raises(CalibrationError, match="no rotation"):
            repaired_rotation(none)
