"""Needles at the ends of threads, drawn: what is steel is cut off, and what only looks odd is not."""

import cv2
import numpy as np
import pytest

from agents.perception.centrelines.centrelines import thread_lines
from agents.perception.needles import needle_map, without_needles
from agents.perception.observe import observe
from agents.perception.occluders import with_needles
from agents.perception.segmenter_names import GIVEN_MASKS
from schemas.messages import FrameStamp, Occluder, RectifiedStereo
from shared.images import decode_image
from shared.occluded import hidden_ends

HEIGHT, WIDTH = 240, 480
TISSUE, VIOLET, BLACK = (95, 105, 190), (140, 60, 110), (40, 40, 42)
SWAGE_U = 330
FINE = 8
"""How much finer than its pixels a picture is drawn."""


def scene(
    thread=VIOLET, needle_px=9.0, wider_px=5.0, glossy=False, tool=False, turned=False, swage_u=SWAGE_U, tint=(0, 0, 0)
):
    """A thread 5 px wide from the left, on from `swage_u` as a needle if that has a width, else as thread."""
    rng = np.random.default_rng(3)
    image = np.full((HEIGHT, WIDTH, 3), TISSUE, np.float32)
    image += cv2.GaussianBlur(rng.normal(0, 60, (HEIGHT, WIDTH, 1)).astype(np.float32), (0, 0), 6)[..., None]
    if tool:
        image[:, SWAGE_U:] = (150, 150, 150)
    u = np.arange(40.0, 430.0, 0.25)
    point = np.column_stack((u, 120 + 50 * np.sin(u / 60)))
    coverage = np.zeros((HEIGHT, WIDTH), np.float32)
    for first, last, width, steel in (
        (40, swage_u, 5.0, False),
        (swage_u, 430, needle_px or wider_px, bool(needle_px)),
    ):
        on = point[(u >= first) & (u < last)]
        share = strip(on, width)
        along = np.clip((np.arange(WIDTH) - first) / (last - first), 0, 1)
        shine = 20 + 230 * np.exp(-(((along - 0.3) / 0.15) ** 2))
        body = np.repeat(shine[None, :, None], 3, axis=2) + tint if steel else np.array(thread, np.float32)
        if glossy and first == swage_u:
            body = np.array(thread) + 0.5 * (shine[None, :, None] - 20)
        image = image * (1 - share[..., None]) + body * share[..., None]
        coverage = np.maximum(coverage, share)
    seen = (image + rng.normal(0, 2, image.shape)).clip(0, 255).astype(np.uint8)
    mask = np.where(coverage > 0.5, 255, 0).astype(np.uint8)
    return (seen[:, ::-1].copy(), mask[:, ::-1].copy()) if turned else (seen, mask)


def strip(point, width):
    fine = np.zeros((HEIGHT * FINE, WIDTH * FINE), np.uint8)
    at = np.rint((point + 0.5) * FINE).astype(np.int32)
    cv2.polylines(fine, [at[:, None]], False, 255, round(width * FINE))
    return cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float32) / 255


@pytest.mark.parametrize("thread", [VIOLET, BLACK])
@pytest.mark.parametrize("turned", [False, True])
def test_a_thread_ends_where_its_needle_begins(thread, turned):
    image, mask = scene(thread, turned=turned)
    before = thread_lines(image, mask)
    found, needles = without_needles(image, before)
    u = found.centrelines.point_px[:, 0]
    end = WIDTH - 1 - u.min() if turned else u.max()
    assert abs(end - SWAGE_U) < 8
    assert len(needles) == 1
    assert len(needles[0].point_px) + len(u) == len(before.centrelines.piece)
    # the new end is one of the thread's own
    assert (found.loose_start if turned else found.loose_end).all()


@pytest.mark.parametrize(
    "oddly",
    [{"needle_px": 5.0, "swage_u": 380}, {"tint": (-9, 0, 17)}],
    ids=["no wider than its thread", "mirrors what has a colour"],
)
def test_a_needle_may_be_no_wider_or_not_quite_grey(oddly):
    image, mask = scene(**oddly)
    found, needles = without_needles(image, thread_lines(image, mask))
    assert len(needles) == 1
    assert abs(found.centrelines.point_px[:, 0].max() - oddly.get("swage_u", SWAGE_U)) < 8


@pytest.mark.parametrize(
    "oddly",
    [{"tint": (-10, 0, 70)}, {"needle_px": 5.0, "swage_u": 412}],
    ids=["wide and bright, but coloured", "a short grey stretch no wider"],
)
def test_what_is_not_steel_in_all_of_its_looks_is_no_needle(oddly):
    image, mask = scene(**oddly)
    assert without_needles(image, thread_lines(image, mask))[1] == []


def test_a_needle_that_a_glint_parts_is_cut_off_in_both_its_pieces():
    image, mask = scene()
    mask[:, 392:398] = 0
    lines = thread_lines(image, mask)
    assert len(np.unique(lines.centrelines.piece)) == 2
    found, needles = without_needles(image, lines)
    assert len(needles) == 2
    assert found.centrelines.point_px[:, 0].max() < SWAGE_U + 8


@pytest.mark.parametrize(("segmenter", "ends_u"), [("network", SWAGE_U), (GIVEN_MASKS, 430)])
def test_what_is_observed_ends_where_the_needle_begins_unless_a_person_drew_the_mask(segmenter, ends_u):
    camera = RectifiedStereo(WIDTH, HEIGHT, 500.0, 500.0, 239.5, 119.5, 5e-3, 1.0)
    image, mask = scene()
    right, mask_right = (np.roll(one, -20, axis=1) for one in (image, mask))
    found = observe(FrameStamp(0, 1, 1, ""), camera, image, right, mask, mask_right, segmenter, (), matching=False)
    for lines, shift in ((found.centrelines_left, 0), (found.centrelines_right, 20)):
        assert lines.point_px[:, 0].max() + shift == pytest.approx(ends_u, abs=10)
    assert (found.occluders is None) == (segmenter == GIVEN_MASKS)
    if found.occluders is not None:
        assert (decode_image(found.occluders.right) == Occluder.NEEDLE.value).any()


@pytest.mark.parametrize(
    "oddly",
    [
        {"wider_px": 5.0},
        {"wider_px": 9.0},
        {"wider_px": 9.0, "thread": BLACK},
        {"wider_px": 9.0, "thread": BLACK, "glossy": True, "tool": True},
    ],
    ids=["even", "wider", "black and wider", "black, wider, glossy and over steel"],
)
def test_thread_is_left_whole(oddly):
    image, mask = scene(needle_px=0.0, **oddly)
    lines = thread_lines(image, mask)
    found, needles = without_needles(image, lines)
    assert needles == []
    assert found is lines


def test_a_needle_may_hide_thread_but_no_end_of_it():
    image, mask = scene()
    found, needles = without_needles(image, thread_lines(image, mask))
    known = needle_map(image.shape, needles, [], 5)
    assert known is not None
    region = decode_image(known.left)
    assert set(np.unique(region)) == {0, Occluder.NEEDLE.value}
    assert not decode_image(known.right).any()
    at = needles[0].point_px[len(needles[0].point_px) // 2] * 240 / WIDTH
    assert region[round(at[1]), round(at[0])] == Occluder.NEEDLE.value
    assert not hidden_ends(found.centrelines.point_px, region, WIDTH).any()
    tool = np.where(region > 0, np.uint8(Occluder.TOOL.value), region)
    assert hidden_ends(found.centrelines.point_px, tool, WIDTH).tolist() == [False, True]
    assert (with_needles(tool, region) == tool).all()
    assert (with_needles(np.zeros_like(tool), region) == region).all()
