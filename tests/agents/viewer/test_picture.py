"""What a person sees of one reconstruction in one image."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.viewer import colours
from agents.viewer.image_pane import ascii_text, text_width, wrapped
from agents.viewer.picture import MARGIN_PX, WIDTH_PX, draw_picture
from schemas import messages
from schemas.messages import ImageEncoding, Occluder, Severity
from shared.images import encode_image
from tests.agents.viewer.conftest import BASELINE, HEIGHT, WIDTH, confidence_at, pixels, said_nothing

PANE = (WIDTH_PX - MARGIN_PX) // 2
SCALE = PANE / WIDTH
STARTS = (0, WIDTH_PX - PANE)
DARK = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
UNMARKED = {"points_camera": np.zeros((0, 3)), "half_size_px": np.zeros((0, 2))}
BARE = UNMARKED | dict.fromkeys(("centrelines_left", "centrelines_right"), messages.no_centrelines())
"""What is left out of observations, so that nothing is drawn over the thread."""


def images_of(observations, thread):
    """The rows of a picture on black that show the images: below its header, as high as the scaled image."""
    picture, height = draw_picture(DARK, DARK, observations, thread), round(HEIGHT * SCALE)
    beside = (picture[:, 3 * WIDTH_PX // 4] != colours.BACKGROUND[::-1]).any(axis=1)
    runs = np.lib.stride_tricks.sliding_window_view(beside, height).all(axis=1)
    top = int(np.flatnonzero(runs)[0])
    return picture[top : top + height].astype(int)


def shown_at(px, start=0):
    """Where pixels of an image lie in the picture."""
    u, v = np.rint((px + 0.5) * SCALE - 0.5).astype(int).T
    return v, u + start


def is_near(images, rgb, within):
    return np.abs(images - np.array(rgb)[::-1]).max(axis=-1) < within


def test_the_picture_is_an_image_of_the_promised_width_and_leaves_those_it_is_given_as_they_are(scene):
    left, right = scene.left.copy(), scene.right.copy()
    left.flags.writeable = right.flags.writeable = False
    good = draw_picture(left, right, scene.observations, scene.reconstruction)
    assert good.dtype == np.uint8
    assert good.shape[1:] == (WIDTH_PX, 3)
    assert 600 < good.shape[0] < 1400
    assert np.array_equal(draw_picture(left, right, scene.observations, scene.reconstruction), good)


def test_the_thread_has_the_colours_of_its_confidence_where_it_projects_and_is_grey_where_that_is_unknown(scene):
    def thread_at(share, eye=0, **changed):
        """What stands at these places of the true curve."""
        images = images_of(replace(scene.observations, **BARE), replace(scene.reconstruction, **changed))
        curve = np.column_stack([np.interp(share, scene.share, axis) for axis in scene.curve.T])
        return images[shown_at(pixels(curve, eye * BASELINE), STARTS[eye])]

    share = np.linspace(0.05, 0.95, 60)
    expected = np.column_stack([np.interp(confidence_at(share), [0, 0.5, 1], stops) for stops in colours.STOPS.T])
    for eye in (0, 1):
        assert np.abs(thread_at(share, eye, unseen=np.zeros((0, 2)))[:, ::-1] - expected).max() < 40
    assert is_near(thread_at(np.linspace(0.57, 0.65, 60)), colours.UNKNOWN, 25).mean() > 0.3
    assert not is_near(thread_at(np.linspace(0.3, 0.5, 60)), colours.UNKNOWN, 25).any()
    unrated = thread_at(share, confidence_s=np.zeros(0), confidence=np.zeros(0))
    assert is_near(unrated, colours.UNKNOWN, 25).mean() > 0.5


def test_a_failure_shows_the_mask_the_matches_and_the_middle_of_the_thread_but_no_thread(scene, failed, nothing_seen):
    good, images = images_of(scene.observations, scene.reconstruction), images_of(scene.observations, failed)
    for rgb, of_good, of_failed in ((colours.KEPT, 0, 100), (colours.REJECTED, 0, 20), (colours.STOPS[-1], 100, 0)):
        for shown, least in ((good, of_good), (images, of_failed)):
            count = is_near(shown, rgb, 1).sum()
            assert count > least if least else count == 0
    assert is_near(images, colours.MASK, 60).sum() > 500
    images = images_of(nothing_seen, failed).min(axis=2)
    lines = nothing_seen.centrelines_left, nothing_seen.centrelines_right
    for line, start in zip(lines, STARTS, strict=True):
        assert (images[shown_at(line.point_px, start)] > 60).mean() > 0.95
    u, v = (lines[0].point_px[279:281].mean(axis=0) * SCALE).astype(int)
    assert images[v - 2 : v + 3, u - 2 : u + 3].max() < 60, "a hole is left open"


def test_instruments_and_threads_that_are_not_meant_are_drawn_where_they_are(scene):
    tool = np.zeros((54, 96), np.uint8)
    tool[:20, :30] = Occluder.TOOL.value
    image = encode_image(tool, ImageEncoding.PNG)
    across = np.array([[100.0, 450.0], [860.0, 450.0]])
    meant = messages.ThreadCandidate(0.9, across - 400, across - 400, 4.0, np.array([20, 30, 40]))
    seen = {
        "occluders": messages.Occluders(image, image, 0),
        "candidates": (meant, replace(meant, score=0.25, left_px=across, right_px=across)),
    }
    plain = images_of(scene.observations, scene.reconstruction)
    shown = images_of(replace(scene.observations, **seen), scene.reconstruction)
    v, u = round(150 * SCALE), round(250 * SCALE)
    expected = 0.7 * plain[v, u] + 0.3 * np.array(colours.OCCLUDERS[Occluder.TOOL][::-1])
    assert shown[v, u] == pytest.approx(expected, abs=1)
    for start in STARTS:
        assert is_near(shown[round(450 * SCALE), start + round(200 * SCALE)], colours.candidate_rgb(1), 26)


def test_each_grave_finding_adds_a_line_a_note_none_and_what_a_method_says_of_its_trust_a_plot(scene, failed):
    def height(*judgements, thread=scene.reconstruction, **changed):
        return len(draw_picture(DARK, DARK, replace(scene.observations, judgements=judgements, **changed), thread))

    warning = messages.Judgement("W", Severity.WARNING, "Rows differ.", "Calibrate.")
    none, one = height(), height(warning)
    assert one > none
    assert height(replace(warning, severity=Severity.NOTE)) == none
    assert height(warning, warning) == 2 * one - none
    assert height(replace(warning, finding="Rows differ a lot. " * 30)) > 2 * one - none
    talkative = replace(failed, reason="the regions contradict each other " * 20)
    assert height(thread=talkative) > height(thread=failed) + 40
    silent = said_nothing(scene.reconstruction)
    neither, predicted, compared = height(thread=silent, **BARE), height(**BARE), height(thread=silent)
    assert predicted > neither < compared
    assert none - neither == predicted - neither + compared - neither


def test_a_curve_that_leaves_the_thread_has_red_whiskers_there_and_nowhere_else(scene):
    sure = replace(scene.reconstruction, confidence=np.ones_like(scene.reconstruction.confidence))
    red = is_near(images_of(replace(scene.observations, **UNMARKED), sure), colours.STOPS[0], 60)
    assert red[:, :PANE].sum() < 20
    right = red[:, -PANE:]
    assert right.sum() > 300
    _, end = shown_at(scene.observations.centrelines_right.point_px[-20])
    assert abs(float(np.median(np.flatnonzero(right.any(axis=0)))) - end) < 60


@pytest.mark.parametrize("shape", [(1, 1), (3, 2, 1), (1, 500), (500, 1, 3)], ids=str)
def test_images_of_any_shape_can_be_drawn_whatever_was_seen_in_them(scene, failed, nothing_seen, shape):
    image = np.full(shape, 90, np.uint8)
    camera = replace(failed.camera, fx_px=1e12, fy_px=1e12)
    broken = messages.Image(ImageEncoding.PNG, 2**31, 2**31, 1, b"no image")
    far = replace(scene.observations, camera=camera, mask_left=broken)
    for observations, reconstruction in ((far, scene.reconstruction), (nothing_seen, failed)):
        assert draw_picture(image, image, observations, reconstruction).shape[1] == WIDTH_PX


@given(text=st.text(max_size=80), width=st.integers(40, 400))
def test_any_text_is_wrapped_to_lines_of_printable_ascii_that_fit_and_lose_no_letter(text, width):
    assert ascii_text("30° ± 2 µm − café × 3 — „ε_z“ 糸") == '30 deg +- 2 um - cafe x 3 - "eps_z" ?'
    lines = wrapped(text, width)
    assert all(text_width(line) <= width for line in lines)
    assert all(" " <= letter <= "~" for letter in "".join(lines))
    assert "".join(lines).replace(" ", "") == ascii_text(text).replace(" ", "")
