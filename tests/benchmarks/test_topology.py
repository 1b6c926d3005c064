import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.topology import places_along, self_crossings, topology


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
        assert (found.in_order, found.crossings, found.true_crossings, found.right) == (True, 1, 1, True)


def test_a_loop_that_is_skipped_or_walked_backwards_is_a_wrong_order():
    truth, loop = with_loop()
    skipped = truth[~loop]
    backwards = np.concatenate(
        (truth[: loop.argmax()], truth[loop][::-1], truth[loop][-1:], truth[~loop][loop.argmax() :])
    )
    assert not compared(skipped, truth).in_order
    assert not compared(backwards, truth).in_order
    assert compared(skipped, truth).crossings == 0


def test_a_curve_that_ends_early_leaves_out_a_part():
    truth, _ = with_loop()
    assert not compared(truth[:1000], truth).in_order
    assert compared(truth[:1190], truth).in_order


def test_a_crossing_too_few_in_the_picture_is_wrong_though_the_order_is_right():
    truth, _ = with_loop()
    half = truth[: len(truth) // 2 + 1]
    assert (compared(half, half).crossings, compared(half, half).right) == (0, True)
    picture = np.column_stack((np.linspace(0, 100, len(truth)), np.zeros(len(truth))))
    found = topology(truth, truth, picture, truth[:, :2])
    assert (found.in_order, found.crossings, found.right) == (True, 0, False)


def test_kinks_are_no_crossings():
    straight = np.column_stack((np.linspace(0, 100, 400), np.zeros(400)))
    straight[200:203] = [(50.5, 0.1), (49.5, 0.1), (50.4, -0.2)]
    assert self_crossings(straight) == 0


@pytest.mark.parametrize("turns", [1, 2, 3, 7])
def test_a_cycloid_crosses_itself_once_for_every_turn(turns):
    t = np.linspace(0, 2 * np.pi * turns, 2000)
    looped = np.column_stack((t - 4 * np.sin(t), -4 * np.cos(t)))
    # loops of neighbouring turns meet as well where they are wider than the turn is long
    few = looped[::5]
    i, j = np.triu_indices(len(few) - 1, k=6)
    along = np.diff(few, axis=0)
    matrices, offsets = np.stack((along[i], -along[j]), axis=2), few[j] - few[i]
    meet = np.abs(np.linalg.det(matrices)) > 1e-12
    x, y = np.linalg.solve(matrices[meet], offsets[meet][..., None])[..., 0].T
    brute = np.count_nonzero((x > 0) & (x < 1) & (y > 0) & (y < 1))
    assert self_crossings(few) == brute
    assert brute >= turns - 1


@given(st.integers(0, 1000), st.floats(0.0, 0.4))
def test_a_noisy_curve_is_matched_to_places_near_its_own(seed, noise):
    truth, _ = with_loop(400)
    places = places_along(truth + np.random.default_rng(seed).normal(0, noise, truth.shape), truth)
    assert np.abs(places - np.arange(400)).max() <= 8
