"""Pairs that are whole raise no alarm; what is done to them is found with its remedy, or put in line within bounds."""

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.perception.judging.alignment import about_distance, about_rotation, about_rows, about_sides, about_sizes
from agents.perception.judging.answers import judgements
from agents.perception.judging.correspondence import Correspondence, correspondence_of_texture
from agents.perception.judging.pair import about_pair
from agents.perception.judging.picture import INTERLACING
from agents.perception.judging.whole import judge_whole
from schemas.messages import RectifiedStereo, RightEye, Severity
from shared.disparities import disparities
from shared.rendering.render import ENDOSCOPE
from shared.right_eye import from_in_line, moved

HEIGHT, WIDTH = 270, 480
CAMERA = RectifiedStereo(WIDTH, HEIGHT, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)
LARGE = replace(ENDOSCOPE, cx_px=450.0, cy_px=280.0)
WARNING, FAULT = Severity.WARNING, Severity.FAULT


@functools.cache
def ground(seed, height, width):
    """Tissue-like: blotches, and small bright glints with sharp edges."""
    rng = np.random.default_rng(seed)
    coarse, fine = (
        cv2.GaussianBlur(rng.standard_normal((height, width, 3)).astype(np.float32), (0, 0), s) for s in (12.0, 2.0)
    )
    image = 120 + 30 * coarse / coarse.std() + 12 * fine / fine.std()
    for _ in range(height * width // 1500):
        centre, axes = rng.integers(0, (width, height)), rng.integers(2, 9, 2)
        colour = (230, 235, 240) if rng.random() < 0.5 else (40, 30, 60)
        cv2.ellipse(image, centre.tolist(), axes.tolist(), float(rng.integers(180)), 0, 360, colour, -1, cv2.LINE_AA)
    return image


def window(image, camera, M, noise_seed=0):
    """What an eye sees of the ground by a 2x3 matrix, with its noise."""
    size = camera.image_width, camera.image_height
    noise = np.random.default_rng(noise_seed).normal(0, 1.5, (*size[::-1], 3))
    return np.clip(cv2.warpAffine(image, M, size, flags=cv2.INTER_LINEAR) + noise, 0, 255).astype(np.uint8)


def to_the_left(px, down_px=0.0):
    return np.array([[1.0, 0.0, -px], [0.0, 1.0, -down_px]])


def pair(seed=0, down_px=0.0, turned_deg=0.0, larger=1.0):
    """The ground 30 px apart, of which the right eye lies otherwise."""
    image = ground(seed, HEIGHT + 80, WIDTH + 160)
    M = cv2.getRotationMatrix2D(((WIDTH - 1) / 2, (HEIGHT - 1) / 2), -turned_deg, larger)
    M[:, 2] += M[:, :2] @ (-110.0, -40.0) + (0.0, down_px)
    return window(image, CAMERA, to_the_left(80.0, 40.0)), window(image, CAMERA, M, 1)


def both(change):
    return lambda images: (change(images[0]), change(images[1]))


def woven(image):
    rows = image.copy()
    rows[1::2] = np.roll(image, 4, axis=1)[1::2]
    return rows


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
    tilt_px = 30.0 * np.sin(np.radians(turned_deg))
    assert seen.row_residual_px == pytest.approx(-down_px, abs=0.25 + abs(tilt_px))
    assert seen.rotation_deg == pytest.approx(turned_deg, abs=0.06)
    assert seen.magnification == pytest.approx(larger, abs=2e-3)
    assert seen.row_deviation_px is not None and seen.row_deviation_px < 0.2


DAMAGES = {
    "exchanged": (lambda p: (p[1], p[0]), "left_right_swapped"),
    "both upside down": (both(lambda i: np.ascontiguousarray(i[::-1, ::-1])), "left_right_swapped"),
    "one upside down": (lambda p: (p[0], np.ascontiguousarray(p[1][::-1, ::-1])), "rotated"),
    "one mirrored": (lambda p: (p[0], np.ascontiguousarray(p[1][:, ::-1])), "mirrored"),
    "one image twice": (lambda p: (p[0], p[0].copy()), "no_disparity"),
    "another scene": (lambda p: (p[0], pair(99)[0]), "nothing_corresponds"),
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
    assert "interlaced" in {j.code for j in judgements(about_pair(images, CAMERA, both(woven)(images)))}
    (answer,) = [a for a in about_pair((images[0], np.full_like(images[0], 120)), CAMERA) if a.question == INTERLACING]
    assert not answer.is_known
    assert [eye for eye in ("left", "right") if eye in answer.found] == ["right"]


WELL = Correspondence(
    row_residual_px=0.1,
    disparity_px=55.0,
    row_deviation_px=0.05,
    rotation_deg=0.01,
    rotation_deviation_deg=0.01,
    magnification=1.0,
    magnification_deviation=1e-4,
    off_rows_px=0.2,
    nearest_px=60.0,
    farthest_px=50.0,
    matches=300,
)
NO_UNIT = replace(ENDOSCOPE, metres_per_unit=None)


def but(**changes):
    return replace(WELL, **changes)


@pytest.mark.parametrize(
    ("answer", "code", "severity"),
    [
        (about_distance(but(disparity_px=13.0, nearest_px=13.0), ENDOSCOPE), "distance_implausible", WARNING),
        (about_distance(but(disparity_px=13.8, nearest_px=13.8), ENDOSCOPE), None, None),
        # below a centimetre
        (about_distance(WELL, replace(ENDOSCOPE, baseline=0.4)), "distance_implausible", WARNING),
        (about_distance(but(disparity_px=1.0, nearest_px=1.0), NO_UNIT), None, None),
        # nearer than is searched, whatever the unit
        (about_distance(but(nearest_px=500.0), ENDOSCOPE), "disparity_range", WARNING),
        (about_distance(but(nearest_px=500.0), NO_UNIT), "disparity_range", WARNING),
        (about_sides(but(disparity_px=4.0, farthest_px=-9.0, behind_share=0.2)), "disparity_sign", WARNING),
        (about_sides(but(behind_share=0.09)), None, None),
        (about_rows(but(row_residual_px=1.5), 540), "row_residual", WARNING),
        # from one percent of the height on
        (about_rows(but(row_residual_px=-5.5), 540), "row_residual", FAULT),
        (about_rows(but(off_rows_px=1.2), 540), "row_residual", WARNING),
        (about_rotation(but(rotation_deg=0.3), 540, 960), "rotated", WARNING),
        (about_rotation(but(rotation_deg=-0.8), 540, 960), "rotated", FAULT),
        (about_sizes(but(magnification=1.01), 540), "sizes_differ", WARNING),
        (about_sizes(but(magnification=0.97), 540), "sizes_differ", FAULT),
        # within its doubt nothing is called wrong
        (about_rotation(but(rotation_deg=0.3, rotation_deviation_deg=0.1), 540, 960), None, None),
        (about_sizes(but(magnification=1.01, magnification_deviation=0.003), 540), None, None),
    ],
)
def test_what_is_certain_is_a_warning_or_a_fault_with_its_remedy(answer, code, severity):
    wrong = answer.wrong
    assert (code, severity) == ((None, None) if wrong is None else (wrong.code, wrong.severity))
    assert wrong is None or wrong.remedy


def test_what_cannot_be_told_is_unknown():
    for seen in (but(disparity_px=-20.0), but(nearest_px=None)):
        assert not about_distance(seen, ENDOSCOPE).is_known
    rows = about_rows(but(row_residual_px=1.5, off_rows_px=None, row_deviation_px=0.4), 540)
    assert not rows.is_known
    assert "leave 0.4 px of doubt" in rows.found
    assert "most things would be 1100 mm away" in about_distance(but(disparity_px=5.0), ENDOSCOPE).found


def out_of_line(eye=None, disparity_px=60.0, seed=1):
    """The ground 60 px apart, the right eye out of line by so much."""
    image = ground(seed, 540, 1920)
    by, shift = (np.vstack((part, (0, 0, 1))) for part in (from_in_line(eye, LARGE), to_the_left(200 + disparity_px)))
    return window(image, LARGE, to_the_left(200.0)), window(image, LARGE, (by @ shift)[:2], seed)


def judged(images, before=None):
    return judge_whole(images, images, LARGE, before)


EYE = RightEye(1.6, 0.3, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("eye", [EYE, RightEye(-2.0, -0.4, 1.004)])
def test_an_eye_out_of_line_is_put_in_line_and_said_to_be(eye):
    found = judged(out_of_line(eye))
    assert found.right_eye is not None
    corners = np.array([(0, 0), (959, 0), (0, 539), (959, 539)], float)
    off = moved(corners, from_in_line(found.right_eye, LARGE)) - moved(corners, from_in_line(eye, LARGE))
    assert np.abs(off[:, 1]).max() < 0.35
    assert [(j.code, j.severity) for j in found.offset] == [("row_offset", WARNING)]
    assert found.alignment == ()
    after = judged(found.images)
    assert (after.offset, after.alignment or ()) == ((), ())


@pytest.mark.parametrize("eye", [RightEye(0.0, 0.9, 1.0), RightEye(9.0, 0.0, 1.0), RightEye(0.0, 0.0, 1.03)])
def test_beyond_its_bounds_nothing_is_mended_and_the_pair_is_at_fault(eye):
    found = judged(out_of_line(eye))
    assert found.right_eye is None
    assert any(j.severity is FAULT and j.remedy for j in found.alignment or ())


@pytest.mark.slow
def test_what_was_put_in_line_stays_while_it_moves_no_corner_by_much():
    before = judged(out_of_line(EYE)).right_eye
    near, other = (RightEye(EYE.rows_px + 0.2, EYE.turned_deg + 0.02, 1.0), RightEye(1.6, 0.5, 1.0))
    assert judged(out_of_line(near, seed=2), before).right_eye == before
    assert judged(out_of_line(other, seed=2), before).right_eye != before


@pytest.mark.parametrize("disparity_px", [30.0, 330.0])
def test_a_pair_shows_at_which_disparities_thread_may_be_on_any_rig(disparity_px):
    shown = judged(out_of_line(disparity_px=disparity_px)).disparities_px
    assert shown is not None
    least, most = shown
    assert least < 0.7 * disparity_px and 1.4 * disparity_px < most < 1.6 * disparity_px
    reach = disparities(960, np.array([least, most]))
    assert (reach.least_px, reach.most_px) == (least, most)
    # what no rig can have is no range
    for told in ((50.0, 20.0), (np.nan, 3.0), (700.0, 900.0)):
        assert disparities(960, np.array(told)) == disparities(960)
