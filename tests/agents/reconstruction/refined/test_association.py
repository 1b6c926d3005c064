"""Which place of a moved curve each point of both centrelines shows."""

import numpy as np
import pytest

from agents.reconstruction.refined.association import associated
from agents.reconstruction.refined.cubic import fitted
from agents.reconstruction.refined.points import chosen_points
from agents.reconstruction.refined.projection import LEVEL, Curve
from schemas.messages import Centrelines, no_centrelines
from shared.camera import project

SPANS = 40


def winding(t):
    return np.column_stack((-20 + 40 * t, 9 * np.sin(5 * t), 95 + 6 * np.cos(4 * t)))


def loop(t):
    turn = 2 * np.pi * 1.15 * t
    return np.column_stack((12 * np.cos(turn) - 14 * t, 12 * np.sin(turn), 95 + 4 * t))


@pytest.fixture(scope="module")
def wound(make_spline):
    return make_spline(winding, SPANS)


@pytest.fixture
def show(camera):
    """Both centrelines of these stretches of a curve, and the true place of each point."""

    def of(curve, *stretches, shift=(0.0, 0.0)):
        s = [np.arange(a, b, 0.0012) for a, b in stretches or ((0.0, 1.0),)]
        places, piece = np.concatenate(s), np.repeat(np.arange(len(s)), [len(part) for part in s])
        n = len(places)
        lines = [
            Centrelines(pixels + shift, piece, np.full(n, 3.0), np.full(n, 0.1))
            for pixels in project(camera, curve.at(places))
        ]
        return lines, places

    return of


@pytest.fixture
def look(camera):
    def at(curve, lines, votes=True):
        return associated(curve, chosen_points(tuple(lines), camera, 200), camera, LEVEL, votes=votes)

    return at


def off(seen, lines, places):
    """How far the places of sightings are from the true ones, as shares of the curve."""
    worst = 0.0
    for eye in (0, 1):
        of_eye = seen.sight.eye == eye
        which = np.linalg.norm(seen.sight.point_px[of_eye][:, None] - lines[eye].point_px[None], axis=2).argmin(axis=1)
        worst = max(worst, np.abs(seen.sight.s[of_eye] - places[which]).max())
    return worst


@pytest.mark.parametrize("shape", [winding, loop])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (14.0, -9.0), (-18.0, 12.0)])
def test_a_thread_that_moved_as_a_whole_is_found_place_by_place(make_spline, show, look, shape, shift):
    curve = make_spline(shape, SPANS)
    lines, places = show(curve, shift=shift)
    seen = look(curve, lines)
    assert seen.found_share == pytest.approx(1.0, abs=0.06)
    assert seen.shown_shares == pytest.approx((1.0, 1.0), abs=0.06)
    # three pixels of some eight hundred
    assert off(seen, lines, places) < 0.012
    ends = seen.sight.is_end
    assert sorted(zip(seen.sight.eye[ends], seen.sight.s[ends], strict=True)) == [(0, 0), (0, 1), (1, 0), (1, 1)]


def test_where_a_tool_hides_the_last_fifth_no_end_is_seen(wound, show, look):
    seen = look(wound, show(wound, (0.0, 0.8))[0])
    assert set(seen.sight.s[seen.sight.is_end]) == {0.0}
    assert seen.found_share == pytest.approx(1.0, abs=0.02)
    assert seen.shown_shares == pytest.approx((0.8, 0.8), abs=0.03)
    assert (seen.hidden_share, seen.alone_share) == (pytest.approx(0.2, abs=0.03), pytest.approx(0.0, abs=0.03))


def test_what_one_image_shows_alone_is_told_from_what_both_show(wound, show, look):
    (left, right), (left_part, right_part) = (show(wound, (0.0, end))[0] for end in (0.9, 0.4))
    for lines, shares in (((left, right_part), (0.9, 0.4)), ((left_part, right), (0.4, 0.9))):
        seen = look(wound, lines)
        assert seen.shown_shares == pytest.approx(shares, abs=0.03)
        assert (seen.hidden_share, seen.alone_share) == (pytest.approx(0.1, abs=0.03), pytest.approx(0.5, abs=0.05))


def test_pieces_may_come_in_any_order_and_direction(wound, show, look):
    (left, right), places = show(wound, (0.6, 1.0), (0.0, 0.5))
    turned = Centrelines(left.point_px[::-1].copy(), 1 - left.piece[::-1], left.width_px, left.deviation_px)
    seen = look(wound, (turned, right))
    assert seen.found_share == pytest.approx(1.0, abs=0.02)
    assert off(seen, (left, right), places) < 0.012


def test_thread_that_goes_on_past_the_end_is_told(wound, show, look, camera):
    short = Curve(wound.knots, fitted(SPANS, wound.at(np.linspace(0, 0.9, 5 * (SPANS + 3)))))
    seen = look(short, show(wound)[0], votes=False)
    ends = np.linalg.norm(np.diff(project(camera, wound.at(np.array((0.9, 1.0))))[0], axis=0))
    assert seen.beyond_px == pytest.approx(ends, rel=0.2)


def test_what_lies_elsewhere_and_no_points_at_all_find_no_place(wound, show, look):
    elsewhere = look(wound, show(wound, shift=(0.0, 100.0))[0])
    assert max(elsewhere.found_share, *elsewhere.shown_shares) < 0.4
    none = look(wound, (no_centrelines(), no_centrelines()))
    assert (len(none.sight.s), none.found_share, none.shown_shares) == (0, 0.0, (0.0, 0.0))
    assert (none.hidden_share, none.alone_share) == (1.0, 0.0)
    point = Centrelines(np.ones((1, 2)), np.zeros(1, np.int64), np.ones(1), np.ones(1))
    assert look(wound, (point, no_centrelines())).found_share == 0.0


def test_a_point_takes_its_direction_from_its_own_piece(camera):
    across = np.column_stack((100.0 + np.arange(40.0), np.full(40, 50.0)))
    down = np.column_stack((np.full(40, 140.0), 50.0 + np.arange(40.0)))
    piece = np.repeat([0, 1], 40)
    lines = Centrelines(np.concatenate((across, down)), piece, np.full(80, 3.0), np.full(80, 0.1))
    for both in ((lines, no_centrelines()), (no_centrelines(), lines)):
        points = chosen_points(both, camera, 20)
        first, second = (points.piece == piece for piece in np.unique(points.piece))
        np.testing.assert_allclose(points.direction[first], [[1.0, 0.0]] * np.sum(first))
        np.testing.assert_allclose(points.direction[second], [[-1.0, 0.0]] * np.sum(second))
        np.testing.assert_array_equal(points.point_px[points.is_end], [across[0], across[-1], down[0], down[-1]])


def test_how_far_the_thread_is_from_the_curve_counts_beside_it_and_at_its_ends(wound, show, look, camera):
    assert look(wound, show(wound)[0]).farthest_px < 0.5
    for shift, votes in (((0.0, 2.0), False), ((0.0, 2.0), True), ((14.0, -9.0), True)):
        seen = look(wound, show(wound, shift=shift)[0], votes=votes)
        assert 0.8 * np.hypot(*shift) < seen.farthest_px < 1.5 * np.hypot(*shift)
    ends = np.linalg.norm(np.diff(project(camera, wound.at(np.array((0.0, 0.006))))[0], axis=0))
    assert look(wound, show(wound, (0.006, 1.0))[0]).farthest_px == pytest.approx(ends, rel=0.05)
