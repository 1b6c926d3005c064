"""Straight threads through, beside and beyond two hinged fingers, in closed form."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.simulator.fingers import WIDTH_M, between, contact_rad, offset_from_wedge, within_reach
from shared.kinematics.psm import FINGER_M

MM = 1e-3
ACROSS = (1.0, 0.0, 0.0)


def straight(through: tuple[float, float, float], direction=ACROSS, half_length=20.0, count=801) -> np.ndarray:
    """Samples in metres of a straight thread, given in millimetres of the tool frame."""
    unit = np.array(direction) / np.linalg.norm(direction)
    return MM * (np.array(through) + np.linspace(-half_length, half_length, count)[:, None] * unit)


def caught(through, opening, direction=ACROSS, **options) -> bool:
    return between(straight(through, direction), opening, **options) is not None


@pytest.mark.parametrize(("end_mm", "met"), [(-1.05, False), (-0.95, True)])
def test_a_thread_that_ends_beside_the_fingers_is_caught_if_they_are_wide_enough_to_meet_it(end_mm, met):
    thread = MM * np.column_stack((np.linspace(end_mm - 30.0, end_mm, 801), np.zeros(801), np.full(801, 7.0)))
    assert (between(thread, 0.5) is not None) == met


def test_a_thread_across_the_fingers_is_not_between_them():
    assert not caught((0.0, 0.0, 7.0), 0.8, direction=(0.3, 1.0, 0.0))
    assert caught((0.0, 0.0, 7.0), 0.8, direction=(1.0, 1.0, 0.0))
    assert caught((0.0, 0.0, 7.0), 0.8, direction=(0.5, 0.0, 1.0))


def test_give_widens_the_opening_but_not_the_fingers_length():
    beside = (0.0, 7.0 * np.tan(0.15) + 0.8, 7.0)
    assert not caught(beside, 0.3)
    assert caught(beside, 0.3, give_m=1.0 * MM)
    assert not caught((0.0, 0.0, 10.3), 0.3, give_m=1.0 * MM)


def test_of_two_strands_the_one_nearest_along_the_thread_is_followed():
    # there and back again, 1 mm apart: the strands cross the fingers at samples 200 and 600
    there, back = straight((0.0, 0.2, 6.0), count=401), straight((0.0, -0.5, 7.0), count=401)[::-1]
    both = np.vstack((there, back[1:]))
    assert [between(both, 0.5, near=near) for near in (None, 620, 190)] == [200, 600, 200]


@given(y=st.floats(-15, 15), z=st.floats(-15, 25), opening=st.floats(-0.6, 1.4))
def test_a_thread_along_the_pin_is_between_exactly_where_its_offset_is_zero(y, z, opening):
    thread = straight((0.0, y, z))
    offset = offset_from_wedge(thread, opening)
    if between(thread, opening) is not None:
        assert offset.distance_m < 1e-12
    else:
        # sampled densely, the wedge has no point as near as the offset says but there
        r, a = np.meshgrid(np.linspace(0, FINGER_M, 80), np.linspace(-1, 1, 81) * max(opening, 0) / 2)
        nearest = np.hypot(r * np.sin(a) - MM * y, r * np.cos(a) - MM * z).min()
        assert nearest - 0.25 * MM < offset.distance_m <= nearest + 1e-12


@pytest.mark.parametrize(
    ("through", "distance", "where"),
    [
        ((0.0, 0.0, 12.2), 2.0, "beyond the fingertips"),
        ((0.0, 5.0, 5.0), 5.0 * np.cos(0.25) - 5.0 * np.sin(0.25), "beside the fingers"),
        ((-24.0, 0.0, 7.0), 3.0, "to the side of the fingers"),
    ],
)
def test_an_offset_says_how_far_and_which_way(through, distance, where):
    offset = offset_from_wedge(straight(through), 0.5)
    assert offset.distance_m == pytest.approx(MM * distance, abs=1e-9)
    assert offset.where == where


def test_fingers_touch_a_thread_when_their_gap_is_its_width():
    angle = contact_rad(8.0 * MM, 0.2 * MM)
    assert 2 * 8.0 * MM * np.sin(angle / 2) == pytest.approx(2 * 0.2 * MM)


@given(
    through=st.tuples(*[st.floats(-20, 20)] * 3),
    direction=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: np.linalg.norm(d) > 0.1),
    opening=st.floats(-10, 10),
)
def test_of_any_thread_what_is_between_the_fingers_is_within_their_reach_and_width(through, direction, opening):
    thread = straight(through, direction, count=101)
    sample = between(thread, opening)
    assert sample is None or (within_reach(thread, np.zeros(3)) and abs(thread[sample, 0]) <= WIDTH_M / 2)
    assert offset_from_wedge(thread, opening).distance_m >= 0
