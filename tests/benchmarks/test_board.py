import numpy as np
import pytest

from benchmarks.board import draw_thread, edge_places
from benchmarks.measures import against_edge
from benchmarks.scenes import StraightEdge


def chessboard(slope):
    """Two rows of squares of 40 px on either side of a slanted line, blurred; and the corners on that line."""
    v, u = np.mgrid[:200, :300].astype(float)
    distance = (v - 90.3 - slope * (u - 20.0)) / np.hypot(1, slope)
    square = np.where(((u - 20) // 40) % 2 == 0, 1.0, -1.0)
    image = 128 + 100 * square * np.tanh(distance / 1.2)
    corner_u = 20 + 40.0 * np.arange(6)
    corners = np.column_stack((corner_u, 90.3 + slope * (corner_u - 20)))
    return np.rint(image).astype(np.uint8)[..., None].repeat(3, axis=2), corners


@pytest.mark.parametrize("slope", [0.0, 0.13, -0.4])
def test_edges_are_found_where_the_brightness_changes_though_its_sign_alternates(slope):
    image, corners = chessboard(slope)
    wrong = corners + np.array([0.0, 1.5])
    places = edge_places(image, wrong)
    assert len(places) > 0.6 * 200
    off = places[1:-1, 1] - 90.3 - slope * (places[1:-1, 0] - 20.0)
    assert np.abs(off).max() < 0.25
    assert np.abs(off).mean() < 0.08


def test_a_drawn_thread_is_as_long_and_as_wide_as_told_and_ends_square():
    line = np.column_stack((np.linspace(30.0, 130.0, 101), np.full(101, 50.25)))
    painted, mask = draw_thread(np.full((100, 160, 3), 200, np.uint8), line)
    assert mask.sum() / 255 == pytest.approx(100 * 4.0, rel=0.01)
    v, u = np.mgrid[:100, :160]
    assert (mask * v).sum() / mask.sum() == pytest.approx(50.25, abs=0.02)
    assert (mask * u).sum() / mask.sum() == pytest.approx(80.0, abs=0.02)
    assert (mask[:, :29] == 0).all()
    assert (painted[mask == 0] == 200).all()
    assert (painted[mask == 255] < 100).all()


def test_a_straight_curve_of_the_right_length_has_no_error_and_a_bent_one_has():
    edge = StraightEdge(20.0, 20.2, 90.0)
    t = np.linspace(0, 1, 2001)[:, None]
    straight = t * [0.0, 12.0, 16.0] + [1.0, 2.0, 90.0]
    found = against_edge(straight, edge)
    assert (found["straightness"], found["length share"]) == pytest.approx((0.0, 0.0), abs=1e-9)
    bent = straight + np.sin(20 * np.pi * t) * [0.3, 0.0, 0.0]
    assert against_edge(bent, edge)["straightness"] == pytest.approx(0.3 / np.sqrt(2), rel=0.02)
