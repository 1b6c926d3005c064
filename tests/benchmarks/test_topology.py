import numpy as np

from benchmarks.measures import topology


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


def test_a_crossing_too_few_in_the_picture_is_wrong_though_the_order_is_right():
    truth, _ = with_loop()
    half = truth[: len(truth) // 2 + 1]
    assert (compared(half, half).crossings, compared(half, half).right) == (0, True)
    picture = np.column_stack((np.linspace(0, 100, len(truth)), np.zeros(len(truth))))
    found = topology(truth, truth, picture, truth[:, :2])
    assert (found.in_order, found.crossings, found.right) == (True, 0, False)
