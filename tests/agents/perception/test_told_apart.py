"""What is told of threads and of what may hide them, from observations, and from one frame to the next."""

import functools
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from agents.perception import told_apart as module
from agents.perception.observe import observe
from agents.perception.segmenter_names import GIVEN_MASKS, NETWORK
from agents.perception.told_apart import SCORE_WIDTH_PX, told_apart
from schemas.messages import FrameStamp, RectifiedStereo, Status
from shared.images import decode_image
from tests.agents.perception.test_candidates import BLACK, DISPARITY, GREEN, HEIGHT, WIDTH, drawn, lies_on
from tests.agents.perception.test_candidates import told as steel_in

CAMERA = RectifiedStereo(WIDTH, HEIGHT, 600.0, 600.0, 319.5, 179.5, 5e-3, 1.0)
LONG, SHORT = ((60, 180), (580, 190)), ((150, 320), (420, 250))
TOOL = ((0, 20), (220, 40), (220, 110), (0, 120))


@pytest.fixture(autouse=True)
def steel_is_told_by_its_colour(monkeypatch):
    """The network has learned no flat polygons."""
    monkeypatch.setattr(module, "occluders_in", steel_in)


@functools.cache
def pair(tools=()) -> Any:
    eyes = [drawn(((LONG, BLACK, 5), (SHORT, GREEN, 5)), tools, shift) for shift in (0, DISPARITY)]
    return tuple(image for image, _ in eyes), tuple(coverage for _, coverage in eyes)


def observed(sequence=0, tools=(), **changes):
    """What is observed where the whole is looked at."""
    (left, right), coverage = pair(tools)
    stamp = FrameStamp(sequence, 1, 1, "")
    found = observe(stamp, CAMERA, left, right, coverage[0], coverage[1], "network", (), matching=False)
    return replace(found, looked_sequence=sequence, **changes)


def told(of, last=None, tools=(), score=None, occluders_due=False) -> Any:
    return told_apart(of, pair(tools)[0], last, score, occluders_due)


def kinds(found, side="left"):
    return decode_image(getattr(found.occluders, side))


def test_the_longer_thread_is_meant_unless_a_prompt_or_the_frame_before_says_otherwise():
    first = told(observed())
    assert [lies_on(c.left_px, line) for c, line in zip(first.candidates, (LONG, SHORT), strict=True)] == [True, True]
    pointed = told(observed(prompt_px=np.array([300.0, 282.0])))
    assert lies_on(pointed.candidates[0].left_px, SHORT)
    assert lies_on(pointed.centrelines_left.point_px, SHORT)
    assert lies_on(told(observed(1), last=pointed).candidates[0].left_px, SHORT)
    assert lies_on(told(observed(1, prompt_px=np.array([300.0, 184.0])), last=pointed).candidates[0].left_px, LONG)


def test_the_score_travels_as_a_small_map_in_which_a_thin_line_keeps_its_own():
    score = np.zeros((2 * HEIGHT, 2 * WIDTH), np.uint8)
    cv2.line(score, (100, 100), (1100, 500), 240, 1)
    found = told(observed(), score=score).score_map
    assert (found.width, found.height) == (SCORE_WIDTH_PX, 135)
    small = decode_image(found)
    share = SCORE_WIDTH_PX / (2 * WIDTH)
    along = [small[round((100 + 0.4 * u) * share), round((100 + u) * share)] for u in range(50, 950, 50)]
    assert np.median(along) > 100
    assert told(observed()).score_map is None


def test_between_looks_at_the_whole_instruments_are_looked_for_anew_when_that_is_due():
    before = told(observed(tools=(TOOL,)), tools=(TOOL,))
    assert kinds(before).any()
    for is_due in (False, True):
        now = told(replace(observed(14), looked_sequence=0), last=before, occluders_due=is_due)
        assert now.occluders.sequence == (14 if is_due else 0)
        assert kinds(now).any() == (not is_due)


@pytest.mark.parametrize(
    ("segmenter", "pointed_at", "is_thread"),
    [(NETWORK, False, False), (NETWORK, True, True), (GIVEN_MASKS, False, True)],
)
def test_what_each_eye_shows_in_other_rows_is_no_thread_unless_a_person_says_so(segmenter, pointed_at, is_thread):
    left, right = drawn(((LONG, BLACK, 5),), (), 0), drawn(((SHORT, GREEN, 5),), (), DISPARITY)
    images, coverage = (left[0], right[0]), (left[1], right[1])
    seen = observe(FrameStamp(0, 1, 1, ""), CAMERA, *images, *coverage, segmenter, (), matching=False)
    seen = replace(seen, prompt_px=np.array([300.0, 184.0]) if pointed_at else None)
    found = told_apart(seen, images, None)
    assert (found.status is Status.OK) is is_thread
    assert ("in one image alone" in found.reason) is not is_thread
    # what looks like it stays to be looked at
    assert len(found.centrelines_left.piece)


def test_what_is_followed_is_not_asked_for_its_counterpart_before_the_next_look_at_the_whole():
    before = observed(3)
    lines = before.centrelines_left, replace(before.centrelines_right, point_px=before.centrelines_right.point_px / 4)
    for looked, status in ((5, Status.FAILED), (3, Status.OK)):
        asked = replace(
            before,
            stamp=FrameStamp(5, 1, 1, ""),
            looked_sequence=looked,
            centrelines_left=lines[0],
            centrelines_right=lines[1],
            trail_left=None,
            trail_right=None,
        )
        assert told(asked, last=before).status is status
