"""Threads over tissue by the light renderer, against its true coverage; and lines drawn on smooth grounds."""

import functools

import cv2
import numpy as np
import pytest

from agents.perception.segmentation.near import Near
from benchmarks.ridge import candidate as ridge_candidate
from benchmarks.ridge.pieces import LEAST_LENGTH_PX
from benchmarks.ridge.ridge import segment_ridge
from benchmarks.ridge.view import view_of
from shared.scene.__main__ import make_scene
from shared.scene.render import RenderedPair, render, render_backdrop
from shared.scene.sensor import Sensor, expose, grain


@functools.cache
def scene(config, colour, seed) -> RenderedPair:
    return render(make_scene(config, "tissue", seed, colour))


def recall_and_precision(found, true_coverage):
    """Recall of the pixels that are mostly thread, precision to two pixels: what matters to matching by rows."""
    near = cv2.dilate(found, np.ones((5, 5), np.uint8)) > 0
    truly_near = cv2.dilate(true_coverage, np.ones((5, 5), np.uint8)) > 60
    return near[true_coverage > 128].mean(), truly_near[found > 0].mean()


@pytest.mark.parametrize(
    ("config", "colour", "seed"),
    [
        ("medium", "black", 32),
        ("crossing", "green", 34),
        ("singularity", "violet", 35),
    ],
)
def test_dark_and_coloured_thread_over_tissue_is_found_whole_and_alone(config, colour, seed):
    pair = scene(config, colour, seed)
    recall, precision = recall_and_precision(segment_ridge(pair.left_bgr), pair.coverage_left)
    assert recall > 0.95
    assert precision > 0.9


@pytest.mark.parametrize(("config", "seed"), [("easy", 41), ("medium", 42)])
def test_white_thread_is_found_among_glints_of_its_colour(config, seed):
    pair = scene(config, "white", seed)
    recall, precision = recall_and_precision(segment_ridge(pair.left_bgr), pair.coverage_left)
    assert recall > 0.85
    assert precision > 0.6


@pytest.mark.parametrize("seed", [61, 62, 63])
def test_tissue_without_thread_shows_none(seed):
    camera = make_scene("medium", "tissue", seed, "black").camera
    backdrop = render_backdrop(camera, "tissue", 80.0 + 10 * (seed - 60), seed)
    shape = camera.image_height, camera.image_width
    for image, number in ((backdrop.left_bgr, 0), (backdrop.right_bgr, 1)):
        assert not segment_ridge(expose(image, Sensor(), grain(shape, 2 * seed + number))).any()


def test_the_width_found_is_about_the_true_one():
    pair = scene("medium", "black", 32)
    found = (segment_ridge(pair.left_bgr) > 0).sum()
    true = pair.coverage_left.sum() / 255
    assert found == pytest.approx(true, rel=0.35)


def drawn_line(width, thickness, ground=170, grey=60, height=None):
    """A straight, slanted line over a smooth ground, anti-aliased."""
    height = height or width * 9 // 16
    scale = 4
    big = np.full((height * scale, width * scale, 3), ground, np.uint8)
    ends = (
        (round(0.15 * width * scale), round(0.2 * height * scale)),
        (round(0.85 * width * scale), round(0.7 * height * scale)),
    )
    cv2.line(big, *ends, (grey, grey, grey + 20), round(thickness * scale))
    image = cv2.resize(big, (width, height), interpolation=cv2.INTER_AREA)
    true = cv2.resize((big[..., 0] == grey).astype(np.uint8) * 255, (width, height), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(1).normal(0, 2.0, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8), true


@pytest.mark.parametrize(("width", "thickness"), [(320, 2), (640, 2), (960, 3), (960, 7), (1280, 6), (1920, 10)])
@pytest.mark.parametrize("grey", [60, 230])
def test_a_line_is_found_at_its_width_at_any_resolution(width, thickness, grey):
    image, true = drawn_line(width, thickness, ground=150, grey=grey)
    found = segment_ridge(image)
    recall, precision = recall_and_precision(found, true)
    assert recall > 0.97
    assert precision > 0.97
    assert (found > 0).sum() == pytest.approx((true > 127).sum(), rel=0.45)


def test_short_folds_beside_a_thread_that_are_fainter_than_it_would_be_are_no_part_of_it():
    image, true = drawn_line(960, 5)
    along = np.array([[144, 108], [816, 378]], float)
    for share in np.linspace(0.15, 0.85, 9):
        u, v = along[0] + share * (along[1] - along[0])
        # of the thread's hue, at an angle to it
        cv2.line(image, (round(u), round(v)), (round(u) + 3, round(v) - 40), (125, 125, 128), 4, cv2.LINE_AA)
    recall, precision = recall_and_precision(segment_ridge(image), true)
    assert recall > 0.97
    assert precision > 0.97


def test_many_bright_glints_do_not_hide_a_bright_thread():
    image, true = drawn_line(960, 4, ground=110, grey=150)
    random = np.random.default_rng(2)
    for u, v in random.integers((20, 20), (940, 520), (150, 2)):
        if not cv2.dilate(true, np.ones((41, 41), np.uint8))[v, u]:
            turn = random.uniform(0, np.pi)
            end = round(u + 9 * np.cos(turn)), round(v + 9 * np.sin(turn))
            cv2.line(image, (int(u), int(v)), end, (255, 255, 255), 4, cv2.LINE_AA)
    assert recall_and_precision(segment_ridge(image), true)[0] > 0.95


@pytest.mark.parametrize("beside", [0, 60])
def test_a_short_piece_is_thread_where_it_goes_on_from_thread(beside):
    image, true = drawn_line(960, 5)
    begin, end = np.array((144.0, 108.0)), np.array((816.0, 378.0))
    cut, after = (np.rint(begin + share * (end - begin)).astype(int) for share in (0.86, 0.875))
    image[:, cut[0] :] = 170
    one, other = ((int(u), int(v) - beside) for u, v in (after, end))
    cv2.line(image, one, other, (60, 60, 80), 5, cv2.LINE_AA)
    found = segment_ridge(image) > 0
    assert found[:, : cut[0]][true[:, : cut[0]] > 128].mean() > 0.95
    assert found[:, after[0] + 10 :].any() == (beside == 0)


def test_a_bright_thread_is_found_among_dark_cracks_that_touch():
    image, true = drawn_line(960, 4, ground=150, grey=185)
    # cracks that touch: much of them, and none of it long
    for corner in ((600, 90), (700, 80), (800, 110), (850, 200), (150, 300), (250, 420), (350, 470)):
        for angle in np.arange(0, 2 * np.pi, np.pi / 4):
            end = np.rint(corner + 40 * np.array([np.cos(angle), np.sin(angle)])).astype(int).tolist()
            cv2.line(image, corner, end, (10, 20, 30), 3, cv2.LINE_AA)
    recall, precision = recall_and_precision(segment_ridge(image), true)
    assert recall > 0.95
    assert precision > 0.95


def test_a_thread_is_found_though_more_speaks_for_clutter_of_the_other_polarity(monkeypatch):
    image = np.full((540, 960, 3), 130, np.uint8)
    thread = np.zeros(image.shape[:2], np.uint8)
    for drawn, value in ((image, (150, 150, 142)), (thread, 255)):
        cv2.line(drawn, (100, 400), (860, 470), value, 4, cv2.LINE_AA)
    # combs, of which none is long
    for left in (200, 500, 700):
        cv2.line(image, (left, 100), (left, 136), (10, 5, 0), 3)
        for row in range(100, 136, 6):
            cv2.line(image, (left, row), (left + 70, row), (10, 5, 0), 2, cv2.LINE_AA)
    image = np.clip(image + np.random.default_rng(1).normal(0, 2, image.shape), 0, 255).astype(np.uint8)
    monkeypatch.setattr(ridge_candidate, "UNLIKELY_SHARE", 1.0)
    assert ridge_candidate.polarities(view_of(image, None, None), None) == ([False], [True])
    recall, precision = recall_and_precision(segment_ridge(image), thread)
    assert recall > 0.95
    assert precision > 0.95


def test_a_speck_is_no_line():
    image = np.full((270, 480, 3), 150, np.uint8)
    cv2.line(image, (200, 100), (200 + LEAST_LENGTH_PX // 3, 100), (40, 40, 40), 2)
    assert not segment_ridge(image).any()


@pytest.mark.parametrize("grey", [0, 130, 255])
def test_an_image_of_one_colour_holds_no_thread(grey):
    assert not segment_ridge(np.full((270, 480, 3), grey, np.uint8)).any()


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 1), (2, 3), (9, 9), (1, 2500), (600, 3)])
def test_tiny_and_narrow_images_are_segmented_without_complaint(shape):
    image = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
    assert segment_ridge(image).shape == shape


def test_near_a_known_thread_the_same_thread_is_found_and_nothing_elsewhere():
    pair = scene("medium", "black", 32)
    whole = segment_ridge(pair.left_bgr)
    near = cv2.dilate(np.roll(whole, (7, -9), axis=(0, 1)), np.ones((41, 41), np.uint8)) > 0
    again = segment_ridge(pair.left_bgr, Near(near, is_bright=False))
    both, either = (whole > 0) & (again > 0), (whole > 0) | (again > 0)
    assert both.sum() > 0.95 * either.sum()
    half = near.copy()
    half[:, : near.shape[1] // 2] = False
    assert not segment_ridge(pair.left_bgr, Near(half, is_bright=False))[:, : near.shape[1] // 2 - 8].any()


def test_near_nothing_nothing_is_found():
    pair = scene("medium", "black", 32)
    nowhere = Near(np.zeros(pair.left_bgr.shape[:2], bool), is_bright=False)
    assert not segment_ridge(pair.left_bgr, nowhere).any()


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (9, 9), (1, 2500), (600, 3), (77, 641)])
def test_any_place_to_look_near_is_fine(shape):
    image = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
    for place in [(0, 0), (-1, -1), (shape[0] // 2, shape[1] // 2)]:
        near = np.zeros(shape, bool)
        near[place] = True
        assert segment_ridge(image, Near(near, is_bright=True)).shape == shape


def test_noise_gives_a_mask_of_two_values():
    image = np.random.default_rng(0).integers(0, 256, (120, 200, 3), dtype=np.uint8)
    assert set(np.unique(segment_ridge(image)).tolist()) <= {0, 255}
