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


def soft_print():
    """Soft print of upright strokes."""
    image = np.full((HEIGHT, WIDTH), 215.0, np.float32)
    for u in range(0, WIDTH, 24):
        cv2.rectangle(image, (u, 0), (u + 9, HEIGHT), (120.0,), -1)
    return cv2.GaussianBlur(image, (0, 0), 2.2)


def print_with_thread():
    """The print, and one sharp thread that winds over it."""
    image = soft_print()
    u = np.linspace(0.15, 0.85, 200)
    wave = np.stack((WIDTH * u, HEIGHT * (0.5 + 0.3 * np.sin(14 * u))), axis=1)
    cv2.polylines(image, [np.rint(16 * wave).astype(np.int32)], False, (40.0,), 7, cv2.LINE_AA, 4)
    return cv2.GaussianBlur(image, (0, 0), 0.5)


@pytest.mark.parametrize("px", [1.2, 3.0])
def test_softness_is_nearly_the_deviation_that_edges_were_blurred_by(px):
    image = discs(gaussian(px))
    soft = np.array(softness_px(noisy(image, 0.5)), np.float64)
    assert soft.shape == (len(DIRECTIONS_DEG),)
    # noise and crossing edges let some look sharper than they are, never softer
    assert (0.65 * px < soft).all() and (soft < 1.05 * px).all()
    # the black borders that rectification leaves are no sharp edges
    bordered = noisy(image)
    bordered[:40], bordered[:, -90:] = 0, 0
    assert softness_px(bordered) == softness_px(noisy(image))


@pytest.mark.parametrize(
    ("degrees", "length_px", "way"),
    [(0, 13, "left to right"), (45, 17, "down to the right"), (90, 13, "up and down"), (135, 17, "down to the left")],
)
def test_a_smear_is_soft_along_itself_and_sharp_across_and_its_way_is_named(degrees, length_px, way):
    smeared = discs(motion(length_px, degrees))
    soft = np.array(softness_px(noisy(smeared, 0.5)), np.float64)
    number = DIRECTIONS_DEG.index(degrees)
    assert int(np.argmax(soft)) == number
    assert soft[number] > 2 * soft[(number + 2) % 4]
    answer = about_sharpness(noisy(smeared), noisy(smeared, 1.4))
    assert answer.wrong is not None and answer.wrong.code == "smeared"
    assert f"smeared {way}:" in answer.found
    thread = motion(length_px, degrees)(print_with_thread())
    on_print = about_sharpness(noisy(thread), noisy(thread, seed=1))
    assert on_print.wrong is not None or not on_print.is_known


def test_soft_print_below_a_sharp_thread_is_sharp_and_without_it_is_not_told():
    with_thread, alone = (
        about_sharpness(noisy(image), noisy(image, seed=1)) for image in (print_with_thread(), soft_print())
    )
    assert with_thread.wrong is None and with_thread.is_known
    assert alone.wrong is None and not alone.is_known


def test_one_eye_out_of_focus_is_named_and_one_smeared_alone_is_no_motion():
    sharp, soft = noisy(discs(gaussian(0.5))), noisy(discs(gaussian(2.5)))
    for pair, eye in (((soft, sharp), "left"), ((sharp, soft), "right")):
        answer = about_sharpness(*pair)
        assert answer.wrong is not None and answer.wrong.code == "blurred"
        assert f"the {eye} image" in answer.found
    answer = about_sharpness(noisy(discs(motion(13, 0))), sharp)
    assert answer.wrong is None and not answer.is_known
