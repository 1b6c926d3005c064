"""A thread that moves is followed near where it was; whatever could make that wrong has the whole images looked at."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agents.perception.observe import observe
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
from schemas.messages import FrameStamp, Judgement, Severity
from tests.agents.perception.pictures import moved, rendered, rendered_pair

WIDTH, HEIGHT = 480, 270
TISSUE = "medium", 32


def seen(images, looked, sequence=0, judgements=()):
    """The observations of a frame in which this was segmented."""
    stamp, (camera, _) = FrameStamp(sequence, 0, 0, ""), rendered(*TISSUE)
    eyes: Any = *images, *looked.coverage
    found = observe(stamp, camera, *eyes, segmenter=looked.segmenter, judged=judgements, matching=False)
    return replace(found, looked_sequence=looked.looked_sequence, is_bright=looked.is_bright)


def line(column, rows=slice(60, 200)):
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[rows, column : column + 3] = 255
    return mask


@pytest.mark.slow
def test_the_whole_is_looked_at_after_enough_frames_a_gap_or_a_restart_and_no_more_often_by_who_is_slow():
    images = rendered_pair(*TISSUE)
    first = seen(images, look_everywhere(images, 0))
    looked = look_near(images, first, 29)
    assert looked is not None
    assert look_near(images, first, LONGEST_GAP - 1) is not None
    for sequence in (LONGEST_GAP, 0, -5):
        assert look_near(images, first, sequence) is None
    # it is time again, and then so many frames were looked at near too
    last = seen(images, looked, FRAMES_BETWEEN_LOOKS - 10)
    few, enough = (replace(last, frames_since_look=count) for count in (3, 4))
    assert look_near(images, few, FRAMES_BETWEEN_LOOKS) is not None
    assert look_near(images, enough, FRAMES_BETWEEN_LOOKS) is None
    assert look_near(images, enough, FRAMES_BETWEEN_LOOKS - 1) is not None


def test_bright_and_dark_threads_are_told_apart():
    for thread, ground in ((30, 200), (220, 90)):
        image = np.where(line(200)[:, :, None] > 0, thread, ground).repeat(3, axis=2).astype(np.uint8)
        assert is_brighter(image, line(200)) == (thread > ground)


@pytest.mark.slow
def test_a_thread_that_moves_is_followed_step_by_step_and_one_that_jumps_away_is_looked_for_everywhere():
    images, warning = rendered_pair(*TISSUE), Judgement("row_residual", Severity.WARNING, "rows lie apart", "calibrate")
    last = first = seen(images, look_everywhere(images, 12), 12, (warning,))
    for step in range(1, 4):
        now = moved(images, 8 * step, -6 * step)
        looked = look_near(now, last, 12 + step)
        assert looked is not None
        assert looked.looked_sequence == 12
        # what is carried on says once when it was judged
        assert looked.judgements == (replace(warning, finding="rows lie apart (judged in frame 12)"),)
        for near, whole in zip(looked.coverage, look_everywhere(now, 0, looked.segmenter).coverage, strict=True):
            assert ((near > 0) & (whole > 0)).sum() > 0.9 * ((near > 0) | (whole > 0)).sum()
        last = seen(now, looked, 12 + step, looked.judgements)
    assert look_near(moved(images, 0, round(2.5 * MARGIN_SHARE * images[0].shape[1])), first, 13) is None


def test_thread_at_the_border_of_what_was_looked_at_or_less_of_it_has_everything_looked_at():
    near, pixels = near_thread(line(200)), int((line(200) > 0).sum())
    assert not may_lack_thread(line(200), near, pixels)
    assert not may_lack_thread(line(200, slice(60, 190)), near, pixels)
    assert may_lack_thread(line(200, slice(60, 140)), near, pixels)
    assert may_lack_thread(line(200, slice(60, 225)) & np.where(near, 255, 0).astype(np.uint8), near, pixels)
    # beyond the border of the image itself it cannot go on
    whole = line(200, slice(0, HEIGHT))
    assert not may_lack_thread(whole, near_thread(whole), int((whole > 0).sum()))
