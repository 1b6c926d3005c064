"""What follows from how two images lie to each other: each finding at its bounds, with severity and remedy."""

from dataclasses import replace

import pytest

from agents.perception.judging.alignment import about_distance, about_rotation, about_rows, about_sides, about_sizes
from agents.perception.judging.correspondence import Correspondence
from schemas.messages import RectifiedStereo, Severity

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)
WELL = Correspondence(
    row_residual_px=0.1,
    disparity_px=55.0,
    row_deviation_px=0.05,
    rotation_deg=0.01,
    rotation_deviation_deg=0.01,
    magnification=1.0,
    magnification_deviation=1e-4,
    off_rows_px=0.2,
    nearest_px=60.0,
    farthest_px=50.0,
    matches=300,
)


def found(answer):
    return answer.wrong and (answer.wrong.code, answer.wrong.severity)


@pytest.mark.parametrize(
    ("disparity_px", "mm"),
    [(13.0, 423), (55.0, None), (13.8, None), (5.0, 1100)],
)
def test_a_distance_at_which_no_endoscope_looks_is_said_with_what_to_check(disparity_px, mm):
    answer = about_distance(replace(WELL, disparity_px=disparity_px, nearest_px=disparity_px), CAMERA)
    if mm is None:
        assert answer.wrong is None and answer.is_known
        return
    assert found(answer) == ("distance_implausible", Severity.WARNING)
    assert f"most things would be {mm} mm away" in answer.found
    assert answer.wrong is not None and "baseline's unit" in answer.wrong.remedy


def test_a_distance_below_a_centimetre_is_implausible_too():
    near = replace(CAMERA, baseline=0.4)
    assert found(about_distance(WELL, near)) == ("distance_implausible", Severity.WARNING)


def test_without_a_unit_no_distance_is_judged():
    answer = about_distance(replace(WELL, disparity_px=1.0, nearest_px=1.0), replace(CAMERA, metres_per_unit=None))
    assert answer.wrong is None and "no unit" in answer.found


@pytest.mark.parametrize("seen", [replace(WELL, disparity_px=-20.0), replace(WELL, nearest_px=None)])
def test_distances_of_exchanged_or_unlike_images_are_unknown(seen):
    assert not about_distance(seen, CAMERA).is_known


def test_things_nearer_than_is_searched_are_said_whatever_their_unit():
    for camera in (CAMERA, replace(CAMERA, metres_per_unit=None)):
        answer = about_distance(replace(WELL, nearest_px=500.0), camera)
        assert found(answer) == ("disparity_range", Severity.WARNING)


def test_much_that_lies_behind_infinity_is_a_wrong_calibration():
    answer = about_sides(replace(WELL, disparity_px=4.0, farthest_px=-9.0, behind_share=0.2))
    assert found(answer) == ("disparity_sign", Severity.WARNING)
    assert "20% of what both eyes show would lie behind infinity" in answer.found
    assert found(about_sides(replace(WELL, behind_share=0.09))) is None


def test_what_is_within_its_doubt_is_not_called_wrong():
    rows = about_rows(replace(WELL, row_residual_px=1.5, off_rows_px=None, row_deviation_px=0.4), 540)
    assert not rows.is_known and "leave 0.4 px of doubt" in rows.found
    assert found(about_rotation(replace(WELL, rotation_deg=0.3, rotation_deviation_deg=0.1), 540, 960)) is None
    assert found(about_sizes(replace(WELL, magnification=1.01, magnification_deviation=0.003), 540)) is None


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (about_rows(replace(WELL, row_residual_px=1.5), 540), ("row_residual", Severity.WARNING)),
        (about_rows(replace(WELL, row_residual_px=-5.5), 540), ("row_residual", Severity.FAULT)),
        (about_rows(replace(WELL, off_rows_px=1.2), 540), ("row_residual", Severity.WARNING)),
        (about_rotation(replace(WELL, rotation_deg=0.3), 540, 960), ("rotated", Severity.WARNING)),
        (about_rotation(replace(WELL, rotation_deg=-0.8), 540, 960), ("rotated", Severity.FAULT)),
        (about_sizes(replace(WELL, magnification=1.01), 540), ("sizes_differ", Severity.WARNING)),
        (about_sizes(replace(WELL, magnification=0.97), 540), ("sizes_differ", Severity.FAULT)),
    ],
)
def test_what_is_certain_is_a_warning_and_beyond_one_percent_of_the_height_a_fault(answer, expected):
    assert found(answer) == expected
    assert answer.wrong is not None and answer.wrong.remedy
