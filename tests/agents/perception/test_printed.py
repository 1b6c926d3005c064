"""Lines over textured ground that is drawn for both eyes: printed upon it, or standing off it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from agents.perception.candidates import without_printed
from agents.perception.candidates.patches import before_planes, ground_planes, patches_around
from agents.perception.candidates.relief import MOST_PLACES, Relief, relief_of
from agents.perception.observe import observe
from agents.perception.segmenter_names import GIVEN_MASKS, NETWORK
from agents.perception.told_apart import told_apart
from schemas.messages import Centrelines, FrameStamp, RectifiedStereo, Status, no_centrelines

WIDTH, HEIGHT, FOCAL_PX = 640, 360, 600.0
NEAR, ALONG, DOWN = 40.0, 0.02, -0.03
"""The ground's disparity, and by how much it changes in a pixel either way."""
INK, LINE_PX = (90, 40, 60), 6.0
OWN_PX = LINE_PX * NEAR / FOCAL_PX
LEAST_PX = 30.0
CAMERA = RectifiedStereo(WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX, 319.5, 179.5, 5.0, 1e-3)


def disparity(u, v):
    return NEAR + ALONG * (u - WIDTH / 2) + DOWN * (v - HEIGHT / 2)


def ground(texture=40.0, noise=2.0):
    """Left and right: the same texture, seen from either eye, each with noise of its own."""
    rng = np.random.default_rng(3)
    wide = cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT, WIDTH + 200, 3)).astype(np.float32), (0, 0), 2.5)
    tissue = np.array((80, 90, 170), np.float32) + texture * wide / wide.std()
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    shown_left = (u + NEAR - ALONG * WIDTH / 2 + DOWN * (v - HEIGHT / 2)) / (1 - ALONG)
    seen = [cv2.remap(tissue, at + 60, v, cv2.INTER_CUBIC) for at in (u, shown_left)]
    return [image + rng.normal(0, noise, image.shape) for image in seen]


def with_lines(images, lines):
    """Bytes of both images with lines upon them; a line is its u in each row of the left eye, and its relief."""
    drawn, v = [image.copy() for image in images], np.arange(HEIGHT, dtype=float)
    for u, relief in lines:
        for image, at in zip(drawn, (u, u - disparity(u, v) - relief), strict=True):
            away = np.abs(np.arange(WIDTH)[None] - at[:, None]) * np.cos(np.arctan(np.gradient(at)))[:, None]
            share = np.clip(0.5 * LINE_PX + 0.5 - away, 0, 1)[..., None]
            image[:] = (1 - share) * image + share * np.array(INK)
    left, right = (np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in drawn)
    return left, right


def middles(lines, first=40, last=320):
    """The middles of these lines in the left eye and in the right one, each a piece."""
    v = np.arange(HEIGHT, dtype=float)
    left = [np.stack((u, v), 1)[first:last] for u, _ in lines]
    right = [np.stack((u - disparity(u, v) - relief, v), 1)[first:last] for u, relief in lines]
    of_left, of_right = (
        Centrelines(
            np.concatenate(points),
            np.repeat(np.arange(len(points)), last - first),
            np.full(len(points) * (last - first), LINE_PX),
            np.full(len(points) * (last - first), 0.1),
        )
        for points in (left, right)
    )
    return of_left, of_right


def bent(at):
    """A line from top to bottom."""
    v = np.arange(HEIGHT)
    return at + 30 * np.sin(v / 60)


def standing(lines, **of_ground):
    images = with_lines(ground(**of_ground), lines)
    return without_printed(images, middles(lines), LEAST_PX, FOCAL_PX)


@pytest.mark.parametrize("gain", [1.0, 0.6])
def test_the_ground_is_told_within_a_twentieth_of_a_pixel_and_so_is_what_stands_off_it(gain):
    u, relief = bent(330), 0.7
    left, right = with_lines(ground(), [(u, relief)])
    images = left, np.rint(gain * right).astype(np.uint8)
    v = np.arange(60, 300, 20)
    patches = patches_around(images, np.stack((u[v], v), 1))
    none = np.zeros((HEIGHT, WIDTH, 1), np.uint8)
    masks = none.copy(), none.copy()
    for mask, lines in zip(masks, middles([(u, relief)]), strict=True):
        cv2.polylines(mask, [np.rint(lines.point_px).astype(np.int32)[:, None]], False, 255, 12)
    plane, told = ground_planes(patches, masks, disparity(u[v], v) + 0.8)
    assert told.all()
    np.testing.assert_allclose(plane[:, 0], disparity(u[v], v), atol=0.05)
    reach = WIDTH / 48
    np.testing.assert_allclose(plane[:, 1:] / reach, np.tile((ALONG, DOWN), (len(v), 1)), atol=0.01)
    on_line = np.abs(patches.u - u[v][:, None]) < 3
    off = before_planes(patches, plane, on_line, np.full(len(v), 0.3))
    np.testing.assert_allclose(off.mean(), relief, atol=0.07)


def test_where_hardly_any_ground_is_seen_it_is_not_told():
    u, v = bent(330), np.arange(60, 300, 20)
    patches = patches_around(with_lines(ground(), []), np.stack((u[v], v), 1))
    none = np.zeros((HEIGHT, WIDTH, 1), np.uint8)
    hidden = none.copy()
    hidden[:, ::4] = hidden[:, 1::4] = hidden[:, 2::4] = 255
    start = disparity(u[v], v) + 0.3
    assert ground_planes(patches, (none, none), start)[1].all()
    assert not ground_planes(patches, (hidden, none), start)[1].any()
    assert not ground_planes(patches, (none, hidden), start)[1].any()


def test_a_printed_line_is_no_thread():
    left, right = standing([(bent(330), 0.0)])
    assert len(left.piece) == len(right.piece) == 0


def test_a_line_that_stands_off_the_ground_by_its_own_width_or_more_is_kept():
    for relief in (OWN_PX, 3.0):
        lines = [(bent(330), relief)]
        kept = standing(lines)
        for one, whole in zip(kept, middles(lines), strict=True):
            np.testing.assert_array_equal(one.point_px, whole.point_px)


def test_a_thread_beside_a_printed_line_is_kept_alone_in_both_eyes():
    lines = [(bent(230), 0.0), (bent(430), 2.0)]
    left, right = standing(lines)
    of_left, of_right = middles(lines[1:])
    np.testing.assert_array_equal(left.point_px, of_left.point_px)
    np.testing.assert_array_equal(right.point_px, of_right.point_px)


@pytest.mark.parametrize("noise", [0.5, 2.0, 6.0])
def test_over_ground_of_one_colour_nothing_is_called_print(noise):
    left, right = standing([(bent(330), 3.0)], texture=0.0, noise=noise)
    assert len(left.piece) == len(right.piece) > 0


def test_a_row_in_which_the_right_eye_shows_the_line_twice_not_at_all_or_otherwise_tells_nothing():
    lines = [(bent(330), 3.0)]
    images = with_lines(ground(), lines)
    left, right = middles(lines)

    def places(shown):
        return len(relief_of(images, (left, shown), (left, shown), FOCAL_PX).relief_px)

    whole = places(right)
    assert whole > 15
    beside = replace(right, point_px=right.point_px + np.array((8.0, 0.0)), piece=right.piece + 1)
    fields = ("point_px", "piece", "width_px", "deviation_px")
    twice = Centrelines(*(np.concatenate((getattr(right, name), getattr(beside, name))) for name in fields))
    assert places(twice) == 0
    apart = replace(right, piece=(right.point_px[:, 1] > 200).astype(np.int64))
    row = right.point_px[:, 1]

    def part(kept):
        return Centrelines(*(getattr(apart, name)[kept] for name in fields))

    # as many places as ever are taken from rows in which the right eye shows the line, while there are enough
    assert places(part((row < 150) | (row > 250))) == whole
    assert 0 < places(part(np.abs(row - 160) < 10)) < 0.5 * whole
    slanted = replace(right, point_px=right.point_px + (right.point_px[:, 1:] - 180) * (1.0, 0.0))
    assert places(slanted) == 0


def test_a_line_along_the_rows_and_one_that_a_single_eye_sees_are_not_called_print():
    v = np.arange(HEIGHT, dtype=float)
    level = 20.0 + 5.0 * v
    lines = [(level, 0.0)]
    images = with_lines(ground(), lines)
    along = middles(lines, 10, 100)
    assert without_printed(images, along, LEAST_PX, FOCAL_PX) == along
    steep = middles([(bent(330), 0.0)])
    alone = steep[0], no_centrelines()
    assert without_printed(images, alone, LEAST_PX, FOCAL_PX) == alone


def test_a_line_too_short_to_be_asked_goes_where_all_long_ones_are_printed():
    lines = [(bent(230), 0.0), (bent(430), 0.0)]
    images = with_lines(ground(), lines)
    both = middles(lines)
    assert len(without_printed(images, both, LEAST_PX, FOCAL_PX)[0].piece) == 0
    assert without_printed(images, both, 1000.0, FOCAL_PX) == both


@pytest.mark.parametrize("doubt", ["few places", "places that disagree", "a thin line", "nearly its own", "enough"])
def test_only_relief_that_is_certainly_less_than_a_threads_own_is_none(doubt):
    nothing = np.zeros(12)
    spread = np.where(np.arange(12) % 2, 0.4, -0.4)
    relief = {
        "few places": Relief(0.5, np.where(np.arange(12) < 4, 0.0, np.nan)),
        "places that disagree": Relief(0.5, spread),
        "a thin line": Relief(0.15, nothing),
        "nearly its own": Relief(0.5, nothing + 0.25),
        "enough": Relief(0.5, nothing + 0.1),
    }[doubt]
    assert relief.is_none is (doubt == "enough")


@pytest.mark.parametrize(
    ("relief", "score", "stays"),
    [(0.15, 0.95, True), (0.15, 0.8, False), (0.15, None, True), (0.25, 0.8, True), (0.0, 0.95, False)],
    ids=["doubtful but sure", "doubtful and unsure", "doubtful without a score", "unsure", "in the ground"],
)
def test_less_is_needed_to_hold_a_line_for_print_of_which_the_segmenter_is_not_sure(relief, score, stays):
    lines = [(bent(330), relief)]
    images = with_lines(ground(), lines)
    # a smaller copy does
    scores = None if score is None else np.full((HEIGHT // 2, WIDTH // 2), round(255 * score), np.uint8)
    found = without_printed(images, middles(lines), LEAST_PX, FOCAL_PX, scores)
    assert bool(len(found[0].piece)) is stays


def test_what_clearly_stands_off_is_asked_at_half_of_its_places_and_what_may_be_print_at_all():
    asked = {}
    for relief in (0.0, 1.0):
        lines = [(bent(330), relief)]
        both = middles(lines)
        found = relief_of(with_lines(ground(), lines), both, both, FOCAL_PX)
        asked[relief] = len(found.relief_px)
        assert found.is_none is (relief == 0.0)
    assert asked == {0.0: MOST_PLACES, 1.0: MOST_PLACES // 2}


def test_more_places_are_asked_where_they_may_tell_and_where_too_few_have_told():
    alternate = np.where(np.arange(12) % 2, 0.2, -0.2)
    doubtful = Relief(0.5, alternate + 0.05)
    assert (doubtful.is_none, doubtful.may_be_none) == (False, True)
    assert Relief(0.5, np.where(np.arange(12) < 4, 3.0, np.nan)).may_be_none
    assert not Relief(0.5, alternate + 0.5).may_be_none


@pytest.mark.parametrize("segmenter", [NETWORK, GIVEN_MASKS])
@pytest.mark.parametrize("pointed_at", [False, True])
def test_a_pair_with_print_alone_shows_no_thread_unless_a_person_says_so(segmenter, pointed_at):
    lines = [(bent(330), 0.0)]
    images = with_lines(ground(), lines)
    masks = []
    for line in middles(lines):
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        cv2.polylines(mask, [np.rint(line.point_px).astype(np.int32)[:, None]], False, 255, round(LINE_PX))
        masks.append(mask)
    stamp = FrameStamp(0, 0, 0, "")
    seen = observe(stamp, CAMERA, *images, masks[0], masks[1], segmenter, judged=(), matching=False)
    seen = replace(seen, prompt_px=np.array((330.0, 180.0)) if pointed_at else None)
    told = told_apart(seen, images, last=None)
    if segmenter == GIVEN_MASKS or pointed_at:
        assert told.status is Status.OK
        assert len(told.candidates) == 1
    else:
        assert told.status is Status.FAILED
        assert "lies in the ground" in told.reason
        assert "prompt" in told.reason


def test_what_is_followed_is_not_asked_again_before_the_next_look_at_the_whole():
    lines = [(bent(330), 0.0)]
    images = with_lines(ground(), lines)
    left, right = middles(lines)
    blank = np.zeros((HEIGHT, WIDTH), np.uint8)
    seen = observe(FrameStamp(5, 0, 0, ""), CAMERA, *images, blank, blank, NETWORK, judged=(), matching=False)
    seen = replace(seen, status=Status.OK, reason="", centrelines_left=left, centrelines_right=right)
    for looked, status in ((5, Status.FAILED), (3, Status.OK)):
        asked = replace(seen, looked_sequence=looked, trail_left=None, trail_right=None)
        assert told_apart(asked, images, last=None).status is status


def test_a_thread_beside_print_is_what_a_pair_shows():
    lines = [(bent(230), 0.0), (bent(430), 2.0)]
    images = with_lines(ground(), lines)
    masks = []
    for line in middles(lines):
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        for number in (0, 1):
            some = np.rint(line.point_px[line.piece == number]).astype(np.int32)
            cv2.polylines(mask, [some[:, None]], False, 255, round(LINE_PX))
        masks.append(mask)
    seen = observe(FrameStamp(0, 0, 0, ""), CAMERA, *images, masks[0], masks[1], NETWORK, judged=(), matching=False)
    told = told_apart(seen, images, last=None)
    assert told.status is Status.OK
    assert len(told.candidates) == 1
    assert (told.centrelines_left.point_px[:, 0] > 370).all()
    assert told.trail_left is not None
    assert len(told.trail_left.loose_start) == len(np.unique(told.centrelines_left.piece))
