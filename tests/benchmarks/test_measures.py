import numpy as np
import pytest

from benchmarks.measures import NEAR_MASK, OF_EDGE, OF_IMAGES, OF_TRUTH, REPROJECTION, believed, goals
from schemas.messages import FrameStamp, RectifiedStereo, ReliabilityRegions, Status, ThreadReconstruction
from shared.splines import basis_matrix, clamped_uniform_knots

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)


def straight_thread(deviation, places):
    """A reconstruction of the line from (-20, 0, 90) to (20, 0, 90) that says how far it may be off, in mm."""
    knots = clamped_uniform_knots(8)
    s = np.linspace(0, 1, 50)
    P = np.linalg.lstsq(basis_matrix(knots, 3, s), np.column_stack((40 * s - 20, 0 * s, 0 * s + 90)), rcond=None)[0]
    none = np.zeros(0)
    return ThreadReconstruction(
        stamp=FrameStamp(sequence=0, capture_left_ns=0, capture_right_ns=0, calibration_id=""),
        camera=CAMERA,
        status=Status.OK,
        reason="",
        method="test",
        degree=3,
        knots=knots,
        control_points_camera=P,
        regions=ReliabilityRegions(none, np.zeros((0, 3)), np.zeros((0, 2)), none, none),
        confidence_s=none,
        confidence=none,
        posterior_s=places,
        posterior_covariance=np.eye(3) * np.interp(places, *deviation)[:, None, None] ** 2,
    )


def test_coverage_counts_places_evenly_and_apart_by_stretch():
    truth = np.column_stack((np.linspace(-20, 20, 2001), np.full(2001, 0.5), np.full(2001, 90.0)))
    stretch = np.where(np.arange(2001) < 500, 1, 0)
    # sure of itself in the second half, where most of its places are
    places = np.concatenate((np.linspace(0, 0.5, 5), np.linspace(0.501, 1, 95)))
    found = believed(straight_thread(([0.5, 0.501], [0.5, 0.1]), places), truth, stretch)
    inside, count = found["coverage"]["hidden"]
    assert inside == count == pytest.approx(100, abs=2)
    inside, count = found["coverage"]["row-parallel"]
    assert inside / count == pytest.approx(1 / 3, abs=0.02)
    assert found["coverage"]["other"] == [0, 0]


def test_the_likelihood_is_that_of_the_normal_plane():
    truth = np.column_stack((np.linspace(-20, 20, 2001), np.full(2001, 0.5), np.full(2001, 90.0)))
    found = believed(straight_thread(([0, 1], [0.4, 0.4]), np.linspace(0, 1, 20)), truth, np.zeros(2001, np.int64))
    assert found["nll"] == pytest.approx(np.log(2 * np.pi * 0.4**2) + 0.5 * (0.5 / 0.4) ** 2, rel=1e-3)


def row(**changes):
    """A run of a published scene that meets every goal."""
    measures = dict.fromkeys((*OF_TRUTH, *OF_IMAGES, *OF_EDGE, *REPROJECTION, *NEAR_MASK))
    base = {"group": "ucsd sim", "masks": "none", "calibration": "", "status": "ok", "parallel": False}
    good = {"mean": 0.01, "frechet": 0.1, "mean seen": 0.01, "bound": 0.005, "nll": -3.0}
    order = {"in order": True, "crossings": 1, "true crossings": 1}
    covered = {"coverage": {"row-parallel": [95, 100], "hidden": [95, 100], "other": [190, 200]}}
    return measures | base | good | order | covered | changes


def verdicts(rows):
    return {goal.what: goal.met for goal in goals(rows)}


def test_good_runs_meet_the_goals_and_carry_their_bound():
    found = goals([row() for _ in range(3)])
    assert all(goal.met for goal in found if goal.goal != "-")
    assert next(goal for goal in found if "mean error" in goal.what).bound == "0.005 / 0.005"


def test_a_failure_is_never_met_however_good_the_rest():
    assert not verdicts([row(), row(status="failed", mean=None, coverage=None)])["ucsd sim: mean error, median / worst"]
    crossing = {"group": "crossing render", "masks": "true"}
    lost = row(**crossing, status="failed", **{"mean": None, "frechet": None, "in order": None})
    found = verdicts([row(**crossing), lost])
    assert [met for what, met in found.items() if "crossings, masks true" in what] == [False] * 4


def test_one_crossing_too_many_is_a_wrong_topology():
    found = verdicts([row(group="crossing render", masks="true", crossings=2)])
    assert found["renders with crossings, masks true: topology right"] is False


def test_too_much_coverage_is_as_wrong_as_too_little():
    for inside in (80, 100):
        share = {"row-parallel": [inside, 100], "hidden": [inside, 100], "other": [inside, 100]}
        found = verdicts([row(coverage=share)])
        assert not found["95 % ellipse (sim, plain, and renders, true masks), all"]
