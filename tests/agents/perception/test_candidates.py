"""Threads drawn by hand over red ground, with grey instruments: what is one thread, and what hides it."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.perception.candidates import candidates_followed, candidates_in
from agents.perception.centrelines import thread_centrelines
from schemas.messages import Centrelines, Occluder

WIDTH, HEIGHT = 640, 360
GROUND, STEEL, BLACK, GREEN, WHITE = (70, 80, 160), (110, 112, 115), (35, 30, 40), (60, 110, 50), (205, 210, 215)
DISPARITY = 40
ACROSS = np.array((DISPARITY, 0))
RISING, FALLING = ((80, 300), (560, 60)), ((90, 70), (570, 290))
LEVEL = ((60, 180), (580, 190))


def drawn(threads, tools=(), shift=0):
    """An image with threads (their ends, colour and width) under tools (corners), and what is seen of the threads."""
    rng = np.random.default_rng(1)
    image = np.full((HEIGHT, WIDTH, 3), GROUND, np.uint8)
    coverage = np.zeros((HEIGHT, WIDTH), np.uint8)
    for (start, end), colour, width in threads:
        first, last = ((u - shift, v) for u, v in (start, end))
        cv2.line(image, first, last, colour, width, cv2.LINE_AA)
        cv2.line(coverage, first, last, 255, width, cv2.LINE_AA)
    for corners in tools:
        inside = [np.array(corners) - np.array((shift, 0))]
        cv2.fillPoly(image, inside, STEEL)
        cv2.fillPoly(coverage, inside, 0)
    noisy = np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)
    return noisy, coverage


def seen(threads, tools=()):
    left, right = drawn(threads, tools), drawn(threads, tools, DISPARITY)
    lines = thread_centrelines(*left), thread_centrelines(*right)
    return (left[0], right[0]), lines, told(left[0])


def told(image):
    """A map of what is drawn in the colour of steel: what a network would say of it is asked elsewhere."""
    steel = (np.abs(image.astype(int) - STEEL).max(axis=2) < 20).astype(np.uint8)
    closed = cv2.morphologyEx(steel, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    small = cv2.resize(255 * closed, (240, 135), interpolation=cv2.INTER_AREA) > 127
    return small.astype(np.uint8) * np.uint8(Occluder.TOOL.value)


def lies_on(points, line, within=3.0):
    (u0, v0), (u1, v1) = line
    along = np.array((u1 - u0, v1 - v0)) / np.hypot(u1 - u0, v1 - v0)
    away = (points - (u0, v0)) @ (-along[1], along[0])
    return bool((np.abs(away) < within).all())


@pytest.mark.parametrize("other", [WHITE, BLACK], ids=["lighter", "the same colour"])
def test_threads_that_cross_are_two_and_only_the_one_that_is_meant_is_left(other):
    images, lines, occluders = seen(((RISING, BLACK, 5), (FALLING, other, 5)))
    for line, elsewhere in ((RISING, FALLING), (FALLING, RISING)):
        meant = np.array(line[0], float)[None]
        found = candidates_in(images, lines, meant, occluders=occluders)
        assert len(found.listed) == 2
        assert lies_on(found.listed[0].left_px, line)
        assert lies_on(found.listed[1].left_px, elsewhere)
        assert lies_on(found.left.point_px, line)
        assert lies_on(found.right.point_px + ACROSS, line)
        assert lies_on(found.listed[1].right_px + ACROSS, elsewhere)


def test_a_thread_behind_a_tool_is_one_and_of_one_colour_so_is_what_may_go_on_there():
    tool = ((300, 0), (360, 0), (360, 260), (300, 260))
    images, lines, occluders = seen(((LEVEL, BLACK, 5),), (tool,))
    found = candidates_in(images, lines, occluders=occluders)
    assert set(np.unique(occluders)) == {0, Occluder.TOOL.value}
    assert len(found.left.piece) == len(lines[0].piece)
    assert lies_on(found.left.point_px, LEVEL)


def test_a_stretch_that_light_has_bleached_is_the_thread_that_it_leads_on():
    halves = (((60, 180), (300, 180)), BLACK, 5), (((308, 180), (580, 180)), WHITE, 5)
    images, lines, occluders = seen(halves)
    found = candidates_in(images, lines, occluders=occluders)
    assert len(found.left.point_px) == len(lines[0].point_px)
    assert len(found.right.point_px) == len(lines[1].point_px)
    aside = (halves[0], (((308, 260), (580, 260)), WHITE, 5))
    images, lines, occluders = seen(aside)
    found = candidates_in(images, lines, np.array(((60.0, 180.0),)), occluders=occluders)
    assert lies_on(found.left.point_px, ((60, 180), (300, 180)))


def test_a_longer_thread_scores_higher_and_one_that_a_single_eye_sees_not_at_all():
    short = ((100, 320), (220, 330))
    images, lines, _ = seen(((LEVEL, BLACK, 5), (short, GREEN, 5)))
    long_one, short_one = candidates_in(images, lines).listed
    assert 0.5 < long_one.score <= 1
    assert 0 < short_one.score < long_one.score
    alone = Centrelines(np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    assert [c.score for c in candidates_in(images, (lines[0], alone)).listed] == [0, 0]
    unsure = np.full((HEIGHT // 4, WIDTH // 4), 102, np.uint8)
    assert candidates_in(images, lines, segmenter_score=unsure).listed[0].score == pytest.approx(0.4 * long_one.score)


def test_a_line_that_the_right_eye_alone_sees_is_left_out_where_it_looks_like_no_thread_of_the_left_one():
    own, elsewhere = (LEVEL, BLACK, 5), ((80, 250), (560, 330))
    left = drawn((own,))
    for other, is_left in ((WHITE, False), (BLACK, True)):
        right = drawn((own, (elsewhere, other, 5)), shift=DISPARITY)
        lines = thread_centrelines(*left), thread_centrelines(*right)
        found = candidates_in((left[0], right[0]), lines, occluders=told(left[0]))
        assert lies_on(found.left.point_px, LEVEL)
        assert lies_on(found.right.point_px + ACROSS, LEVEL) is not is_left


def test_candidates_are_followed_where_they_go():
    threads = ((RISING, BLACK, 5), (FALLING, GREEN, 5))
    images, lines, occluders = seen(threads)
    before = candidates_in(images, lines, np.array(FALLING[1], float)[None], occluders=occluders).listed
    moved = tuple((tuple((u + 6, v - 5) for u, v in line), *rest) for line, *rest in threads)
    _, lines, occluders = seen(moved)
    now = candidates_followed(before, lines, occluders, WIDTH)
    assert [c.score for c in now.listed] == [c.score for c in before]
    assert lies_on(now.listed[0].left_px, moved[1][0])
    assert lies_on(now.left.point_px, moved[1][0])
    assert lies_on(now.right.point_px + ACROSS, moved[1][0])
    alone = candidates_followed(now.listed, (now.left, now.right), occluders, WIDTH)
    assert [c.left_px.tolist() for c in alone.listed[1:]] == [c.left_px.tolist() for c in now.listed[1:]]


@given(st.integers(0, 3), st.integers(0, 5), st.integers(0, 9))
def test_no_centrelines_are_too_odd_to_be_told_apart(pieces, points, seed):
    rng = np.random.default_rng(seed)
    n = pieces * points
    line = Centrelines(rng.uniform(-9, 70, (n, 2)), np.repeat(np.arange(pieces), points), np.full(n, 2.0), np.ones(n))
    image = np.zeros((48, 64, 3), np.uint8)
    found = candidates_in((image, image), (line, line), np.array([[5.0, 5.0]]))
    assert len(found.left.piece) <= n
    candidates_followed(found.listed, (line, line), None, 64)
