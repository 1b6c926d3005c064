"""Lines of instruments that segmenters take for thread: dropped upon an instrument, never anywhere else."""

import cv2
import numpy as np
import pytest

from agents.perception.centrelines.centrelines import thread_lines
from agents.perception.observe import observe
from agents.perception.reflexes import without_reflexes
from agents.perception.segmenter_names import GIVEN_MASKS
from schemas.messages import FrameStamp, RectifiedStereo

HEIGHT, WIDTH = 240, 480
TOOL_U = 300
TISSUE, STEEL, VIOLET, GREY_THREAD = (95, 105, 190), (120, 120, 120), (140, 60, 110), (95, 95, 95)
BLACK_OVER_TISSUE, BLACK_OVER_STEEL = (27, 28, 37), (30, 30, 30)
"""A tenth of what lies around a thin thread is seen in its middle."""
SHADOW, VIOLET_IN_SHADOW = (48, 52, 95), (70, 30, 55)


def scene(*strips):
    """Tissue with an instrument from TOOL_U on, and lines (colour, points) upon both."""
    image = np.full((HEIGHT, WIDTH, 3), TISSUE, np.uint8)
    image[:, TOOL_U:] = STEEL
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    for colour, points in strips:
        for drawn, value in ((image, colour), (mask, 255)):
            cv2.polylines(drawn, [np.array(points)[:, None]], False, value, 5)
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    noise = np.random.default_rng(1).normal(0, 2, image.shape)
    return (image + noise).clip(0, 255).astype(np.uint8), mask


def left_of(colours_and_lines, tool=True):
    image, mask = scene(*colours_and_lines)
    occluders = np.zeros((120, 240), np.uint8)
    if tool:
        occluders[:, TOOL_U // 2 :] = 1
    before = thread_lines(image, mask)
    return before, without_reflexes(image, before, occluders)


APART = [(30, 40), (150, 70), (270, 40)]
UPON = [(340, 40), (350, 120), (330, 200)]
ACROSS = [(30, 150), (200, 180), (430, 160)]
ALONG_THE_EDGE = [(30, 150), (200, 180), (310, 170), (316, 100), (316, 30)]
ALONG_IN_SHADOW = [(292, 230), (294, 100), (294, 20)]


@pytest.mark.parametrize("reflex", [(250, 250, 250), (125, 125, 130)])
def test_a_line_of_the_instrument_is_no_thread(reflex):
    before, found = left_of([(VIOLET, APART), (reflex, UPON)])
    assert len(np.unique(before.centrelines.piece)) == 2
    assert len(np.unique(found.centrelines.piece)) == 1
    assert found.centrelines.point_px[:, 0].max() < TOOL_U
    assert len(found.loose_start) == len(found.loose_end) == 1


@pytest.mark.parametrize("segmenter", ["network", GIVEN_MASKS])
def test_what_is_observed_has_no_line_of_an_instrument_unless_a_person_drew_it(segmenter):
    camera = RectifiedStereo(WIDTH, HEIGHT, 500.0, 500.0, 239.5, 119.5, 5e-3, 1.0)
    image, mask = scene((VIOLET, APART), ((250, 250, 250), UPON))
    right, mask_right = (np.roll(one, -20, axis=1) for one in (image, mask))
    found = observe(FrameStamp(0, 1, 1, ""), camera, image, right, mask, mask_right, segmenter, (), matching=False)
    for lines, shift in ((found.centrelines_left, 0), (found.centrelines_right, 20)):
        assert (lines.point_px[:, 0].max() + shift > TOOL_U) == (segmenter == GIVEN_MASKS)


@pytest.mark.parametrize(
    "lines",
    [
        [(VIOLET, APART), (VIOLET, UPON)],
        [(VIOLET, ACROSS)],
        [(GREY_THREAD, ACROSS)],
        [(GREY_THREAD, APART), (GREY_THREAD, UPON)],
        [(BLACK_OVER_TISSUE, APART), (BLACK_OVER_STEEL, UPON)],
        [(VIOLET, APART), (VIOLET_IN_SHADOW, ALONG_IN_SHADOW)],
    ],
    ids=["upon it", "across it", "grey across it", "grey upon it", "black upon it", "in its shadow"],
)
def test_thread_upon_an_instrument_stays(lines):
    before, found = left_of(lines)
    assert found is before


def test_thread_stays_where_nobody_knows_of_instruments():
    before, found = left_of([(VIOLET, APART), ((250, 250, 250), UPON)], tool=False)
    assert found is before
    image, _ = scene((VIOLET, APART))
    assert without_reflexes(image, before, None) is before


def test_a_thread_ends_where_its_line_runs_on_along_a_reflex():
    image, mask = scene((VIOLET, ALONG_THE_EDGE[:3]), ((250, 250, 250), ALONG_THE_EDGE[2:]))
    occluders = np.zeros((120, 240), np.uint8)
    occluders[:, TOOL_U // 2 :] = 1
    found = without_reflexes(image, thread_lines(image, mask), occluders)
    point = found.centrelines.point_px
    assert len(np.unique(found.centrelines.piece)) == 1
    assert np.hypot(*(point - (310, 170)).T).min() < 8
    assert point[:, 1].min() > 140


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("thread", [[(30, 150), (292, 170)], [(212, 160), (292, 170)]], ids=["a bit", "most"])
def test_a_thread_ends_where_its_line_runs_on_along_a_shadow(thread, turned):
    """Also where most of the line is shadow, whichever end of it that is."""
    shadow = [(292, 170), (294, 100), (294, 5)]
    lines = [(VIOLET, APART[:2]), (VIOLET, thread), (SHADOW, shadow)]
    if turned:
        lines = [(colour, [(u, HEIGHT - 1 - v) for u, v in points]) for colour, points in lines]
    before, found = left_of(lines)
    length = np.hypot(*np.subtract(*thread))
    assert len(np.unique(before.centrelines.piece)) == len(np.unique(found.centrelines.piece)) == 2
    point = found.centrelines.point_px
    if turned:
        point = point * (1, -1) + (0, HEIGHT - 1)
    longest = point[(point[:, 1] > 100) | (point[:, 0] > 160)]
    assert abs(len(longest) - length) < 12
    assert longest[:, 1].min() > 145
