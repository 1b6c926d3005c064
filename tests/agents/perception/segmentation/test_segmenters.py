"""Thread by threshold and by the trained network, and which of the two an image is given to.

The network sees light renders of seeds that it was not trained on, and drawn images.
"""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.perception.segmentation.boxes import CONTEXT_PX, Near, boxes_around
from agents.perception.segmentation.choice import SEGMENTERS, suitable_segmenter
from agents.perception.segmentation.network import segment_network, thread_in
from agents.perception.segmentation.threshold import segment_threshold
from agents.perception.segmenter_names import GIVEN_MASKS, PROMPTABLE, SEGMENTER_NAMES
from schemas import messages
from shared.rendering.render import make_scene, render
from tests.agents.perception.pictures import recall_and_precision, rendered

HEIGHT, WIDTH = 240, 320


def test_every_segmenter_has_its_name_and_gives_coverage_of_the_images_size():
    assert {GIVEN_MASKS, PROMPTABLE, *SEGMENTERS} == set(SEGMENTER_NAMES)
    assert messages.GIVEN_MASKS == GIVEN_MASKS
    for shape in ((1, 1), (1, 40), (40, 1), (7, 7), (54, 96)):
        image = np.random.default_rng(2).integers(0, 256, (*shape, 3), dtype=np.uint8)
        for segment in SEGMENTERS.values():
            found = segment(image)
            assert (found.shape, found.dtype) == (shape, np.uint8)


@pytest.mark.slow
def test_plain_ground_is_thresholded_and_tissue_is_given_to_the_network():
    for background, expected in (("plain", "threshold"), ("tissue", "network")):
        pair = render(make_scene("medium", background, 7))
        assert [suitable_segmenter(image) for image in (pair.left_bgr, pair.right_bgr)] == [expected] * 2
    on_white = np.full((480, 640, 3), 255, np.uint8)
    on_white[100:400, 300:312] = (120, 60, 130)
    assert suitable_segmenter(on_white) == "threshold"
    mostly_black = np.zeros((480, 640, 3), np.uint8)
    mostly_black[:, 500:] = np.linspace(20, 200, 480)[:, None, None]
    assert suitable_segmenter(mostly_black) == "network"


def coverage(thickness_px=2.0, scale=8):
    """A curved thread drawn large and averaged down, so that its edges are covered in part."""
    big = np.zeros((HEIGHT * scale, WIDTH * scale), np.uint8)
    t = np.linspace(0, 1, 400)
    points = np.column_stack((40 + 240 * t, 120 + 70 * np.sin(5 * t))) * scale
    cv2.polylines(big, [np.round(points).astype(np.int32)], False, 255, max(1, round(thickness_px * scale)))
    return cv2.resize(big, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)


def laid(thread, ground=(206, 206, 206), colour=(150, 150, 150), noise=0.0, jpeg=100):
    behind = np.broadcast_to(np.asarray(ground, float), (HEIGHT, WIDTH, 3))
    image = behind + thread[..., None] / 255 * (np.asarray(colour, float) - behind)
    image = image + np.random.default_rng(0).normal(0, noise, image.shape)
    _, data = cv2.imencode(".jpg", np.clip(np.rint(image), 0, 255), [cv2.IMWRITE_JPEG_QUALITY, jpeg])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


GRADIENT = np.linspace(120, 230, WIDTH)[None, :, None] + np.linspace(-20, 20, HEIGHT)[:, None, None] + np.zeros(3)
PLAIN = {
    "thin, faint": (1.2, {"colour": (165, 165, 165)}),
    "faint, noise and JPEG": (1.6, {"colour": (160, 160, 160), "noise": 1.0, "jpeg": 90}),
    "strong JPEG": (2.0, {"jpeg": 75}),
    "on white": (5.0, {"ground": (255, 255, 255), "colour": (60, 40, 90)}),
    "brighter than its ground": (2.0, {"ground": (90, 90, 90), "colour": (190, 190, 190)}),
    "only its colour differs": (3.0, {"ground": (150, 150, 150), "colour": (220, 150, 90)}),
    "gradient, noise and JPEG": (2.5, {"ground": GRADIENT, "colour": (60, 60, 60), "noise": 1.0, "jpeg": 85}),
}


@pytest.mark.parametrize(("thickness", "how"), PLAIN.values(), ids=PLAIN)
def test_a_thread_on_a_plain_ground_is_found_and_nothing_else(thickness, how):
    thread = coverage(thickness)
    assert min(recall_and_precision(segment_threshold(laid(thread, **how)), thread)) > 0.97


def test_coverage_is_fuller_in_the_middle_than_at_the_edge():
    share = coverage(4.0) / 255
    found = segment_threshold(laid(coverage(4.0), colour=(90, 90, 90)))
    assert found[share > 0.99].mean() > 240
    assert found[(share > 0.3) & (share < 0.5) & (found > 0)].mean() < 200
    assert found[found > 0].min() >= 128


def test_specks_noise_and_images_of_one_colour_hold_no_thread():
    empty = np.zeros((HEIGHT, WIDTH))
    specks = laid(empty)
    specks[50, 60:62] = specks[200, 300] = 100
    for image in (specks, laid(empty, noise=1.5), np.full((HEIGHT, WIDTH, 3), 255, np.uint8)):
        assert not segment_threshold(image).any()


def test_only_pieces_near_the_place_are_kept():
    image = laid(coverage())
    whole, near = segment_threshold(image), np.zeros((HEIGHT, WIDTH), bool)
    assert not segment_threshold(image, Near(near, is_bright=False)).any()
    v, u = np.argwhere(whole)[0]
    near[v - 4 : v + 5, u - 4 : u + 5] = True
    np.testing.assert_array_equal(segment_threshold(image, Near(near, is_bright=False)), whole)


def around(mask, side):
    return cv2.dilate(mask, np.ones((side, side), np.uint8)) >= 96


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "colour", "seed"), [("medium", "black", 7032), ("crossing", "green", 7034), ("easy", "white", 7036)]
)
def test_thread_over_tissue_is_found_whole_and_alone(config, colour, seed):
    pair = rendered(config, seed, colour)[1]
    found = segment_network(pair.left_bgr)
    assert set(np.unique(found)) == {0, 255}
    assert min(recall_and_precision(found, pair.coverage_left, 5)) > 0.97
    assert found.mean() == pytest.approx(pair.coverage_left.mean(), rel=0.2)


def test_no_thread_is_found_in_tissue_without_one():
    pair = rendered("medium", 7032, "black")[1]
    bare = cv2.inpaint(pair.left_bgr, (around(pair.coverage_left, 9) * 255).astype(np.uint8), 5, cv2.INPAINT_TELEA)
    assert not segment_network(bare).any()


@pytest.mark.parametrize(
    ("thread", "length_px", "is_thread"), [(200, 120, True), (130, 240, True), (130, 40, False), (90, 120, False)]
)
def test_a_line_is_thread_where_enough_speaks_for_it_as_a_whole(thread, length_px, is_thread):
    score = np.zeros((60, 300, 2), np.uint8)
    score[28:33, 40 : 40 + length_px, 0] = thread
    assert thread_in(score).any() == is_thread


@pytest.mark.parametrize(
    ("columns", "rest", "is_kept"),
    [(slice(200, 260), 200, False), (slice(120, 180), 200, True), (slice(200, 260), 250, True)],
    ids=["a needle at the end", "within the line", "at the end of what is surely thread"],
)
def test_what_looks_like_metal_ends_a_line_at_its_end_alone(columns, rest, is_kept):
    score = np.zeros((60, 300, 2), np.uint8)
    score[28:33, 40:260] = rest, 255 - rest
    score[28:33, columns] = 100, 120
    found = thread_in(score)
    assert found[30, 40:120].all() and found[30, 180:200].all()
    assert found[30, columns].all() == found[30, columns].any() == is_kept


PLACES = st.lists(
    st.tuples(st.integers(0, 199), st.integers(0, 339), st.integers(1, 90), st.integers(1, 90)), max_size=6
)


@given(PLACES)
def test_every_pixel_lies_in_one_inner_box_and_its_surroundings_in_the_outer(places):
    where = np.zeros((200, 340), bool)
    for row, column, height, width in places:
        where[row : row + height, column : column + width] = True
    image, times = np.arange(where.size).reshape(where.shape), np.zeros(where.shape, int)
    for box in boxes_around(where):
        times[box.inner] += 1
        for inner, outer, size in zip(box.inner, box.outer, where.shape, strict=True):
            assert max(0, inner.start - CONTEXT_PX) >= outer.start >= 0
            assert min(size, inner.stop + CONTEXT_PX) <= outer.stop <= size
        np.testing.assert_array_equal(image[box.outer][box.inner_in_outer], image[box.inner])
    assert (times[where] == 1).all()
    assert times.max(initial=0) <= 1
    # nothing needs no box
    assert where.any() or not times.any()
