"""Shadows beside a thread, drawn on textured ground: ground in less light, where the thread has a colour of its own."""

import cv2
import numpy as np
import pytest

from agents.perception.segmentation.cast_shadow import without_cast_shadow
from agents.perception.segmentation.network import segment_network
from shared.scene.__main__ import make_scene
from shared.scene.render import render

SHAPE = 240, 480
FLESH, STEEL, YELLOW, VIOLET = (95, 105, 175), (130, 130, 130), (60, 140, 150), (90, 35, 75)
DARKER = 0.45
WIDTH = 5


def ground(colour=FLESH) -> np.ndarray:
    rng = np.random.default_rng(3)
    light = 1.0 + 0.1 * cv2.GaussianBlur(rng.normal(size=SHAPE), (0, 0), 6) * 6
    return light[..., None] * np.array(colour, float)


def drawn(shift=0, first=40, last=440) -> np.ndarray:
    """The coverage of a curve that runs through the image, so many pixels lower."""
    u = np.arange(first, last + 1)
    v = 120 + 40 * np.sin(u / 70) + shift
    mask = np.zeros(SHAPE, np.uint8)
    cv2.polylines(mask, [np.rint(np.stack((u, v), axis=1)).astype(np.int32)[:, None]], False, 255, WIDTH)
    return mask > 0


def beside(mask) -> np.ndarray:
    """The mask and the pixels that touch it, which are partly thread."""
    return cv2.dilate(mask.view(np.uint8), np.ones((3, 3), np.uint8)) > 0


def seen(ground_seen, thread, colour=VIOLET, shadow=None) -> np.ndarray:
    image = ground_seen.copy()
    if shadow is not None:
        image[shadow] *= DARKER
    image[thread] = colour
    noisy = cv2.GaussianBlur(image, (0, 0), 0.7) + np.random.default_rng(4).normal(0, 2, image.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("shift", [6, 9, 14, 18])
def test_a_shadow_that_runs_beside_the_thread_is_left_out_and_the_thread_stays(shift):
    thread, shadow = drawn(), drawn(shift, 150, 330)
    found = without_cast_shadow(seen(ground(), thread, shadow=shadow), thread | shadow)
    assert not found[shadow & ~beside(thread)].any()
    assert found[thread].mean() > 0.99


def test_what_was_segmented_between_thread_and_shadow_goes_with_the_shadow():
    thread, shadow = drawn(), drawn(9, 150, 330)
    between = (drawn(3, 150, 330) | drawn(6, 150, 330)) & ~thread
    found = without_cast_shadow(seen(ground(), thread, shadow=shadow), thread | shadow | between)
    assert found[(shadow | between) & ~beside(thread)].mean() < 0.05
    assert found[thread].mean() > 0.98


def test_ground_of_another_colour_that_was_segmented_with_a_shadow_goes_with_it():
    """A stain as small as that is not the ground as it is hereabouts."""
    thread, shadow = drawn(), drawn(12, 150, 330)
    lies, stain = ground(), (drawn(4, 225, 245) | drawn(7, 225, 245)) & ~thread
    lies[stain] = ground(YELLOW)[stain]
    found = without_cast_shadow(seen(lies, thread, shadow=shadow), thread | shadow | stain)
    assert found[stain & ~beside(beside(thread))].mean() < 0.1
    assert found[thread].mean() > 0.99


def test_thread_that_looks_rather_like_ground_stays_where_it_leads_on_beside_a_shadow():
    """The jaws of an instrument make the ground about them grey, and dull thread between them looks like that."""
    thread, shadow, dull = drawn(), drawn(6, 150, 345), drawn(0, 325, 440)
    lies = ground()
    lies[:, 345:] = ground(STEEL)[:, 345:]
    lies[dull] = 0.6 * ground((100, 130, 120))[dull]
    found = without_cast_shadow(seen(lies, thread & ~dull, shadow=shadow & ~thread), thread | shadow)
    assert not found[shadow & ~beside(beside(thread))].any()
    assert found[dull].mean() > 0.95


def test_a_shadow_is_known_on_an_instrument_as_on_tissue():
    lies = ground()
    lies[:, 230:290] = ground(STEEL)[:, 230:290]
    thread, shadow = drawn(), drawn(12, 180, 340)
    found = without_cast_shadow(seen(lies, thread, shadow=shadow), thread | shadow)
    assert found[shadow].mean() < 0.03
    assert found[thread].mean() > 0.99


def test_a_shadow_with_no_thread_beside_it_stays():
    thread, shadow = drawn(), drawn(60, 150, 330)
    segmented = thread | shadow
    assert np.array_equal(without_cast_shadow(seen(ground(), thread, shadow=shadow), segmented), segmented)


def test_a_stretch_of_thread_that_is_as_dull_as_the_ground_in_shadow_stays():
    thread, dull = drawn(), drawn(0, 220, 250)
    image = seen(ground(), thread)
    image[dull] = seen(DARKER * ground(), thread & ~dull)[dull]
    assert np.array_equal(without_cast_shadow(image, thread), thread)


def test_glints_on_a_thread_stay():
    thread = drawn()
    image = seen(ground(STEEL), thread, colour=(120, 40, 30))
    glint = drawn(0, 200, 300) & (np.indices(SHAPE)[1] % 20 < 14)
    image[cv2.erode(glint.astype(np.uint8), np.ones((3, 1), np.uint8)) > 0] = 250
    assert np.array_equal(without_cast_shadow(image, thread), thread)


@pytest.mark.parametrize("colour", [(40, 40, 40), (60, 60, 60), (20, 20, 20)])
def test_where_thread_has_no_colour_of_its_own_everything_stays(colour):
    thread, shadow = drawn(), drawn(9, 150, 330)
    segmented = thread | shadow
    found = without_cast_shadow(seen(ground(STEEL), thread, colour=colour, shadow=shadow), segmented)
    assert np.array_equal(found, segmented)


def test_another_thread_beside_it_stays():
    thread, other = drawn(), drawn(12, 150, 330)
    image = seen(ground(), thread)
    image[other & ~thread] = (60, 110, 20)
    assert np.array_equal(without_cast_shadow(image, thread | other), thread | other)


def test_nothing_segmented_is_nothing():
    nothing = np.zeros(SHAPE, bool)
    assert not without_cast_shadow(seen(ground(), nothing), nothing).any()


@pytest.mark.parametrize("thread", [("easy", "green", 7051), ("medium", "violet", 7035)])
def test_the_network_leaves_out_the_shadow_that_it_takes_for_thread(thread):
    config, colour, seed = thread
    pair = render(make_scene(config, "tissue", seed, colour))
    share = pair.coverage_left / 255.0
    shade = 0.65 * np.roll(share, 7, axis=0) * (1.0 - share)
    shaded = np.clip(pair.left_bgr * (1.0 - shade[..., None]), 0, 255).astype(np.uint8)
    found = segment_network(shaded) > 0
    near = cv2.dilate(pair.coverage_left, np.ones((7, 7), np.uint8)) >= 96
    assert near[found].mean() > 0.99
    assert found[share > 0.5].mean() > 0.97
