import numpy as np
import pytest

from benchmarks.accuracy_goals import goals
from benchmarks.measures import MEASURES, covered, topology, topology_is_right
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
    found = covered(straight_thread(([0.5, 0.501], [0.5, 0.1]), places), truth, stretch)
    inside, count = found["hidden"]
    assert inside == count == pytest.approx(100, abs=2)
    inside, count = found["row-parallel"]
    assert inside / count == pytest.approx(1 / 3, abs=0.02)
    assert found["other"] == [0, 0]


def row(**changes):
    """A run of a published scene that meets every goal."""
    measures = dict.fromkeys(MEASURES)
    base = {"group": "ucsd sim", "masks": "none", "calibration": "", "status": "ok"}
    good = {"mean": 0.01, "frechet": 0.1, "mean seen": 0.01, "bound": 0.005}
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


def with_loop(count=1200):
    """A thread in a plane with one loop, and the indices at which it crosses itself."""
    t = np.linspace(-2.2, 2.2, count)
    curve = 20 * np.column_stack((t**3 - 3 * t, t**2, np.zeros(count)))
    along = np.concatenate(([0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))))
    even = np.interp(np.linspace(0, along[-1], count), along, t)
    curve = 20 * np.column_stack((even**3 - 3 * even, even**2, 0.1 * even))
    return curve, np.abs(even) < np.sqrt(3)


def compared(curve, truth):
    return topology(curve, truth, curve[:, :2], truth[:, :2])


def test_a_curve_near_the_truth_has_its_topology_in_either_direction():
    truth, _ = with_loop()
    near = truth + 0.5 * np.sin(np.linspace(0, 30, len(truth)))[:, None]
    for curve in (near, near[::-1]):
        found = compared(curve, truth)
        assert found == {"in order": True, "crossings": 1, "true crossings": 1}


def test_a_loop_that_is_skipped_or_walked_backwards_is_a_wrong_order():
    truth, loop = with_loop()
    skipped = truth[~loop]
    backwards = np.concatenate(
        (truth[: loop.argmax()], truth[loop][::-1], truth[loop][-1:], truth[~loop][loop.argmax() :])
    )
    assert not compared(skipped, truth)["in order"]
    assert not compared(backwards, truth)["in order"]
    assert compared(skipped, truth)["crossings"] == 0


def test_a_crossing_too_few_in_the_picture_is_wrong_though_the_order_is_right():
    truth, _ = with_loop()
    half = truth[: len(truth) // 2 + 1]
    assert compared(half, half) == {"in order": True, "crossings": 0, "true crossings": 0}
    picture = np.column_stack((np.linspace(0, 100, len(truth)), np.zeros(len(truth))))
    found = topology(truth, truth, picture, truth[:, :2])
    assert (found["in order"], found["crossings"], topology_is_right(found)) == (True, 0, False)
