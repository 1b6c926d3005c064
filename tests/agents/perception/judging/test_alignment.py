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


NO_UNIT = replace(CAMERA, metres_per_unit=None)
WARNING, FAULT = Severity.WARNING, Severity.FAULT


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (about_distance(replace(WELL, disparity_px=13.0, nearest_px=13.0), CAMERA), ("distance_implausible", WARNING)),
        (about_distance(replace(WELL, disparity_px=13.8, nearest_px=13.8), CAMERA), None),
        # below a centimetre
        (about_distance(WELL, replace(CAMERA, baseline=0.4)), ("distance_implausible", WARNING)),
        (about_distance(replace(WELL, disparity_px=1.0, nearest_px=1.0), NO_UNIT), None),
        # nearer than is searched, whatever the unit
        (about_distance(replace(WELL, nearest_px=500.0), CAMERA), ("disparity_range", WARNING)),
        (about_distance(replace(WELL, nearest_px=500.0), NO_UNIT), ("disparity_range", WARNING)),
        (about_sides(replace(WELL, disparity_px=4.0, farthest_px=-9.0, behind_share=0.2)), ("disparity_sign", WARNING)),
        (about_sides(replace(WELL, behind_share=0.09)), None),
        (about_rows(replace(WELL, row_residual_px=1.5), 540), ("row_residual", WARNING)),
        # from one percent of the height on
        (about_rows(replace(WELL, row_residual_px=-5.5), 540), ("row_residual", FAULT)),
        (about_rows(replace(WELL, off_rows_px=1.2), 540), ("row_residual", WARNING)),
        (about_rotation(replace(WELL, rotation_deg=0.3), 540, 960), ("rotated", WARNING)),
        (about_rotation(replace(WELL, rotation_deg=-0.8), 540, 960), ("rotated", FAULT)),
        (about_sizes(replace(WELL, magnification=1.01), 540), ("sizes_differ", WARNING)),
        (about_sizes(replace(WELL, magnification=0.97), 540), ("sizes_differ", FAULT)),
        # within its doubt nothing is called wrong
        (about_rotation(replace(WELL, rotation_deg=0.3, rotation_deviation_deg=0.1), 540, 960), None),
        (about_sizes(replace(WELL, magnification=1.01, magnification_deviation=0.003), 540), None),
    ],
)
def test_what_is_certain_is_a_warning_or_a_fault_with_its_remedy(answer, expected):
    if expected is None:
        assert answer.wrong is None
    else:
        assert (answer.wrong.code, answer.wrong.severity) == expected
        assert answer.wrong.remedy


def test_what_cannot_be_told_is_unknown():
    for seen in (replace(WELL, disparity_px=-20.0), replace(WELL, nearest_px=None)):
        assert not about_distance(seen, CAMERA).is_known
    rows = about_rows(replace(WELL, row_residual_px=1.5, off_rows_px=None, row_deviation_px=0.4), 540)
    assert not rows.is_known
    assert "leave 0.4 px of doubt" in rows.found
    assert "most things would be 1100 mm away" in about_distance(replace(WELL, disparity_px=5.0), CAMERA).found
