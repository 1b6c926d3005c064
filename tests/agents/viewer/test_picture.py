import dataclasses

import numpy as np
import pytest

from agents.viewer import colours
from agents.viewer.picture import MARGIN_PX, WIDTH_PX, draw_picture
from schemas.messages import Image, ImageEncoding, Judgement, Occluder, Occluders, Severity, ThreadCandidate
from shared.images import encode_image

PANE = (WIDTH_PX - MARGIN_PX) // 2


def image_rows(picture, scene):
    """The rows of a picture that show the images: below its header, as high as the scaled image."""
    height = round(scene.left.shape[0] * PANE / scene.left.shape[1])
    beside = (picture[:, 3 * WIDTH_PX // 4] != colours.BACKGROUND[::-1]).any(axis=1)
    runs = np.lib.stride_tricks.sliding_window_view(beside, height).all(axis=1)
    top = int(np.flatnonzero(runs)[0])
    return picture[top : top + height]


def places(scene, share, eye, start):
    """Where the true curve lies in the picture at these shares of its length."""
    lengths = np.concatenate(([0], np.cumsum(np.linalg.norm(np.diff(scene.curve, axis=0), axis=1))))
    x, y, z = (np.interp(share, lengths / lengths[-1], axis) for axis in scene.curve.T)
    scale = PANE / scene.left.shape[1]
    u = (1000.0 * (x - eye) / z + 479.5 + 0.5) * scale - 0.5 + start
    v = (1000.0 * y / z + 269.5 + 0.5) * scale - 0.5
    return np.rint(np.column_stack((u, v))).astype(int)


@pytest.fixture(scope="module")
def good(scene):
    """The picture of a good reconstruction."""
    return draw_picture(scene.left, scene.right, scene.observations, scene.reconstruction)


@pytest.fixture(scope="module")
def unmarked(scene):
    """Observations that are not drawn over the thread."""
    return dataclasses.replace(scene.observations, points_camera=np.zeros((0, 3)), half_size_px=np.zeros((0, 2)))


def test_the_picture_is_an_image_of_the_promised_width_and_leaves_those_it_is_given_as_they_are(scene, good):
    assert good.dtype == np.uint8
    assert good.shape[1:] == (WIDTH_PX, 3)
    assert 600 < good.shape[0] < 1200
    left, right = scene.left.copy(), scene.right.copy()
    left.flags.writeable = right.flags.writeable = False
    assert np.array_equal(draw_picture(left, right, scene.observations, scene.reconstruction), good)


def test_the_thread_has_the_colours_of_its_confidence_where_it_projects(scene, unmarked):
    seen = dataclasses.replace(scene.reconstruction, unseen=np.zeros((0, 2)))
    images = image_rows(draw_picture(scene.left, scene.right, unmarked, seen), scene)
    share = np.linspace(0.05, 0.95, 60)
    confidence = np.clip(1 - 0.95 * np.exp(-(((share - 0.62) / 0.12) ** 2)), 0, 1)
    expected = np.column_stack([np.interp(confidence, [0, 0.5, 1], stops) for stops in colours.STOPS.T])
    for eye, start in ((0.0, 0), (5.5, WIDTH_PX - PANE)):
        u, v = places(scene, share, eye, start).T
        assert np.abs(images[v, u, ::-1].astype(float) - expected).max() < 40


def test_a_failure_shows_the_images_the_mask_and_the_matches_but_no_thread(scene, good, failed):
    good = image_rows(good, scene)
    images = image_rows(draw_picture(scene.left, scene.right, scene.observations, failed), scene)

    def count(picture, rgb):
        return (picture == rgb[::-1]).all(axis=2).sum()

    assert count(images, colours.KEPT) > 100
    assert count(images, colours.REJECTED) > 20
    assert count(good, colours.KEPT) == 0
    green = tuple(colours.STOPS[-1].astype(int).tolist())
    assert count(images, green) == 0
    assert count(good, green) > 100
    assert (np.abs(images.astype(int) - colours.MASK[::-1]).max(axis=2) < 60).sum() > 500


def test_a_failure_shows_the_middle_of_the_thread_in_each_image(scene, refined, failed, nothing_seen):
    lines = refined.observations.centrelines_left, refined.observations.centrelines_right
    seen = dataclasses.replace(nothing_seen, centrelines_left=lines[0], centrelines_right=lines[1])
    dark = np.zeros_like(scene.left)
    images = image_rows(draw_picture(dark, dark, seen, failed), scene).min(axis=2)
    scale = PANE / scene.left.shape[1]
    for line, start in zip(lines, (0, WIDTH_PX - PANE), strict=True):
        u, v = np.rint((line.point_px + 0.5) * scale - 0.5).astype(int).T
        assert (images[v, u + start] > 60).mean() > 0.95
    u, v = (lines[0].point_px[279:281].mean(axis=0) * scale).astype(int)
    assert images[v - 2 : v + 3, u - 2 : u + 3].max() < 60, "a hole is left open"


def test_instruments_and_threads_that_are_not_meant_are_drawn_where_they_are(scene):
    tool = np.zeros((54, 96), np.uint8)
    tool[:20, :30] = Occluder.TOOL.value
    image = encode_image(tool, ImageEncoding.PNG)
    occluders = Occluders(image, image, 0)
    across = np.array([[100.0, 450.0], [860.0, 450.0]])
    meant = ThreadCandidate(0.9, across - 400, across - 400, 4.0, np.array([20, 30, 40]))
    other = dataclasses.replace(meant, score=0.25, left_px=across, right_px=across)
    dark = np.zeros_like(scene.left)
    plain, shown = (
        image_rows(draw_picture(dark, dark, observations, scene.reconstruction), scene).astype(int)
        for observations in (
            scene.observations,
            dataclasses.replace(scene.observations, occluders=occluders, candidates=(meant, other)),
        )
    )
    scale = PANE / scene.left.shape[1]
    v, u = round(150 * scale), round(250 * scale)
    expected = 0.7 * plain[v, u] + 0.3 * np.array(colours.OCCLUDERS[Occluder.TOOL][::-1])
    assert shown[v, u] == pytest.approx(expected, abs=1)
    for start in (0, WIDTH_PX - PANE):
        line = shown[round(450 * scale), start + round(200 * scale)]
        assert line == pytest.approx(np.array(colours.candidate_rgb(1)[::-1]), abs=25)


@pytest.mark.slow
def test_each_grave_finding_adds_a_line_a_note_none_and_a_long_text_is_wrapped(scene, failed):
    def height(*judgements, reconstruction=scene.reconstruction):
        observations = dataclasses.replace(scene.observations, judgements=judgements)
        return len(draw_picture(scene.left, scene.right, observations, reconstruction))

    warning = Judgement("W", Severity.WARNING, "Rows differ.", "Calibrate.")
    note = dataclasses.replace(warning, severity=Severity.NOTE)
    long = dataclasses.replace(warning, finding="Rows differ a lot. " * 30)
    one = height(warning)
    line = one - height()
    assert line > 0
    assert height(note) == height()
    assert height(warning, warning) == one + line
    assert height(long) > one + line
    talkative = dataclasses.replace(failed, reason="the regions contradict each other " * 20)
    assert height(reconstruction=talkative) > height(reconstruction=failed) + 40


def test_what_a_method_says_of_its_trust_is_drawn_below_the_depth(scene, refined, good):
    predicted = draw_picture(scene.left, scene.right, scene.observations, refined.reconstruction)
    compared = draw_picture(scene.left, scene.right, refined.observations, scene.reconstruction)
    both = draw_picture(scene.left, scene.right, refined.observations, refined.reconstruction)
    assert len(good) < len(predicted)
    assert len(good) < len(compared)
    assert len(both) - len(good) == len(predicted) - len(good) + len(compared) - len(good)


def test_a_curve_that_leaves_the_thread_has_red_whiskers_there_and_nowhere_else(scene, refined):
    unmarked = dataclasses.replace(refined.observations, points_camera=np.zeros((0, 3)), half_size_px=np.zeros((0, 2)))
    sure = dataclasses.replace(scene.reconstruction, confidence=np.ones_like(scene.reconstruction.confidence))
    dark = np.zeros_like(scene.left)
    images = image_rows(draw_picture(dark, dark, unmarked, sure), scene)
    red = np.abs(images.astype(int) - colours.STOPS[0, ::-1]).max(axis=2) < 60
    assert red[:, :PANE].sum() < 20
    right = red[:, -PANE:]
    assert right.sum() > 300
    end_px = places(scene, np.array([0.95]), 5.5, 0)[0]
    columns = np.flatnonzero(right.any(axis=0))
    assert abs(float(np.median(columns)) - end_px[0]) < 60


def test_thread_that_no_image_shows_or_without_confidence_is_grey(scene, unmarked):
    images = image_rows(draw_picture(scene.left, scene.right, unmarked, scene.reconstruction), scene)

    def grey(begin, end):
        u, v = places(scene, np.linspace(begin, end, 60), 0.0, 0).T
        return np.abs(images[v, u].astype(int) - colours.UNKNOWN[::-1]).max(axis=1) < 25

    assert grey(0.57, 0.65).mean() > 0.3
    assert not grey(0.3, 0.5).any()
    none = np.zeros(0)
    unrated = dataclasses.replace(scene.reconstruction, confidence_s=none, confidence=none)
    images = image_rows(draw_picture(scene.left, scene.right, scene.observations, unrated), scene)
    assert (images == colours.UNKNOWN[::-1]).all(axis=2).sum() > 500


@pytest.mark.parametrize("shape", [(1, 1), (3, 2, 1), (1, 500), (500, 1, 3), (40, 60)], ids=str)
def test_images_of_any_shape_can_be_drawn_whatever_was_seen_in_them(scene, failed, nothing_seen, shape):
    image = np.full(shape, 90, np.uint8)
    camera = dataclasses.replace(failed.camera, fx_px=1e12, fy_px=1e12)
    broken = Image(ImageEncoding.PNG, 2**31, 2**31, 1, b"no image")
    far = dataclasses.replace(scene.observations, camera=camera, mask_left=broken)
    for observations, reconstruction in ((far, scene.reconstruction), (nothing_seen, failed)):
        assert draw_picture(image, image, observations, reconstruction).shape[1] == WIDTH_PX
