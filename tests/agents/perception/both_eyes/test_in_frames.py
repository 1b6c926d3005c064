"""Both eyes are drawn together in frames that are looked at and in followed ones alike, but never by given masks."""

import functools

import numpy as np
import pytest

from agents.perception.both_eyes import apart
from agents.perception.both_eyes.same_places import between, same_places
from agents.perception.following.pair import follow_pair
from agents.perception.observe import observe
from agents.perception.segmentation.network import segment_network
from agents.perception.segmenter_names import GIVEN_MASKS, NETWORK, THRESHOLD
from agents.perception.told_apart import as_sent
from schemas.messages import FrameStamp
from shared.disparities import disparities_of
from shared.scene.__main__ import make_scene
from shared.scene.render import render

APART_PX = 0.6


@functools.cache
def scene():
    made = make_scene("medium", "tissue", 32)
    return made.camera, render(made)


def looked_at(segmenter):
    camera, pair = scene()
    left, right = pair.left_bgr, pair.right_bgr
    stamp = FrameStamp(3, 10, 11, "made up")
    return observe(stamp, camera, left, right, segment_network(left), segment_network(right), segmenter, matching=False)


def followed(observed):
    camera, pair = scene()
    found = follow_pair(FrameStamp(4, 12, 13, "made up"), camera, (pair.left_bgr, pair.right_bgr), as_sent(observed))
    assert found is not None
    return found.observed


def disparity_px(observed):
    """Row by row of the places that both eyes show, where the thread runs across the rows."""
    left, right = observed.centrelines_left, observed.centrelines_right
    places = same_places(left, right, disparities_of(observed))
    assert places is not None
    steep = np.abs(places.left_normal[:, 0]) > 0.8
    at = left.point_px[places.left_at][steep]
    return at, at[:, 0] - between(right.point_px, places.right_at)[steep, 0]


def by_how_much(one, other):
    """What the first's disparity is more than the second's, at the same places, in general."""
    (at, disparity), (there, before) = disparity_px(one), disparity_px(other)
    away = np.linalg.norm(at[:, None] - there, axis=2)
    near = away.min(axis=1) < 4
    assert near.sum() > 15
    return np.median(disparity[near] - before[away.argmin(axis=1)][near])


@pytest.fixture
def always_apart(monkeypatch):
    """In place of what is learned: both eyes err apart by so much along the row, wherever they are seen."""

    def said(shown, stretches, weights=None):
        del stretches, weights
        return APART_PX * shown.normal[0, :, 0].astype(float)

    monkeypatch.setattr(apart, "apart_px", said)


@pytest.mark.slow
@pytest.mark.usefixtures("always_apart")
def test_a_frame_that_is_looked_at_and_one_that_is_followed_are_drawn_alike():
    masks_given = looked_at(GIVEN_MASKS)
    looked = looked_at(NETWORK)
    assert by_how_much(looked, masks_given) == pytest.approx(0.8 * APART_PX, abs=0.15)
    once = followed(looked)
    twice = followed(once)
    # nothing adds up from frame to frame, and nothing leaps
    assert by_how_much(once, looked) == pytest.approx(0, abs=0.05)
    assert by_how_much(twice, once) == pytest.approx(0, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("segmenter", [GIVEN_MASKS, THRESHOLD])
def test_given_masks_and_bright_grounds_are_left_as_they_are(segmenter, monkeypatch):
    monkeypatch.setattr(apart, "apart_px", lambda *_: pytest.fail("both eyes were asked"))
    assert len(looked_at(segmenter).centrelines_left.point_px)
