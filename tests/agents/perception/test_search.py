"""A thread that moves is followed near where it was; whatever could make that wrong has the whole images looked at."""

import dataclasses
import functools

import numpy as np
import pytest

from agents.perception.search import (
    FRAMES_BETWEEN_LOOKS,
    LONGEST_GAP,
    MARGIN_SHARE,
    is_brighter,
    look_everywhere,
    look_near,
    may_lack_thread,
    near_thread,
)
from schemas.messages import (
    FrameStamp,
    ImageEncoding,
    Judgement,
    RectifiedStereo,
    Severity,
    Status,
    ThreadObservations,
)
from shared.images import encode_image
from shared.scene.__main__ import make_scene
from shared.scene.render import render

WIDTH, HEIGHT = 480, 270


@functools.cache
def tissue():
    pair = render(make_scene("medium", "tissue", 32, "violet"))
    return pair.left_bgr, pair.right_bgr


def moved(images, right, down):
    left, other = (np.roll(image, (down, right), axis=(0, 1)) for image in images)
    return left, other


def seen(images, looked, sequence=0, judgements=()):
    """The observations of a frame in which this was segmented, as far as the next one needs them."""
    nothing = np.zeros((0, 3))
    return ThreadObservations(
        stamp=FrameStamp(sequence, 0, 0, ""),
        camera=RectifiedStereo(images[0].shape[1], images[0].shape[0], 1000.0, 1000.0, 400.0, 300.0, 5e-3, 1.0),
        status=Status.OK,
        reason="",
        segmenter=looked.segmenter,
        points_camera=nothing,
        half_size_px=nothing[:, :2],
        matched_px=nothing,
        match_cost=nothing[:, :2],
        inlier=np.zeros(0, bool),
        mask_left=encode_image(looked.coverage[0], ImageEncoding.PNG),
        mask_right=encode_image(looked.coverage[1], ImageEncoding.PNG),
        judgements=judgements,
        looked_sequence=looked.looked_sequence,
        is_bright=looked.is_bright,
        prompt_px=looked.prompt_px,
    )


def line(column, rows=slice(60, 200)):
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[rows, column : column + 3] = 255
    return mask


def overlap(a, b):
    return ((a > 0) & (b > 0)).sum() / ((a > 0) | (b > 0)).sum()


@pytest.mark.slow
def test_who_is_slow_looks_at_the_whole_no_more_often_than_at_every_fourth_frame():
    images = tissue()
    first = seen(images, look_everywhere(images, 0))
    looked = look_near(images, first, 29)
    assert looked is not None
    # it is time again, and then so many frames were looked at near too
    few, enough = (
        dataclasses.replace(seen(images, looked, FRAMES_BETWEEN_LOOKS - 10), frames_since_look=count)
        for count in (3, 4)
    )
    assert look_near(images, few, FRAMES_BETWEEN_LOOKS) is not None
    assert look_near(images, enough, FRAMES_BETWEEN_LOOKS) is None
    assert look_near(images, enough, FRAMES_BETWEEN_LOOKS - 1) is not None


def test_bright_and_dark_threads_are_told_apart():
    for thread, ground in ((30, 200), (220, 90)):
        image = np.where(line(200)[:, :, None] > 0, thread, ground).repeat(3, axis=2).astype(np.uint8)
        assert is_brighter(image, line(200)) == (thread > ground)


@pytest.mark.slow
def test_judgements_that_are_carried_on_say_once_when_they_were_made():
    images = tissue()
    warning = Judgement("row_residual", Severity.WARNING, "rows lie apart", "calibrate again")
    last = seen(images, look_everywhere(images, 12), 12, (warning,))
    for sequence in (13, 14):
        looked = look_near(images, last, sequence)
        assert looked is not None
        assert looked.judgements == (dataclasses.replace(warning, finding="rows lie apart (judged in frame 12)"),)
        last = seen(images, looked, sequence, looked.judgements)


@pytest.mark.slow
def test_a_thread_that_moves_is_followed_step_by_step_and_one_that_jumps_away_is_looked_for_everywhere():
    images = tissue()
    last = first = seen(images, look_everywhere(images, 0))
    for step in range(1, 4):
        now = moved(images, 8 * step, -6 * step)
        looked = look_near(now, last, step)
        assert looked is not None
        assert looked.looked_sequence == 0
        for near, whole in zip(looked.coverage, look_everywhere(now, 0, looked.segmenter).coverage, strict=True):
            assert overlap(near, whole) > 0.9
        last = seen(now, looked, step)
    assert look_near(moved(images, 0, round(2.5 * MARGIN_SHARE * images[0].shape[1])), first, 1) is None


def test_thread_at_the_border_of_what_was_looked_at_or_less_of_it_has_everything_looked_at():
    near, pixels = near_thread(line(200)), int((line(200) > 0).sum())
    assert not may_lack_thread(line(200), near, pixels)
    assert not may_lack_thread(line(200, slice(60, 190)), near, pixels)
    assert may_lack_thread(line(200, slice(60, 140)), near, pixels)
    assert may_lack_thread(line(200, slice(60, 225)) & np.where(near, 255, 0).astype(np.uint8), near, pixels)
    # beyond the border of the image itself it cannot go on
    whole = line(200, slice(0, HEIGHT))
    assert not may_lack_thread(whole, near_thread(whole), int((whole > 0).sum()))


def test_after_a_gap_and_after_a_restart_of_the_camera_everything_is_looked_at():
    last = seen(tissue(), look_everywhere(tissue(), 0))
    assert look_near(tissue(), last, LONGEST_GAP - 1) is not None
    for sequence in (LONGEST_GAP, 0, -5):
        assert look_near(tissue(), last, sequence) is None
