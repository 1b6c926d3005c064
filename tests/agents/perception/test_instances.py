"""Threads drawn by hand over red ground, with grey instruments: what is one thread, what hides it, and which is meant.

The network has learned no flat polygons, so that steel is told by its colour.
"""

import functools
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.perception import instances as module
from agents.perception.candidates import candidates_followed, candidates_in
from agents.perception.centrelines import thread_centrelines
from agents.perception.instances import told_apart
from agents.perception.observe import observe
from agents.perception.segmenter_names import GIVEN_MASKS, NETWORK
from schemas.messages import Centrelines, FrameStamp, Occluder, RectifiedStereo, Status
from shared.images import decode_image

WIDTH, HEIGHT, DISPARITY = 640, 360, 40
CAMERA = RectifiedStereo(WIDTH, HEIGHT, 600.0, 600.0, 319.5, 179.5, 5e-3, 1.0)
ACROSS = np.array((DISPARITY, 0))
GROUND, STEEL, BLACK, GREEN, WHITE = (70, 80, 160), (110, 112, 115), (35, 30, 40), (60, 110, 50), (205, 210, 215)
RISING, FALLING = ((80, 300), (560, 60)), ((90, 70), (570, 290))
LONG, SHORT = ((60, 180), (580, 190)), ((150, 320), (420, 250))


def drawn(threads, tools=(), shift=0):
    """An image with threads (their ends and colour) under tools (corners), and what is seen of the threads."""
    image = np.full((HEIGHT, WIDTH, 3), GROUND, np.uint8)
    coverage = np.zeros((HEIGHT, WIDTH), np.uint8)
    for ends, colour in threads:
        first, last = ((u - shift, v) for u, v in ends)
        cv2.line(image, first, last, colour, 5, cv2.LINE_AA)
        cv2.line(coverage, first, last, 255, 5, cv2.LINE_AA)
    for corners in tools:
        inside = [np.array(corners) - np.array((shift, 0))]
        cv2.fillPoly(image, inside, STEEL)
        cv2.fillPoly(coverage, inside, 0)
    noisy = np.clip(image + np.random.default_rng(1).normal(0, 3, image.shape), 0, 255).astype(np.uint8)
    return noisy, coverage


def steel_in(image):
    steel = (np.abs(image.astype(int) - STEEL).max(axis=2) < 20).astype(np.uint8)
    closed = cv2.morphologyEx(steel, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    small = cv2.resize(255 * closed, (240, 135), interpolation=cv2.INTER_AREA) > 127
    return small.astype(np.uint8) * np.uint8(Occluder.TOOL.value)


def seen(left, right=None, tools=()):
    """Both images of threads, the lines in them, and a map of the steel."""
    eyes = drawn(left, tools), drawn(right or left, tools, DISPARITY)
    lines = thread_centrelines(*eyes[0]), thread_centrelines(*eyes[1])
    return (eyes[0][0], eyes[1][0]), lines, steel_in(eyes[0][0])


def lies_on(points, line):
    (u0, v0), (u1, v1) = line
    along = np.array((u1 - u0, v1 - v0)) / np.hypot(u1 - u0, v1 - v0)
    return bool((np.abs((points - (u0, v0)) @ (-along[1], along[0])) < 3).all())


@pytest.mark.parametrize("other", [WHITE, BLACK], ids=["lighter", "the same colour"])
def test_threads_that_cross_are_two_and_only_the_one_that_is_meant_is_left(other):
    images, lines, steel = seen(((RISING, BLACK), (FALLING, other)))
    for line, elsewhere in ((RISING, FALLING), (FALLING, RISING)):
        found = candidates_in(images, lines, np.array(line[0], float)[None], occluders=steel)
        assert len(found.listed) == 2
        assert lies_on(found.listed[0].left_px, line)
        assert lies_on(found.listed[1].left_px, elsewhere)
        assert lies_on(found.left.point_px, line)
        assert lies_on(found.right.point_px + ACROSS, line)
        assert lies_on(found.listed[1].right_px + ACROSS, elsewhere)


def test_a_thread_behind_a_tool_is_one_and_of_one_colour_so_is_what_may_go_on_there():
    images, lines, steel = seen(((LONG, BLACK),), tools=(((300, 0), (360, 0), (360, 260), (300, 260)),))
    found = candidates_in(images, lines, occluders=steel)
    assert steel.any()
    assert len(found.left.piece) == len(lines[0].piece)
    assert lies_on(found.left.point_px, LONG)


def test_a_longer_thread_scores_higher_and_one_that_a_single_eye_sees_not_at_all():
    images, lines, _ = seen(((LONG, BLACK), (((100, 320), (220, 330)), GREEN)))
    long_one, short_one = candidates_in(images, lines).listed
    assert 0.5 < long_one.score <= 1
    assert 0 < short_one.score < long_one.score
    alone = Centrelines(np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    assert [c.score for c in candidates_in(images, (lines[0], alone)).listed] == [0, 0]
    unsure = np.full((HEIGHT // 4, WIDTH // 4), 102, np.uint8)
    assert candidates_in(images, lines, segmenter_score=unsure).listed[0].score == pytest.approx(0.4 * long_one.score)


@pytest.mark.parametrize(("colour", "is_left"), [(WHITE, False), (BLACK, True)])
def test_a_line_that_the_right_eye_alone_sees_is_left_out_where_it_looks_like_no_thread_of_the_left_one(
    colour, is_left
):
    own = (LONG, BLACK)
    images, lines, steel = seen((own,), (own, (((80, 250), (560, 330)), colour)))
    found = candidates_in(images, lines, occluders=steel)
    assert lies_on(found.left.point_px, LONG)
    assert lies_on(found.right.point_px + ACROSS, LONG) is not is_left


def test_candidates_are_followed_where_they_go():
    images, lines, steel = seen(((RISING, BLACK), (FALLING, GREEN)))
    before = candidates_in(images, lines, np.array(FALLING[1], float)[None], occluders=steel).listed
    there = [tuple((u + 6, v - 5) for u, v in line) for line in (RISING, FALLING)]
    _, lines, steel = seen(tuple(zip(there, (BLACK, GREEN), strict=True)))
    now = candidates_followed(before, lines, steel, WIDTH)
    assert [c.score for c in now.listed] == [c.score for c in before]
    assert lies_on(now.listed[0].left_px, there[1])
    assert lies_on(now.left.point_px, there[1])
    assert lies_on(now.right.point_px + ACROSS, there[1])
    alone = candidates_followed(now.listed, (now.left, now.right), steel, WIDTH)
    assert [c.left_px.tolist() for c in alone.listed[1:]] == [c.left_px.tolist() for c in now.listed[1:]]


def test_a_thread_that_looks_like_the_one_that_is_meant_is_measured_beside_it_and_followed_where_it_goes():
    images, lines, steel = seen(((LONG, BLACK), (SHORT, BLACK), (((80, 40), (400, 60)), GREEN)))
    whole = candidates_in(images, lines, occluders=steel)
    ((left, right),) = whole.strands
    assert lies_on(whole.left.point_px, LONG)
    assert lies_on(left.point_px, SHORT)
    assert lies_on(right.point_px + ACROSS, SHORT)
    there = [tuple((u + 6, v - 5) for u, v in line) for line in (LONG, SHORT)]
    _, lines, steel = seen(tuple((line, BLACK) for line in there))
    black = tuple(one for one in whole.listed if not lies_on(one.left_px, ((80, 40), (400, 60))))
    ((left, right),) = candidates_followed(black, lines, steel, WIDTH).strands
    assert lies_on(left.point_px, there[1])
    assert lies_on(right.point_px + ACROSS, there[1])


@given(st.integers(0, 3), st.integers(0, 5), st.integers(0, 9))
def test_no_centrelines_are_too_odd_to_be_told_apart(pieces, points, seed):
    rng = np.random.default_rng(seed)
    n = pieces * points
    line = Centrelines(rng.uniform(-9, 70, (n, 2)), np.repeat(np.arange(pieces), points), np.full(n, 2.0), np.ones(n))
    image = np.zeros((48, 64, 3), np.uint8)
    found = candidates_in((image, image), (line, line), np.array([[5.0, 5.0]]))
    assert len(found.left.piece) <= n
    candidates_followed(found.listed, (line, line), None, 64)


@functools.cache
def pair(tools=(), right=None) -> Any:
    threads = (LONG, BLACK), (SHORT, GREEN)
    return drawn(threads if right is None else threads[:1], tools), drawn(right or threads, tools, DISPARITY)


def observed(sequence=0, tools=(), right=None, segmenter=NETWORK, **changes):
    """What is observed where the whole is looked at; `right`: what the right eye sees in place of the left's."""
    (left, of_left), (right, of_right) = pair(tools, right)
    stamp = FrameStamp(sequence, 1, 1, "")
    found = observe(stamp, CAMERA, left, right, of_left, of_right, segmenter, (), matching=False)
    return replace(found, **{"looked_sequence": sequence} | changes)


def told(of, last=None, tools=(), right=None, score=None, occluders_due=False) -> Any:
    images = tuple(image for image, _ in pair(tools, right))
    return told_apart(of, images, last, score, occluders_due)


@pytest.fixture
def steel_by_colour(monkeypatch):
    monkeypatch.setattr(module, "occluders_in", steel_in)


@pytest.mark.usefixtures("steel_by_colour")
def test_the_longer_thread_is_meant_unless_a_prompt_or_the_frame_before_says_otherwise():
    first = told(observed())
    assert [lies_on(c.left_px, line) for c, line in zip(first.candidates, (LONG, SHORT), strict=True)] == [True, True]
    pointed = told(observed(prompt_px=np.array([300.0, 282.0])))
    assert lies_on(pointed.candidates[0].left_px, SHORT)
    assert lies_on(pointed.centrelines_left.point_px, SHORT)
    assert lies_on(told(observed(1), last=pointed).candidates[0].left_px, SHORT)
    assert lies_on(told(observed(1, prompt_px=np.array([300.0, 184.0])), last=pointed).candidates[0].left_px, LONG)


@pytest.mark.usefixtures("steel_by_colour")
def test_between_looks_at_the_whole_instruments_are_looked_for_anew_when_that_is_due():
    tools = (((0, 20), (220, 40), (220, 110), (0, 120)),)
    before = told(observed(tools=tools), tools=tools)
    assert decode_image(before.occluders.left).any()
    for is_due in (False, True):
        now = told(observed(14, looked_sequence=0), last=before, occluders_due=is_due)
        assert now.occluders.sequence == (14 if is_due else 0)
        assert decode_image(now.occluders.left).any() == (not is_due)


@pytest.mark.parametrize(
    ("segmenter", "pointed_at", "looked_sequence", "is_thread"),
    [(NETWORK, False, 0, False), (NETWORK, True, 0, True), (GIVEN_MASKS, False, 0, True), (NETWORK, False, -5, True)],
)
def test_what_each_eye_shows_in_other_rows_is_no_thread_unless_a_person_says_so_or_it_is_followed(
    segmenter, pointed_at, looked_sequence, is_thread
):
    right = ((SHORT, GREEN),)
    prompt_px = np.array([300.0, 184.0]) if pointed_at else None
    seen = observed(right=right, segmenter=segmenter, prompt_px=prompt_px, looked_sequence=looked_sequence)
    found = told(replace(seen, trail_left=None, trail_right=None), right=right)
    assert (found.status is Status.OK) is is_thread
    assert ("in one image alone" in found.reason) is not is_thread
    # what looks like it stays to be looked at
    assert len(found.centrelines_left.piece)
