"""Both eyes at the same places: what they err apart, in mirrors too, and how much of it is told."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.perception.both_eyes.shown import LEFT, RIGHT, Eye, together
from agents.perception.centrelines.along import Pieces
from agents.perception.training.middle_pairs import (
    INNER,
    WIDE_PLACES,
    PairProfiles,
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


def test_a_rendered_pair_is_the_same_where_its_truth_says_so_and_its_middles_err_apart(rendered, tmp_path):
    (pair,) = pair_profiles([rendered])
    assert pair.name == NAME
    assert pair.known.mean() > 0.95
    # both eyes err by about a tenth of a pixel
    assert 0.05 < np.sqrt(np.mean(pair.apart_px[pair.known] ** 2)) < 0.25
    # and see nearly the same
    seen = together(*(replace(eye, colour=eye.colour[INNER]) for eye in pair.eyes)).seen
    assert np.median(np.abs(seen[LEFT] - seen[RIGHT])) < 0.2
    with pytest.raises(SceneFolderError, match="render scenes into it"):
        pair_profiles([tmp_path])
    # one eye alone is no pair
    for file in rendered.glob("*"):
        if "right" not in file.name:
            (tmp_path / file.name).symlink_to(file.resolve())
    assert pair_profiles([tmp_path]) == []


def test_what_is_told_counts_by_its_variance_where_the_truth_is_known_and_the_thread_crosses_the_rows(pair):
    n = len(pair.known)
    upright = np.tile([1.0, 0.0], (n, 1))
    left, right = (replace(eye, normal=upright) for eye in pair.eyes)
    pair = replace(pair, eyes=(left, right), apart_px=np.full(n, 0.2, np.float32))
    share, before, after = explained([pair], [0.5 * pair.apart_px])
    assert share == pytest.approx(0.75)
    assert after == pytest.approx(before / 2)
    known = np.arange(n) % 3 > 0
    assert explained([replace(pair, known=known)], [np.where(known, 0.2, 9.0)])[0] == pytest.approx(1)
    along = np.arange(n) < n // 2
    left, right = (replace(eye, normal=np.where(along[:, None], [0.0, 1.0], upright)) for eye in pair.eyes)
    # a window of places about the boundary holds both kinds
    inside = np.abs(np.arange(n) - n // 2) > 10
    told = np.where(along & inside, 9.0, 0.2)
    assert explained([replace(pair, eyes=(left, right))], [told])[0] == pytest.approx(1)


def test_eyes_that_change_places_in_a_mirror_beside_the_scene_err_the_other_way_and_below_it_alike(pair):
    left, right = (replace(eye, normal=eye.normal * [-1, 1]) for eye in pair.eyes)
    exchanged = replace(pair, eyes=(right, left), apart_px=-pair.apart_px)
    for part, same in zip(features(pair, exchanged=True), features(exchanged), strict=True):
        np.testing.assert_allclose(part, same, atol=1e-5)
    (shown, apart), (other, mirrored) = features(pair), features(pair, below=True)
    np.testing.assert_array_equal(apart, mirrored)
    assert np.abs(shown - other).max(axis=0).nonzero()[0].size == 2
