"""Both eyes at the same places: what they err apart, in mirrors too, and how much of it is told."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.perception.both_eyes.shown import LEFT, RIGHT, Shown
from agents.perception.centrelines.along import Pieces
from agents.perception.training.middle_pairs import PairProfiles, explained, features, pair_profiles
from agents.perception.training.scenes import SceneFolderError

RENDERS = Path(__file__).parents[4] / "../shared/data/renders"
NAME = "cfg_easy_paper"


@pytest.fixture
def pair():
    rng = np.random.default_rng(83)
    n = 120
    normal = rng.normal(0, 1, (2, n, 2))
    shown = Shown(
        rng.normal(0, 1, (2, n, 33, 3)).astype(np.float32),
        rng.normal(-2, 0.3, (2, n)).astype(np.float32),
        (normal / np.linalg.norm(normal, axis=2, keepdims=True)).astype(np.float32),
        rng.uniform(4, 7, n).astype(np.float32),
    )
    apart = rng.normal(0, 0.1, n).astype(np.float32)
    return PairProfiles("scene", shown, apart, np.ones(n, bool), Pieces(np.zeros(n, np.int64)))


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
    assert np.median(np.abs(pair.shown.seen[LEFT] - pair.shown.seen[RIGHT])) < 0.2


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
    turned = replace(pair.shown, seen=pair.shown.seen[:, :, ::-1], normal=-pair.shown.normal)
    again = replace(pair, shown=turned, apart_px=-pair.apart_px)
    np.testing.assert_array_equal(features(again)[0], other)
    np.testing.assert_array_equal(features(again, mirrored=True)[0], shown)


def test_eyes_that_change_places_in_a_mirror_beside_the_scene_err_the_other_way(pair):
    shown = replace(
        pair.shown,
        seen=pair.shown.seen[::-1],
        log_deviation=pair.shown.log_deviation[::-1],
        normal=pair.shown.normal[::-1] * np.array([-1, 1], np.float32),
    )
    exchanged = replace(pair, shown=shown, apart_px=-pair.apart_px)
    for part, same in zip(features(pair, exchanged=True), features(exchanged), strict=True):
        np.testing.assert_array_equal(part, same)


def test_in_a_mirror_below_the_scene_the_same_is_said(pair):
    (shown, apart), (other, mirrored) = features(pair), features(pair, below=True)
    np.testing.assert_array_equal(apart, mirrored)
    assert np.abs(shown - other).max(axis=0).nonzero()[0].size == 2


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
    normal = np.where(along[:, None], [0, 1], [1, 0]).astype(np.float32)
    shown = replace(pair.shown, normal=np.stack((normal, normal)))
    pair = replace(pair, shown=shown, apart_px=np.full_like(pair.apart_px, 0.2))
    told = np.where(along, 9.0, 0.2)
    # a window of places about the boundary holds both kinds
    inside = np.abs(np.arange(len(along)) - len(along) // 2) > 10
    assert explained([pair], [np.where(inside, told, 0.2)])[0] == pytest.approx(1)
