"""Both eyes at the same places: what they err apart, in mirrors too, and how much of it is told."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.perception.both_eyes.shown import LEFT, PLACES, RIGHT, Eye, together
from agents.perception.centrelines.along import Pieces
from agents.perception.centrelines.straightened import reach_px
from agents.perception.training.middle_pairs import (
    INNER,
    MOST_PX,
    WIDE_PLACES,
    PairProfiles,
    drawn_aside,
    explained,
    features,
    pair_profiles,
)
from agents.perception.training.scenes import SceneFolderError

RENDERS = Path(__file__).parents[4] / "../shared/data/renders"
NAME = "cfg_easy_paper"


@pytest.fixture
def pair():
    rng = np.random.default_rng(83)
    n = 120
    normals = rng.normal(0, 1, (2, n, 2))
    left, right = (
        Eye(
            rng.normal(100, 30, (len(WIDE_PLACES), n, 3)).astype(np.float32),
            rng.uniform(4, 7, n),
            rng.normal(-2, 0.3, n),
            normal / np.linalg.norm(normal, axis=1, keepdims=True),
        )
        for normal in normals
    )
    apart = rng.normal(0, 0.1, n).astype(np.float32)
    return PairProfiles("scene", (left, right), apart, np.ones(n, bool), Pieces(np.zeros(n, np.int64)))


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    if not RENDERS.is_dir() and "CI" not in os.environ:
        pytest.skip("needs shared/data beside the checkout")
    folder = tmp_path_factory.mktemp("one")
    for file in RENDERS.glob(f"{NAME}*"):
        (folder / file.name).symlink_to(file.resolve())
    return folder


def test_a_rendered_pair_is_the_same_where_its_truth_says_so_and_its_middles_err_apart(rendered):
    (pair,) = pair_profiles([rendered])
    assert pair.name == NAME
    assert pair.known.mean() > 0.95
    # both eyes err by about a tenth of a pixel
    assert 0.05 < np.sqrt(np.mean(pair.apart_px[pair.known] ** 2)) < 0.25
    # and see nearly the same
    seen = together(*(replace(eye, colour=eye.colour[INNER]) for eye in pair.eyes)).seen
    assert np.median(np.abs(seen[LEFT] - seen[RIGHT])) < 0.2


def test_a_scene_of_which_one_eye_is_missing_is_no_pair(rendered, tmp_path):
    for file in rendered.glob("*"):
        if "right" not in file.name:
            (tmp_path / file.name).symlink_to(file.resolve())
    assert pair_profiles([tmp_path]) == []


def test_a_folder_without_scenes_is_said_to_have_none(tmp_path):
    with pytest.raises(SceneFolderError, match="render scenes into it"):
        pair_profiles([tmp_path])


def test_a_mirror_turns_what_is_to_be_said_with_what_is_shown_and_twice_it_is_nothing(pair):
    shown, apart = features(pair)
    other, mirrored = features(pair, mirrored=True)
    np.testing.assert_array_equal(mirrored, -apart)
    assert not np.array_equal(shown, other)
    left, right = (replace(eye, colour=eye.colour[::-1], normal=-eye.normal) for eye in pair.eyes)
    again = replace(pair, eyes=(left, right), apart_px=-pair.apart_px)
    np.testing.assert_allclose(features(again)[0], other, atol=1e-5)
    np.testing.assert_allclose(features(again, mirrored=True)[0], shown, atol=1e-5)


def test_eyes_that_change_places_in_a_mirror_beside_the_scene_err_the_other_way(pair):
    left, right = (replace(eye, normal=eye.normal * [-1, 1]) for eye in pair.eyes)
    exchanged = replace(pair, eyes=(right, left), apart_px=-pair.apart_px)
    for part, same in zip(features(pair, exchanged=True), features(exchanged), strict=True):
        np.testing.assert_allclose(part, same, atol=1e-5)


def test_in_a_mirror_below_the_scene_the_same_is_said(pair):
    (shown, apart), (other, mirrored) = features(pair), features(pair, below=True)
    np.testing.assert_array_equal(apart, mirrored)
    assert np.abs(shown - other).max(axis=0).nonzero()[0].size == 2


def test_a_line_drawn_aside_shows_what_lies_there(pair):
    # a colour that says where it was seen, in pixels
    left = pair.eyes[LEFT]
    px = WIDE_PLACES[:, None] * reach_px(left.width_px)
    left = replace(left, colour=np.repeat(px[..., None], 3, axis=2).astype(np.float32))
    by = np.linspace(-1.5, 1.5, len(left.width_px))
    seen = drawn_aside(left, by).colour
    np.testing.assert_allclose(seen[..., 0], PLACES[:, None] * reach_px(left.width_px) + by, atol=1e-4)


def test_lines_drawn_aside_err_the_less_by_it_and_apart_by_the_difference(pair):
    aside = np.stack((np.full(len(pair.known), 0.2), np.full(len(pair.known), 0.05)))
    np.testing.assert_allclose(
        features(pair, aside_px=aside)[1], np.clip(pair.apart_px - 0.15, -MOST_PX, MOST_PX), atol=1e-6
    )
    # in a mirror it is the mirrored line that errs
    np.testing.assert_allclose(
        features(pair, exchanged=True, aside_px=aside)[1], np.clip(0.15 - pair.apart_px, -MOST_PX, MOST_PX), atol=1e-6
    )


def test_lines_that_are_drawn_nowhere_show_the_same(pair):
    shown, apart = features(pair)
    same, still = features(pair, aside_px=np.zeros((2, len(apart))))
    np.testing.assert_allclose(same, shown, atol=1e-5)
    np.testing.assert_array_equal(still, apart)


def test_half_of_an_error_told_is_three_quarters_of_its_variance(pair):
    pair = replace(pair, apart_px=np.full_like(pair.apart_px, 0.2))
    share, before, after = explained([pair], [0.5 * pair.apart_px])
    assert share == pytest.approx(0.75)
    assert after == pytest.approx(before / 2)


def test_what_is_told_where_the_truth_is_not_known_counts_for_nothing(pair):
    known = np.arange(len(pair.known)) % 3 > 0
    pair = replace(pair, apart_px=np.where(known, 0.2, 0.0).astype(np.float32), known=known)
    assert explained([pair], [np.where(known, 0.2, 9.0)])[0] == pytest.approx(1)


def test_what_is_told_where_the_thread_runs_along_the_row_counts_for_nothing(pair):
    along = np.arange(len(pair.apart_px)) < len(pair.apart_px) // 2
    normal = np.where(along[:, None], [0, 1], [1, 0]).astype(np.float64)
    left, right = (replace(eye, normal=normal) for eye in pair.eyes)
    pair = replace(pair, eyes=(left, right), apart_px=np.full_like(pair.apart_px, 0.2))
    told = np.where(along, 9.0, 0.2)
    # a window of places about the boundary holds both kinds
    inside = np.abs(np.arange(len(along)) - len(along) // 2) > 10
    assert explained([pair], [np.where(inside, told, 0.2)])[0] == pytest.approx(1)
