import dataclasses

import cv2
import numpy as np
import pytest

from agents.viewer import colours
from agents.viewer.picture import MARGIN_PX, WIDTH_PX, draw_picture
from schemas.messages import Image, ImageEncoding, Judgement, Severity

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


def test_the_picture_is_an_image_of_the_promised_width(scene):
    picture = draw_picture(scene.left, scene.right, scene.observations, scene.reconstruction)
    assert picture.dtype == np.uint8
    assert picture.shape[1:] == (WIDTH_PX, 3)
    assert 600 < picture.shape[0] < 1200


@pytest.mark.parametrize(("eye", "start"), [(0.0, 0), (5.5, WIDTH_PX - PANE)], ids=["left", "right"])
def test_the_thread_has_the_colours_of_its_confidence_where_it_projects(scene, eye, start):
    seen = dataclasses.replace(scene.reconstruction, unseen=np.zeros((0, 2)))
    unmarked = dataclasses.replace(scene.observations, points_camera=np.zeros((0, 3)), half_size_px=np.zeros((0, 2)))
    images = image_rows(draw_picture(scene.left, scene.right, unmarked, seen), scene)
    share = np.linspace(0.05, 0.95, 60)
    confidence = np.clip(1 - 0.95 * np.exp(-(((share - 0.62) / 0.12) ** 2)), 0, 1)
    u, v = places(scene, share, eye, start).T
    expected = np.column_stack([np.interp(confidence, [0, 0.5, 1], stops) for stops in colours.STOPS.T])
    found = images[v, u, ::-1].astype(float)
    assert np.abs(found - expected).max() < 40


def test_low_confidence_is_thinner_so_that_colours_are_not_all(scene):
    unmarked = dataclasses.replace(scene.observations, points_camera=np.zeros((0, 3)), half_size_px=np.zeros((0, 2)))

    def thread_pixels(value):
        confidence = np.full_like(scene.reconstruction.confidence, value)
        reconstruction = dataclasses.replace(scene.reconstruction, confidence=confidence)
        images = image_rows(draw_picture(scene.left, scene.right, unmarked, reconstruction), scene)
        bgr = colours.confidence_rgb(np.array([value]))[0, ::-1].astype(int)
        return (np.abs(images.astype(int) - bgr).max(axis=2) < 12).sum()

    assert thread_pixels(0.0) < 0.7 * thread_pixels(1.0)


def test_a_failure_shows_the_images_and_the_matches_but_no_thread(scene, failed):
    good = image_rows(draw_picture(scene.left, scene.right, scene.observations, scene.reconstruction), scene)
    images = image_rows(draw_picture(scene.left, scene.right, scene.observations, failed), scene)

    def count(picture, rgb):
        return (picture == rgb[::-1]).all(axis=2).sum()

    assert count(images, colours.KEPT) > 100
    assert count(images, colours.REJECTED) > 20
    assert count(good, colours.KEPT) == 0
    green = tuple(colours.STOPS[-1].astype(int).tolist())
    assert count(images, green) == 0
    assert count(good, green) > 100


def test_a_failure_shows_the_middle_of_the_thread_in_each_image(scene, refined, failed, nothing_seen):
    lines = refined.observations.centrelines_left, refined.observations.centrelines_right
    seen = dataclasses.replace(nothing_seen, centrelines_left=lines[0], centrelines_right=lines[1])
    dark = np.zeros_like(scene.left)
    images = image_rows(draw_picture(dark, dark, seen, failed), scene).min(axis=2)
    scale = PANE / scene.left.shape[1]
    for line, start in zip(lines, (0, WIDTH_PX - PANE), strict=True):
        u, v = np.rint((line.point_px + 0.5) * scale - 0.5).astype(int).T
        drawn = images[v, u + start] > 60
        assert drawn.mean() > 0.95
    hole = (
        int(lines[0].point_px[279:281].mean(axis=0)[0] * scale),
        int(lines[0].point_px[279:281].mean(axis=0)[1] * scale),
    )
    assert images[hole[1] - 2 : hole[1] + 3, hole[0] - 2 : hole[0] + 3].max() < 60


def test_the_mask_is_outlined(scene, failed):
    images = image_rows(draw_picture(scene.left, scene.right, scene.observations, failed), scene)
    cyan = (np.abs(images.astype(int) - colours.MASK[::-1]).max(axis=2) < 60).sum()
    assert cyan > 500


def test_each_grave_finding_adds_a_line_and_a_note_adds_none(scene):
    def height(*judgements):
        observations = dataclasses.replace(scene.observations, judgements=judgements)
        return len(draw_picture(scene.left, scene.right, observations, scene.reconstruction))

    warning = Judgement("W", Severity.WARNING, "Rows differ.", "Calibrate.")
    note = dataclasses.replace(warning, severity=Severity.NOTE)
    long = dataclasses.replace(warning, finding="Rows differ a lot. " * 30)
    assert height(note) == height()
    assert height(warning) > height()
    assert height(warning, warning) - height(warning) == height(warning) - height()
    assert height(long) > height(warning, warning)


def test_a_long_reason_is_wrapped(scene, failed):
    talkative = dataclasses.replace(failed, reason="the regions contradict each other " * 20)
    short = draw_picture(scene.left, scene.right, scene.observations, failed)
    long = draw_picture(scene.left, scene.right, scene.observations, talkative)
    assert len(long) > len(short) + 40


def test_what_a_method_says_of_its_trust_is_drawn_below_the_depth(scene, refined):
    plain = draw_picture(scene.left, scene.right, scene.observations, scene.reconstruction)
    predicted = draw_picture(scene.left, scene.right, scene.observations, refined.reconstruction)
    compared = draw_picture(scene.left, scene.right, refined.observations, scene.reconstruction)
    both = draw_picture(scene.left, scene.right, refined.observations, refined.reconstruction)
    assert len(plain) < len(predicted)
    assert len(plain) < len(compared)
    assert len(both) - len(plain) == len(predicted) - len(plain) + len(compared) - len(plain)


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


def test_thread_that_no_image_shows_is_grey(scene):
    unmarked = dataclasses.replace(scene.observations, points_camera=np.zeros((0, 3)), half_size_px=np.zeros((0, 2)))
    images = image_rows(draw_picture(scene.left, scene.right, unmarked, scene.reconstruction), scene)
    u, v = places(scene, np.linspace(0.57, 0.65, 60), 0.0, 0).T
    near = np.abs(images[v, u].astype(int) - colours.UNKNOWN[::-1]).max(axis=1) < 25
    assert near.mean() > 0.3
    u, v = places(scene, np.linspace(0.3, 0.5, 60), 0.0, 0).T
    assert not (np.abs(images[v, u].astype(int) - colours.UNKNOWN[::-1]).max(axis=1) < 25).any()


def test_nothing_at_all_can_be_drawn(scene, failed, nothing_seen):
    picture = draw_picture(scene.left, scene.right, nothing_seen, failed)
    assert picture.shape[1] == WIDTH_PX


def test_a_thread_without_confidence_is_grey(scene):
    none = np.zeros(0)
    unrated = dataclasses.replace(scene.reconstruction, confidence_s=none, confidence=none)
    images = image_rows(draw_picture(scene.left, scene.right, scene.observations, unrated), scene)
    assert (images == colours.UNKNOWN[::-1]).all(axis=2).sum() > 500


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (3, 2, 1), (1, 500), (500, 1, 3), (40, 60), (40, 60, 3)], ids=str)
def test_images_of_any_shape_can_be_drawn(scene, failed, shape):
    image = np.full(shape, 90, np.uint8)
    for reconstruction in (scene.reconstruction, failed):
        picture = draw_picture(image, image, scene.observations, reconstruction)
        assert picture.shape[1] == WIDTH_PX


def test_read_only_images_are_left_as_they_are(scene):
    left, right = scene.left.copy(), scene.right.copy()
    left.flags.writeable = right.flags.writeable = False
    draw_picture(left, right, scene.observations, scene.reconstruction)
    assert np.array_equal(left, scene.left)


def test_an_unreadable_mask_is_said_to_be_so(scene):
    mask = scene.observations.mask_left
    broken = Image(ImageEncoding.PNG, mask.width, mask.height, 1, b"no image")
    observations = dataclasses.replace(scene.observations, mask_left=broken)
    fine = image_rows(draw_picture(scene.left, scene.right, scene.observations, scene.reconstruction), scene)
    spoilt = image_rows(draw_picture(scene.left, scene.right, observations, scene.reconstruction), scene)
    assert not np.array_equal(fine[:20, :300], spoilt[:20, :300])


def test_points_far_outside_the_image_do_no_harm(scene):
    camera = dataclasses.replace(scene.reconstruction.camera, fx_px=1e12, fy_px=1e12)
    observations = dataclasses.replace(scene.observations, camera=camera)
    picture = draw_picture(scene.left, scene.right, observations, scene.reconstruction)
    assert picture.shape[1] == WIDTH_PX


def test_the_picture_can_be_saved_and_read(scene, tmp_path):
    picture = draw_picture(scene.left, scene.right, scene.observations, scene.reconstruction)
    path = str(tmp_path / "thread.png")
    assert cv2.imwrite(path, picture)
    found = cv2.imread(path)
    assert found is not None
    assert np.array_equal(found, picture)
