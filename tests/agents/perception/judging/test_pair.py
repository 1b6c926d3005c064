"""Pairs that are whole raise no alarm; what is done to them is found, in a sentence with its remedy."""

import functools

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.perception.judging.answers import judgements
from agents.perception.judging.correspondence import correspondence_of_texture
from agents.perception.judging.pair import about_pair
from agents.perception.judging.picture import INTERLACING
from schemas.messages import RectifiedStereo, Severity

HEIGHT, WIDTH = 270, 480
CAMERA = RectifiedStereo(WIDTH, HEIGHT, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)
DISPARITY_PX = 30.0


@functools.cache
def ground(seed, height=HEIGHT + 80, width=WIDTH + 160):
    """Tissue-like: blotches, and small bright glints with sharp edges."""
    rng = np.random.default_rng(seed)
    coarse, fine = (
        cv2.GaussianBlur(rng.standard_normal((height, width, 3)).astype(np.float32), (0, 0), s) for s in (12.0, 2.0)
    )
    image = 120 + 30 * coarse / coarse.std() + 12 * fine / fine.std()
    for _ in range(150):
        centre = rng.integers(0, (width, height))
        axes, angle = rng.integers(2, 9, 2), float(rng.integers(0, 180))
        colour = (230, 235, 240) if rng.random() < 0.5 else (40, 30, 60)
        cv2.ellipse(image, centre.tolist(), axes.tolist(), angle, 0, 360, colour, -1, cv2.LINE_AA)
    return image


def window(image, right_px, down_px=0.0, turned_deg=0.0, larger=1.0):
    """What an eye sees of the ground, from so far to the right."""
    M = cv2.getRotationMatrix2D(((WIDTH - 1) / 2, (HEIGHT - 1) / 2), -turned_deg, larger)
    M[:, 2] += M[:, :2] @ (-80.0 - right_px, -40.0) + (0.0, down_px)
    noise = np.random.default_rng(int(1e3 * right_px)).normal(0, 1.5, (HEIGHT, WIDTH, 3))
    seen = cv2.warpAffine(image, M, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR)
    return np.clip(seen + noise, 0, 255).astype(np.uint8)


def pair(seed=0, **right):
    image = ground(seed)
    return window(image, 0.0), window(image, DISPARITY_PX, **right)


def both(change):
    return lambda images: (change(images[0]), change(images[1]))


def codes(images, raw=None):
    return {j.code: j.severity for j in judgements(about_pair(images, CAMERA, raw))}


@pytest.mark.parametrize("seed", range(2))
def test_a_whole_pair_raises_no_alarm_and_all_is_told(seed):
    answers = about_pair(pair(seed), CAMERA)
    assert judgements(answers) == ()
    assert [answer.question for answer in answers if not answer.is_known] == []


@pytest.mark.slow
@settings(max_examples=8)
@given(st.floats(-6, 6), st.floats(-1.5, 1.5), st.floats(0.99, 1.01), st.integers(0, 1))
def test_offset_rotation_and_magnification_are_measured(down_px, turned_deg, larger, seed):
    seen = correspondence_of_texture(*pair(seed, down_px=down_px, turned_deg=turned_deg, larger=larger))
    assert seen is not None
    # turning about the middle moves what lies there by its disparity's share
    tilt_px = DISPARITY_PX * np.sin(np.radians(turned_deg))
    assert seen.row_residual_px == pytest.approx(-down_px, abs=0.25 + abs(tilt_px))
    assert seen.rotation_deg == pytest.approx(turned_deg, abs=0.06)
    assert seen.magnification == pytest.approx(larger, abs=2e-3)
    assert seen.row_deviation_px is not None and seen.row_deviation_px < 0.2


RIGHT = {
    "lower by 2 px": ({"down_px": 2}, "row_residual", Severity.WARNING),
    "lower by 6 px": ({"down_px": 6}, "row_residual", Severity.FAULT),
    "turned by half a degree": ({"turned_deg": 0.5}, "rotated", Severity.WARNING),
    "upside down": ({"turned_deg": 180}, "rotated", Severity.FAULT),
    "1.5 % larger": ({"larger": 1.015}, "sizes_differ", Severity.WARNING),
    "10 % smaller": ({"larger": 0.9}, "sizes_differ", Severity.FAULT),
}


@pytest.mark.parametrize(("right", "code", "severity"), RIGHT.values(), ids=RIGHT)
def test_an_eye_that_lies_otherwise_is_found(right, code, severity):
    assert codes(pair(**right)).get(code) is severity


def woven(image):
    rows = image.copy()
    rows[1::2] = np.roll(image, 4, axis=1)[1::2]
    return rows


DAMAGES = {
    "exchanged": (lambda p: (p[1], p[0]), "left_right_swapped"),
    "both upside down": (both(lambda i: np.ascontiguousarray(i[::-1, ::-1])), "left_right_swapped"),
    "one mirrored": (lambda p: (p[0], np.ascontiguousarray(p[1][:, ::-1])), "mirrored"),
    "one image twice": (lambda p: (p[0], p[0].copy()), "no_disparity"),
    "another scene": (lambda p: (p[0], window(ground(99), 0.0)), "nothing_corresponds"),
    "too dark": (both(lambda i: i // 8), "too_dark"),
    "too bright": (both(lambda i: cv2.convertScaleAbs(i, alpha=2.2)), "too_bright"),
    "one darker": (lambda p: (p[0], p[1] // 2), "exposures_differ"),
    "one black": (lambda p: (p[0], np.zeros_like(p[1])), "no_picture"),
    "out of focus": (both(lambda i: cv2.GaussianBlur(i, (0, 0), 2.0)), "blurred"),
    "smeared": (both(lambda i: cv2.blur(i, (13, 1))), "smeared"),
    "interlaced": (both(woven), "interlaced"),
}


@pytest.mark.parametrize(("damage", "code"), DAMAGES.values(), ids=DAMAGES)
def test_what_is_done_to_a_pair_is_found_with_a_remedy(damage, code):
    found = {j.code: j for j in judgements(about_pair(damage(pair()), CAMERA))}
    assert code in found
    assert found[code].remedy and "\n" not in found[code].finding


def test_a_plain_ground_tells_nothing_and_is_no_fault():
    plain = np.full((HEIGHT, WIDTH, 3), 206, np.uint8)
    cv2.line(plain, (40, 40), (400, 200), (150, 150, 150), 3)
    answers = about_pair((plain, np.roll(plain, -20, axis=1)), CAMERA)
    assert judgements(answers) == ()
    assert {a.question for a in answers if not a.is_known} >= {"rows", "rotation", "left and right", "exposure"}


def test_interlacing_is_told_by_the_images_as_they_came_and_not_of_one_colour():
    images = pair()
    assert "interlaced" in codes(images, raw=both(woven)(images))
    grey = np.full_like(images[0], 120)
    for eyes, named in (
        ((grey, grey), ["left", "right"]),
        ((grey, images[1]), ["left"]),
        ((images[0], grey), ["right"]),
    ):
        (answer,) = [a for a in about_pair(eyes, CAMERA) if a.question == INTERLACING]
        assert not answer.is_known
        assert [eye for eye in ("left", "right") if eye in answer.found] == named
