"""Which place of a moved curve each point of both centrelines shows."""

import numpy as np
import pytest

from agents.reconstruction.refined.association import associated
from agents.reconstruction.refined.points import chosen_points
from agents.reconstruction.refined.projection import LEVEL, Curve, fitted
from schemas.messages import Centrelines, no_centrelines
from shared.camera import project
from tests.agents.reconstruction.threads import CAMERA, spline_of

SPANS = 40


def loop(t):
    turn = 2 * np.pi * 1.15 * t
    return np.column_stack((12 * np.cos(turn) - 14 * t, 12 * np.sin(turn), 95 + 4 * t))


WOUND = spline_of(lambda t: np.column_stack((-20 + 40 * t, 9 * np.sin(5 * t), 95 + 6 * np.cos(4 * t))), SPANS)
LOOP = spline_of(loop, SPANS)


def show(curve, *stretches, shift=(0.0, 0.0)):
    """Both centrelines of these stretches of a curve, and the true place of each point."""
    s = [np.arange(a, b, 0.0012) for a, b in stretches or ((0.0, 1.0),)]
    places, piece = np.concatenate(s), np.repeat(np.arange(len(s)), [len(part) for part in s])
    n = len(places)
    lines = [
        Centrelines(pixels + shift, piece, np.full(n, 3.0), np.full(n, 0.1))
        for pixels in project(CAMERA, curve.at(places))
    ]
    return lines, places


def look(curve, lines, votes=True):
    return associated(curve, chosen_points(tuple(lines), CAMERA, 200), CAMERA, LEVEL, votes=votes)


def off(seen, lines, places):
    """How far the places of sightings are from the true ones, as shares of the curve."""
    worst = 0.0
    for eye in (0, 1):
        of_eye = seen.sight.eye == eye
        which = np.linalg.norm(seen.sight.point_px[of_eye][:, None] - lines[eye].point_px[None], axis=2).argmin(axis=1)
        worst = max(worst, np.abs(seen.sight.s[of_eye] - places[which]).max())
    return worst


def length_px(curve, low, high):
    """Of a stretch of it in the left image."""
    return np.linalg.norm(np.diff(project(CAMERA, curve.at(np.array((low, high))))[0], axis=0))


@pytest.mark.parametrize("curve", [WOUND, LOOP])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (14.0, -9.0), (-18.0, 12.0)])
def test_a_thread_that_moved_as_a_whole_is_found_place_by_place(curve, shift):
    lines, places = show(curve, shift=shift)
    seen = look(curve, lines)
    assert seen.found_share == pytest.approx(1.0, abs=0.06)
    assert seen.shown_shares == pytest.approx((1.0, 1.0), abs=0.06)
    # three pixels of some eight hundred
    assert off(seen, lines, places) < 0.012
    ends = seen.sight.is_end
    assert sorted(zip(seen.sight.eye[ends], seen.sight.s[ends], strict=True)) == [(0, 0), (0, 1), (1, 0), (1, 1)]


def test_what_a_tool_hides_is_told_from_what_one_image_shows_alone():
    def lines(*shown):
        return [show(WOUND, (0.0, end))[0][eye] for eye, end in enumerate(shown)]

    seen = look(WOUND, lines(0.8, 0.8))
    assert set(seen.sight.s[seen.sight.is_end]) == {0.0}
    assert seen.found_share == pytest.approx(1.0, abs=0.02)
    for shown, hidden, alone in (((0.8, 0.8), 0.2, 0.0), ((0.9, 0.4), 0.1, 0.5), ((0.4, 0.9), 0.1, 0.5)):
        seen = look(WOUND, lines(*shown))
        assert seen.shown_shares == pytest.approx(shown, abs=0.03)
        assert (seen.hidden_share, seen.alone_share) == (
            pytest.approx(hidden, abs=0.03),
            pytest.approx(alone, abs=0.05),
        )


def test_how_far_the_thread_is_from_the_curve_counts_beside_it_and_at_its_ends():
    assert look(WOUND, show(WOUND)[0]).farthest_px < 0.5
    for shift, votes in (((0.0, 2.0), False), ((0.0, 2.0), True), ((14.0, -9.0), True)):
        seen = look(WOUND, show(WOUND, shift=shift)[0], votes=votes)
        assert 0.8 * np.hypot(*shift) < seen.farthest_px < 1.5 * np.hypot(*shift)
    cut = look(WOUND, show(WOUND, (0.006, 1.0))[0])
    assert cut.farthest_px == pytest.approx(length_px(WOUND, 0.0, 0.006), rel=0.05)
    # thread that goes on past the curve's end
    short = Curve(WOUND.knots, fitted(SPANS, WOUND.at(np.linspace(0, 0.9, 5 * (SPANS + 3)))))
    seen = look(short, show(WOUND)[0], votes=False)
    assert seen.beyond_px == pytest.approx(length_px(WOUND, 0.9, 1.0), rel=0.2)


def test_what_lies_elsewhere_and_no_points_at_all_find_no_place():
    elsewhere = look(WOUND, show(WOUND, shift=(0.0, 100.0))[0])
    assert max(elsewhere.found_share, *elsewhere.shown_shares) < 0.4
    none = look(WOUND, (no_centrelines(), no_centrelines()))
    assert (len(none.sight.s), none.found_share, none.shown_shares) == (0, 0.0, (0.0, 0.0))
    assert (none.hidden_share, none.alone_share) == (1.0, 0.0)
    point = Centrelines(np.ones((1, 2)), np.zeros(1, np.int64), np.ones(1), np.ones(1))
    assert look(WOUND, (point, no_centrelines())).found_share == 0.0
