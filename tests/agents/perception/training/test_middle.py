"""What the middle is learned from, and what was learned: drawn threads in light from any side."""

from dataclasses import replace

import numpy as np
import pytest

from agents.perception.centrelines.learned import learned_middles
from agents.perception.training.middle_crops import LENGTH, STRETCHES, VIEWS, batches, profiles_of
from agents.perception.training.middle_drawn import drawn_view
from agents.perception.training.middle_evaluate import apart_px
from agents.perception.training.middle_views import Truth, offsets_to


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(81)
    return [drawn_view(rng) for _ in range(8)]


def learned(view):
    shown, some, pieces = profiles_of(view)
    return learned_middles(shown, view.normal[some], pieces), some


@pytest.mark.slow
def test_the_middle_is_learned_in_light_from_any_side_and_as_well_as_is_said(drawn):
    error, deviation = [], []
    for view in drawn:
        found, some = learned(view)
        error.append(np.abs(found.offset_px - view.offset_px[some]))
        deviation.append(found.deviation_px)
    error, deviation = np.concatenate(error), np.concatenate(deviation)
    assert np.median(error) < 0.13
    assert 0.5 < np.mean(error < deviation) < 0.9


def test_every_second_point_is_told_what_it_is_told_among_all(drawn):
    shown, some, pieces = profiles_of(drawn[0])
    normal = drawn[0].normal[some]
    half, thinned = pieces.every_second
    every, apart = (learned_middles(shown, normal, pieces, every_second=each) for each in (False, True))
    # to an end that is no second point, neighbours have another way
    alike = (pieces.before[half] % 2 == 0) & (thinned.after > 16)
    assert len(apart.offset_px) == len(half)
    assert alike.sum() > 50
    np.testing.assert_allclose(apart.offset_px[alike], every.offset_px[half][alike], atol=1e-4)
    np.testing.assert_allclose(apart.deviation_px[alike], every.deviation_px[half][alike], rtol=1e-3)


def test_batches_follow_from_their_seed(drawn):
    one, other = (next(batches(drawn, seed=5)) for _ in range(2))
    for part, same in zip(one, other, strict=True):
        np.testing.assert_array_equal(part, same)
    assert one[0].shape[:3] == (VIEWS, STRETCHES, LENGTH // 2)


def test_what_both_eyes_err_alike_is_no_depth_whichever_way_their_points_run(drawn):
    view, place = drawn[0], 0.1 * np.arange(len(drawn[0].width_px), dtype=np.float32)
    left = replace(view, name="scene_left", along_mm=place)
    # the right eye's is followed from its other end
    right = replace(view, name="scene_right", along_mm=place[::-1], normal=-view.normal[::-1])
    aside = 0.2 * left.normal[:, 0], 0.2 * right.normal[:, 0]
    assert apart_px(left, right, aside) == pytest.approx(0, abs=1e-6)
    of_one = apart_px(left, right, (aside[0], 0 * aside[1]))
    assert of_one is not None
    assert of_one > 0.05


def test_offsets_lead_from_points_to_the_truth_whichever_way_either_runs():
    x = np.arange(0, 50, 0.1)
    truth = Truth(np.column_stack((x, 0 * x + 3)), np.tile([-1.0, 0.0], (len(x), 1)), x < 40, 0.1 * x)
    point, tangent = np.array([[10.0, 2.5], [20.0, 3.2], [45.0, 3.0]]), np.tile([1.0, 0.0], (3, 1))
    offset, known, along_mm = offsets_to(truth, point, tangent)
    np.testing.assert_allclose(offset, [0.5, -0.2, 0.0], atol=1e-9)
    assert known.tolist() == [True, True, False]
    np.testing.assert_allclose(along_mm, [1.0, 2.0, 4.5], atol=1e-9)
