"""What both eyes' middles are told to err apart: the network's arithmetic, and what is moved by it and what is not."""

from dataclasses import replace

import numpy as np
import pytest

from agents.perception.both_eyes import apart
from agents.perception.both_eyes.apart import CARRIED_SHARE, FADE, apart_px, drawn_together, own_weights
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


def said_in_loops(seen, weights):
    """One stretch, number by number, as the layers are defined."""
    n, states = len(seen), len(weights["first_bias"])
    state = [
        [max(0.0, float(weights["first_bias"][k] + seen[i] @ weights["first"][:, k])) for k in range(states)]
        for i in range(n)
    ]
    mean = [sum(row[k] for row in state) / n for k in range(states)]
    for row in state:
        for k in range(states):
            row_add = weights["of_all_bias"][k] + sum(mean[j] * weights["of_all"][j, k] for j in range(states))
            row[k] += max(0.0, float(row_add))
    for layer, dilation in enumerate((1, 2, 4, 8)):
        after = []
        for i in range(n):
            row = []
            for k in range(states):
                total = float(weights[f"along{layer}_bias"][k])
                for tap in range(5):
                    other = state[min(max(i + (tap - 2) * dilation, 0), n - 1)]
                    total += sum(other[j] * float(weights[f"along{layer}"][tap * states + j, k]) for j in range(states))
                row.append(state[i][k] + max(0.0, total))
            after.append(row)
        state = after
    return np.array(
        [weights["out_bias"][0] + sum(row[k] * weights["out"][k, 0] for k in range(states)) for row in state]
    )


def test_numbers_from_the_other_side_are_those_of_profiles_that_are_read_from_there():
    shown = shown_at_random(np.random.default_rng(5), 7)
    np.testing.assert_array_equal(numbers_from_other_side(numbers(shown)), numbers(from_other_side(shown)))


def test_what_is_said_is_the_mean_of_what_the_layers_of_all_networks_say_number_by_number():
    rng = np.random.default_rng(5)
    shown, weights = shown_at_random(rng, 43), weights_at_random(rng)
    stretches = Pieces(np.repeat([0, 1], [24, 19]))
    said = apart_px(shown, stretches, weights)
    for part in (slice(0, 24), slice(24, 43)):
        networks = [{name: value[k] for name, value in weights.items()} for k in range(2)]
        here, there = (
            np.mean([said_in_loops(numbers(each)[part], network) for network in networks], axis=0)
            for each in (shown, from_other_side(shown))
        )
        np.testing.assert_allclose(said[part], (here - there) / 2, atol=1e-5)


def test_read_from_its_other_side_the_same_is_said_of_it_the_other_way():
    shown, stretches = shown_at_random(np.random.default_rng(6), 40), Pieces(np.zeros(40, np.int64))
    said = apart_px(shown, stretches)
    assert np.abs(said).max() > 1e-3
    np.testing.assert_allclose(apart_px(from_other_side(shown), stretches), -said, atol=1e-6)


def test_the_projects_own_weights_are_small_and_fit_what_is_shown():
    assert own_weights()["first"].shape[1] == NUMBERS
    assert apart.WEIGHTS.stat().st_size < 300_000


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


def test_along_the_rows_a_smaller_share_of_what_is_told_counts(images):
    level = np.arange(1.0, 240)
    nearly = np.column_stack((120 + level, 80 - 0.2 * level))
    up = np.column_stack((np.full(150, 120.0), np.linspace(229, 80, 150)))
    n = len(up) + len(nearly)
    left = Centrelines(np.concatenate((up, nearly)), np.zeros(n, np.int64), np.full(n, 5.0), np.full(n, 0.1))
    drawn, _ = drawn_together(images, (left, moved(left, 40.0)), always(0.2))
    move = np.linalg.norm(drawn.point_px - left.point_px, axis=1)
    along_the_rows = 0.2 / np.hypot(1.0, 0.2)
    assert move[75] == pytest.approx(0.1, abs=0.01)
    assert move[270] == pytest.approx(CARRIED_SHARE * 0.1 * along_the_rows, rel=0.1)


def test_a_right_line_that_begins_at_its_other_end_is_moved_alike(images):
    left, right = wave(240.0), moved(wave(240.0), 40.0)
    turned = replace(right, point_px=right.point_px[::-1].copy())
    (_, one), (_, other) = (drawn_together(images, (left, each), always(0.2)) for each in (right, turned))
    np.testing.assert_allclose(other.point_px[::-1][10:-10], one.point_px[10:-10], atol=0.01)


def test_nothing_is_moved_where_it_is_not_known_which_strand_is_the_same(images):
    left, right = wave(200.0, pieces=2), moved(wave(200.0, pieces=2), 70.0)
    drawn = drawn_together(images, (left, right), always(0.2))
    assert drawn[0] is left
    assert drawn[1] is right


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


def test_nothing_is_moved_over_a_plain_ground(images):
    left, right = wave(240.0), moved(wave(240.0), 40.0)
    plain = np.full_like(images[0], 200)
    for pair in ((plain, plain), (images[0], plain)):
        assert drawn_together(pair, (left, right), always(0.2))[0] is left


def test_nothing_leaves_the_image(images):
    left = wave(479.0 - 5.0)
    left = replace(left, point_px=np.minimum(left.point_px, [479.0, 359.0]))
    right = moved(wave(479.0 - 5.0), 40.0)
    for weights in (always(0.5), always(-0.5)):
        drawn = drawn_together(images, (left, right), weights)
        assert drawn[0].point_px[:, 0].max() <= 479.0


@pytest.mark.parametrize("seed", range(20))
def test_whatever_lines_both_eyes_have_they_stay_finite_and_in_the_image(images, seed):
    rng = np.random.default_rng(seed)
    pair = []
    for _ in range(2):
        lengths = rng.integers(1, 120, rng.integers(1, 6))
        walks = [rng.uniform(0, 350, 2) + np.cumsum(rng.normal(0, 1.0, (count, 2)), axis=0) for count in lengths]
        point = np.clip(np.concatenate(walks), 10, [470, 350])
        n = len(point)
        pair.append(
            Centrelines(point, np.repeat(np.arange(len(lengths)), lengths), rng.uniform(0.1, 60, n), np.full(n, 0.1))
        )
    for lines in (tuple(pair), (pair[0], moved(pair[0], 5.0))):
        for line, before in zip(drawn_together(images, lines), lines, strict=True):
            assert np.isfinite(line.point_px).all()
            assert np.abs(line.point_px - before.point_px).max() < 0.3


def test_profiles_are_seen_at_no_more_than_every_eighth_point_of_the_left_line(images, monkeypatch):
    seen = []
    real = apart.shown_in_both

    def counted(images, lines, places):
        seen.append(len(places.left_at))
        return real(images, lines, places)

    monkeypatch.setattr(apart, "shown_in_both", counted)
    left = wave(240.0)
    drawn_together(images, (left, moved(left, 40.0)))
    assert len(seen) == 1
    assert 0 < seen[0] <= len(left.piece) / 8 + 2
