"""What both eyes' middles are told to err apart: the network's arithmetic, and what is moved by it and what is not."""

from dataclasses import replace

import numpy as np
import pytest

from agents.perception.both_eyes.apart import FADE, apart_px, drawn_together
from agents.perception.both_eyes.same_places import same_places
from agents.perception.both_eyes.shown import PLACES, Shown, from_other_side, numbers, numbers_from_other_side
from agents.perception.centrelines.along import Pieces
from schemas.messages import Centrelines
from shared.disparities import disparities

NUMBERS = 6 * len(PLACES) + 8
OF_NORMAL = 6 * len(PLACES) + 3
"""Which of the numbers is the normal's share along the row."""


def shown_at_random(rng, n):
    return Shown(
        rng.normal(0, 1, (2, n, len(PLACES), 3)).astype(np.float32),
        rng.normal(-2, 0.3, (2, n)).astype(np.float32),
        rng.normal(0, 0.6, (2, n, 2)).astype(np.float32),
        rng.uniform(3, 8, n).astype(np.float32),
    )


def weights_at_random(rng, states=4, networks=2):
    shapes = {"first": (NUMBERS, states), "of_all": (states, states), "out": (states, 2)}
    shapes |= {f"along{k}": (5 * states, states) for k in range(4)}
    weights = {name: rng.normal(0, shape[0] ** -0.5, (networks, *shape)) for name, shape in shapes.items()}
    weights |= {f"{name}_bias": rng.normal(0, 0.3, (networks, shape[1])) for name, shape in shapes.items()}
    return {name: value.astype(np.float32) for name, value in weights.items()}


def test_what_is_said_of_each_place_follows_from_its_whole_stretch_and_from_no_other():
    rng = np.random.default_rng(5)
    shown, weights = shown_at_random(rng, 43), weights_at_random(rng)
    said = apart_px(shown, Pieces(np.repeat([0, 1], [24, 19])), weights)
    # as loops over the layers of both networks, number by number, once told of these weights
    np.testing.assert_allclose(said[[0, 10, 23, 24, 42]], [-0.75834, -0.20289, 0.85904, -1.17236, 0.05514], atol=1e-4)
    alone = apart_px(shown, Pieces(np.zeros(43, np.int64)), weights)
    assert np.abs(alone - said).min() > 1e-6


def test_read_from_its_other_side_the_same_is_said_of_it_the_other_way():
    shown, stretches = shown_at_random(np.random.default_rng(6), 40), Pieces(np.zeros(40, np.int64))
    np.testing.assert_array_equal(numbers_from_other_side(numbers(shown)), numbers(from_other_side(shown)))
    said = apart_px(shown, stretches)
    assert np.abs(said).max() > 1e-3
    np.testing.assert_allclose(apart_px(from_other_side(shown), stretches), -said, atol=1e-6)


def wave(u, pieces=1):
    v = np.linspace(80.0, 280.0, 201)
    point = np.concatenate([np.column_stack((u + 60.0 * k + 10 * np.sin(v / 50), v)) for k in range(pieces)])
    n = len(point)
    return Centrelines(point, np.repeat(np.arange(pieces), len(v)), np.full(n, 5.0), np.full(n, 0.1))


def moved(line, disparity):
    return replace(line, point_px=line.point_px - np.array([disparity, 0.0]))


@pytest.fixture
def images():
    rng = np.random.default_rng(7)
    return tuple(rng.integers(0, 256, (360, 480, 3), dtype=np.uint8) for _ in range(2))


def always(px):
    """Weights that say so much wherever the normal points to the right, as far as it does."""
    weights = {name: np.zeros_like(value) for name, value in weights_at_random(np.random.default_rng(0), 2).items()}
    weights["first"][:, OF_NORMAL] = 1.0, -1.0
    weights["out"][..., 0] = px, -px
    return weights


def test_each_line_is_moved_across_itself_by_half_of_it_and_towards_the_other_one(images):
    left, right = wave(240.0), moved(wave(240.0), 40.0)
    drawn = drawn_together(images, (left, right), always(0.2))
    places = same_places(left, right, disparities(480))
    assert places is not None
    normal = places.left_normal[12]
    for line, before, sign in zip(drawn, (left, right), (1, -1), strict=True):
        move = line.point_px - before.point_px
        np.testing.assert_allclose(move[100], sign * 0.1 * normal[0] * normal, atol=0.01)
        # no step where it begins and ends
        assert np.abs(move[[0, -1]]).max() < 0.2 / FADE
        assert np.abs(np.diff(move, axis=0)).max() < 0.2 / FADE
        np.testing.assert_array_equal(line.deviation_px, before.deviation_px)
    disparity = drawn[0].point_px[100, 0] - drawn[1].point_px[100, 0]
    assert disparity == pytest.approx(40.0 + 0.2 * normal[0] ** 2, abs=0.01)


def test_nothing_is_moved_where_either_strand_may_be_the_same_nor_over_a_plain_ground(images):
    two = wave(200.0, pieces=2)
    assert drawn_together(images, (two, moved(two, 70.0)), always(0.2))[0] is two
    one, plain = wave(240.0), np.full_like(images[0], 200)
    assert drawn_together((images[0], plain), (one, moved(one, 40.0)), always(0.2))[0] is one


def test_nothing_is_moved_of_what_only_one_eye_sees(images):
    left, right = wave(300.0), moved(wave(300.0), 40.0)
    below = right.point_px[:, 1] > 180
    hidden = replace(
        right, point_px=right.point_px[below], piece=right.piece[below], width_px=right.width_px[below],
        deviation_px=right.deviation_px[below],
    )  # fmt: skip
    drawn, _ = drawn_together(images, (left, hidden), always(0.2))
    move = np.abs(drawn.point_px - left.point_px).max(axis=1)
    assert move[left.point_px[:, 1] <= 180].max() == 0
    assert move[left.point_px[:, 1] > 200].max() > 0.05
