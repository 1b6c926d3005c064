"""What a lens or a motion softens is told from what is soft by itself, and the way of a motion is named."""

import cv2
import numpy as np
import pytest

from agents.perception.judging.picture import about_sharpness
from agents.perception.judging.sharpness import DIRECTIONS_DEG, softness_px

HEIGHT, WIDTH = 540, 960


def noisy(image, deviation=1.5, seed=0):
    noise = np.random.default_rng(seed).normal(0, deviation, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def discs(softened):
    """A ground of edges in all directions, blurred."""
    rng = np.random.default_rng(1)
    image = np.full((HEIGHT, WIDTH), 90.0, np.float32)
    for centre in rng.integers(0, (WIDTH, HEIGHT), (70, 2)):
        cv2.circle(image, centre.tolist(), int(rng.integers(20, 40)), float(rng.integers(150, 230)), -1, cv2.LINE_AA)
    return softened(image)


def gaussian(px):
    return lambda image: cv2.GaussianBlur(image, (0, 0), px)


def motion(length_px, degrees):
    kernel = np.zeros((2 * length_px + 1,) * 2, np.float32)
    half = 0.5 * length_px * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    ends = np.rint(length_px + np.stack((-half, half))).astype(int)
    cv2.line(kernel, ends[0].tolist(), ends[1].tolist(), 1.0)
    return lambda image: cv2.filter2D(image, -1, kernel / kernel.sum())


def print_with_thread():
    """Soft print of upright strokes, and one sharp thread that winds over it."""
    image = np.full((HEIGHT, WIDTH), 215.0, np.float32)
    for u in range(0, WIDTH, 24):
        cv2.rectangle(image, (u, 0), (u + 9, HEIGHT), (120.0,), -1)
    image = cv2.GaussianBlur(image, (0, 0), 2.2)
    u = np.linspace(0.15, 0.85, 200)
    wave = np.stack((WIDTH * u, HEIGHT * (0.5 + 0.3 * np.sin(14 * u))), axis=1)
    cv2.polylines(image, [np.rint(16 * wave).astype(np.int32)], False, (40.0,), 7, cv2.LINE_AA, 4)
    return cv2.GaussianBlur(image, (0, 0), 0.5)


@pytest.mark.parametrize("px", [1.2, 1.6, 2.0, 3.0])
def test_softness_is_nearly_the_deviation_that_edges_were_blurred_by(px):
    soft = np.array(softness_px(noisy(discs(gaussian(px)), 0.5)), np.float64)
    assert soft.shape == (len(DIRECTIONS_DEG),)
    # noise and crossing edges let some look sharper than they are, never softer
    assert (0.65 * px < soft).all() and (soft < 1.05 * px).all()


@pytest.mark.parametrize(("way", "degrees"), list(enumerate(DIRECTIONS_DEG)))
def test_a_smear_is_soft_along_itself_and_sharp_across(way, degrees):
    soft = np.array(softness_px(noisy(discs(motion(13, degrees)), 0.5)), np.float64)
    assert int(np.argmax(soft)) == way
    # a line of n pixels has the deviation n / sqrt(12)
    assert 0.5 < soft[way] / (13 / np.sqrt(12)) < 1.05
    assert soft[way] > 2 * soft[(way + 2) % 4]


def test_larger_images_are_as_soft_as_their_pixels_are_more():
    image = discs(gaussian(2.0))
    large = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    soft, of_large = (np.array(softness_px(noisy(i)), np.float64) for i in (image, large))
    assert of_large == pytest.approx(2 * soft, rel=0.15)


def test_soft_print_below_a_sharp_thread_is_sharp():
    image = noisy(print_with_thread())
    answer = about_sharpness(image, noisy(print_with_thread(), seed=1))
    assert answer.wrong is None and answer.is_known


@pytest.mark.parametrize(
    ("degrees", "length_px", "way"),
    [
        (0, 13, "left to right"),
        (45, 17, "down to the right"),
        (90, 13, "up and down"),
        (135, 17, "down to the left"),
    ],
)
def test_a_smeared_thread_on_soft_print_is_smeared_or_not_told(degrees, length_px, way):
    smeared = motion(length_px, degrees)(print_with_thread())
    answer = about_sharpness(noisy(smeared), noisy(smeared, seed=1))
    assert answer.wrong is not None or not answer.is_known
    on_discs = about_sharpness(noisy(discs(motion(length_px, degrees))), noisy(discs(motion(length_px, degrees)), 1.4))
    assert on_discs.wrong is not None and on_discs.wrong.code == "smeared"
    assert f"smeared {way}:" in on_discs.found


def test_print_without_a_thread_across_it_is_not_told():
    soft = np.full((HEIGHT, WIDTH), 215.0, np.float32)
    for u in range(0, WIDTH, 24):
        cv2.rectangle(soft, (u, 0), (u + 9, HEIGHT), (120.0,), -1)
    soft = cv2.GaussianBlur(soft, (0, 0), 2.2)
    answer = about_sharpness(noisy(soft), noisy(soft, seed=1))
    assert answer.wrong is None and not answer.is_known


def test_what_is_soft_one_way_in_one_eye_alone_is_no_motion():
    smeared = noisy(discs(motion(13, 0)))
    answer = about_sharpness(smeared, noisy(discs(gaussian(0.5))))
    assert answer.wrong is None and not answer.is_known


@pytest.mark.parametrize("eye", ["left", "right"])
def test_one_eye_out_of_focus_is_named(eye):
    sharp, soft = noisy(discs(gaussian(0.5))), noisy(discs(gaussian(2.5)))
    answer = about_sharpness(*((soft, sharp) if eye == "left" else (sharp, soft)))
    assert answer.wrong is not None and answer.wrong.code == "blurred"
    assert f"the {eye} image" in answer.found


def test_the_borders_that_rectification_leaves_are_no_sharp_edges():
    soft = noisy(discs(gaussian(3.0)))
    black = soft.copy()
    black[:40], black[:, -90:] = 0, 0
    assert softness_px(black) == softness_px(soft)
