"""What is done beside finding the thread: each as often as it should be, and never so much that frames are left out."""

import dataclasses
import itertools
from collections import Counter

import pytest

from agents.perception.due import FRAMES_BETWEEN, GLANCES_AFTER_LOOK, LONGEST_REST, OLDEST_S, REST, Due, due
from schemas.topics import FRAMES, SURFACE
from tests.agents.perception.test_told_apart import observed, told

RATE_HZ = FRAMES.rate_hz or 30.0


def later(stamp, sequence, rate_hz):
    """The stamp of another frame of a camera."""
    return dataclasses.replace(stamp, sequence=sequence, capture_left_ns=round(sequence * 1e9 / rate_hz))


def done_over(frames, step, last=None, is_watched=True, rate_hz=RATE_HZ):
    """What was done in which frame of the camera, of which so many are left out."""
    last = last or told(observed())
    done = {}
    for sequence in range(step, frames, step):
        stamp = later(last.stamp, sequence, rate_hz)
        what = due(stamp, last, is_watched)
        if what is not None:
            done[sequence] = what
        seen = {
            Due.JUDGED: {"judged_sequence": sequence},
            Due.GLANCE: {"glanced_sequence": sequence},
            Due.OCCLUDERS: {"occluders": dataclasses.replace(last.occluders, sequence=sequence)},
            Due.SURFACE: {"surface_sequence": sequence},
        }
        last = dataclasses.replace(last, stamp=stamp, **(seen[what] if what else {}))
    return done


def test_each_is_done_as_often_as_it_should_where_every_frame_is_seen():
    done = done_over(600, 1)
    for what, between in FRAMES_BETWEEN.items():
        at = [sequence for sequence, one in done.items() if one is what]
        begun = GLANCES_AFTER_LOOK if what is Due.GLANCE else 0
        assert (600 - begun) / len(at) == pytest.approx(between, rel=0.3)
        assert max(b - a for a, b in itertools.pairwise(at)) <= between + 2 * REST + 2


@pytest.mark.parametrize("step", [1, 2, 3, 10])
def test_frames_without_anything_lie_between_and_nothing_is_left_undone(step):
    at = list(done := done_over(6000, step))
    assert min(b - a for a, b in itertools.pairwise(at) if done[b] is not Due.SURFACE) > min(REST * step, LONGEST_REST)
    share = {what: count * FRAMES_BETWEEN[what] for what, count in Counter(done.values()).items()}
    assert share.keys() == FRAMES_BETWEEN.keys()
    # where there is no time for all, each comes later by about as much, but the tissue never too late to plan by
    assert max(share.values()) < 1.6 * min(share.values())
    tissue = [sequence for sequence, one in done.items() if one is Due.SURFACE]
    assert max(b - a for a, b in itertools.pairwise(tissue)) <= OLDEST_S[Due.SURFACE] * RATE_HZ + (REST + 1) * step


@pytest.mark.parametrize("rate_hz", [2.0, 5.0, 15.0])
def test_the_tissue_is_never_too_old_to_plan_by_however_slow_the_camera(rate_hz):
    tissue = [sequence for sequence, one in done_over(300, 1, rate_hz=rate_hz).items() if one is Due.SURFACE]
    assert SURFACE.maximum_age_ms is not None
    assert max(b - a for a, b in itertools.pairwise(tissue)) / rate_hz < 1e-3 * SURFACE.maximum_age_ms


def test_only_the_surface_and_what_may_hide_thread_are_made_beside_what_is_not_followed():
    assert set(done_over(200, 1, is_watched=False).values()) == {Due.OCCLUDERS, Due.SURFACE}
    plain = dataclasses.replace(told(observed()), surface_sequence=None)
    assert due(later(plain.stamp, 1, RATE_HZ), plain, False) is Due.SURFACE


def test_what_is_due_comes_at_once_where_the_camera_begins_again():
    last = dataclasses.replace(told(observed(400)), surface_sequence=395)
    assert due(later(last.stamp, 0, RATE_HZ), last, True) is not None
