"""A thread that is followed leaves nothing else unseen: what is due beside it, glances at parts, the pair judged."""

import functools
import itertools
from collections import Counter
from dataclasses import replace

import cv2
import numpy as np
import pytest

from agents.camera.scene_source import calibration_of
from agents.perception.background_search import FRAMES_BETWEEN_LOOKS_WATCHED
from agents.perception.glance import PARTS, Part, glance, next_part, part_score
from agents.perception.schedule import FRAMES_BETWEEN, GLANCES_AFTER_LOOK, LONGEST_REST, OLDEST_S, REST, Due, due
from schemas.codec import encode
from schemas.messages import Status
from schemas.topics import SURFACE
from shared.images import decode_image
from shared.rendering.render import ENDOSCOPE
from tests.agents.perception.pictures import agent_with, fed, frame_of, noisy, rendered_pair
from tests.agents.perception.test_instances import observed, told

EVERY, EIGHT_SECONDS = 3, 240
"""Of the frames of a camera of 30 Hz these are seen, as by a slow machine."""
EVERY_PART = [Part(eye, row, column) for eye in (0, 1) for row in (0, 1) for column in (0, 1)]
MEDIUM, CROSSING = ("medium", 32), ("crossing", 32)


def started():
    return agent_with(calibration_of(ENDOSCOPE))


def frame(sequence, images):
    """Each picture has its own noise, as of a camera."""
    return frame_of(noisy(images, sequence, sequence), sequence)


@functools.cache
def known(*scene):
    """Observations of a frame in which the thread was followed."""
    found = fed(started(), *(frame(k, rendered_pair(*scene)) for k in (0, 1)))
    assert found[1].segmented_sequence == 0
    return found[1]


def masks(observed):
    return decode_image(observed.mask_left), decode_image(observed.mask_right)


def with_another(images):
    """The images with the thread once more, farther down."""
    both = []
    for image, mask in zip(images, masks(known(*MEDIUM)), strict=True):
        there = np.roll(cv2.dilate(mask, np.ones((5, 5), np.uint8)), 110, axis=0)
        both.append(np.where(there[..., None] > 0, np.roll(image, 110, axis=0), image))
    return tuple(both)


def without_half(images):
    """The images with tissue where the left half of the thread was."""
    both = []
    for image, mask in zip(images, masks(known(*MEDIUM)), strict=True):
        columns = np.flatnonzero(mask.any(axis=0))
        half = cv2.dilate(mask, np.ones((9, 9), np.uint8))
        half[:, (columns[0] + columns[-1]) // 2 :] = 0
        both.append(cv2.inpaint(image, half, 5, cv2.INPAINT_TELEA))
    return tuple(both)


def with_cuts(observed, is_cut):
    """The observations with all pieces of thread cut at both ends, or with none."""
    loose = np.full_like(observed.trail_left.loose_start, not is_cut)
    return replace(observed, trail_left=replace(observed.trail_left, loose_start=loose, loose_end=loose))


def said(images, observed):
    """What each part of the left image shows that is not known."""
    covered = masks(observed)[0]
    of_left = [part for part in EVERY_PART if part.eye == 0]
    return {glance(part_score(images[0], part), observed, covered, part) for part in of_left} - {""}


@pytest.mark.slow
def test_what_changed_elsewhere_than_where_a_thread_is_followed_is_told():
    images = rendered_pair(*MEDIUM)
    assert said(images, known(*MEDIUM)) == set()
    assert said(with_another(images), known(*MEDIUM)) == {"thread where none is known"}
    assert said(without_half(images), known(*MEDIUM)) == {"no thread where one is known"}
    assert said(images, with_cuts(known(*MEDIUM), True)) == {"strands meet no longer"}
    assert said(rendered_pair(*CROSSING), with_cuts(known(*CROSSING), False)) == {"strands meet where none did"}


def test_every_part_of_both_images_is_looked_at_in_turn():
    met = [next_part(replace(known(*MEDIUM), glances=count)) for count in range(PARTS)]
    assert set(met) == set(EVERY_PART)
    covered = np.zeros((2, 271, 481), int)
    for part in met:
        covered[part.eye][part.inner(covered.shape[1:])] += 1
    assert (covered == 1).all()


@pytest.mark.slow
@pytest.mark.parametrize("change", [with_another, without_half])
def test_what_following_does_not_see_is_found_within_eight_seconds_by_a_slow_machine(change):
    agent, images = started(), rendered_pair(*MEDIUM)
    before = fed(agent, *(frame(k, images) for k in range(0, 42, EVERY)))
    assert {o.looked_sequence for o in before} == {0}
    now = change(images)
    looked = (fed(agent, frame(k, now))[0] for k in range(42, 42 + EIGHT_SECONDS, EVERY))
    found = next(observed for observed in looked if observed.looked_sequence > 0)
    assert found.status is Status.OK


@pytest.mark.slow
def test_a_thread_at_rest_hardly_needs_a_look_at_the_whole_for_twenty_seconds_but_is_judged_every_few():
    frames = [frame(k, rendered_pair(*MEDIUM)) for k in range(0, FRAMES_BETWEEN_LOOKS_WATCHED + 10, EVERY)]
    told = fed(started(), *frames)
    looked = sorted({o.looked_sequence for o in told})
    # in the noise of one frame of sixty, strands may seem to meet
    assert len(looked) == 2, looked
    assert FRAMES_BETWEEN_LOOKS_WATCHED / 2 < looked[1] <= FRAMES_BETWEEN_LOOKS_WATCHED
    before = next(o for o in reversed(told) if o.looked_sequence == 0)
    assert before.glances > 2 * PARTS
    again = next(o for o in told if o.looked_sequence == looked[1])
    assert (again.glances, again.glanced_sequence, again.judged_sequence) == (0, None, None)
    since = [o.stamp.sequence - max(o.judged_sequence or 0, o.looked_sequence) for o in told]
    # of what is due, one thing is done in every third frame that is seen
    assert max(since) <= 2 * FRAMES_BETWEEN[Due.JUDGED] + 3 * EVERY
    assert not any(o.judged_sequence == o.glanced_sequence is not None for o in told)
    # an agent that is fed the observations of any frame goes on alike
    resumed = fed(started(), told[14], *frames[15:50])
    assert [encode(o) for o in resumed] == [encode(o) for o in told[15:50]]
    assert any(o.judged_sequence for o in resumed)
    assert resumed[-1].glances > resumed[0].glances


RATE_HZ = 30.0


def stamped(last, sequence, rate_hz=RATE_HZ):
    return replace(last.stamp, sequence=sequence, capture_left_ns=round(sequence * 1e9 / rate_hz))


def done_over(frames, step, is_watched=True, rate_hz=RATE_HZ):
    """What was done in which frame of the camera, of which so many are left out."""
    last, done = told(observed()), {}
    for sequence in range(step, frames, step):
        stamp = stamped(last, sequence, rate_hz)
        what = due(stamp, last, is_watched)
        seen = {
            None: {},
            Due.JUDGED: {"judged_sequence": sequence},
            Due.GLANCE: {"glanced_sequence": sequence},
            Due.OCCLUDERS: {"occluders": replace(last.occluders, sequence=sequence)},
            Due.SURFACE: {"surface_sequence": sequence},
        }
        if what is not None:
            done[sequence] = what
        last = replace(last, stamp=stamp, **seen[what])
    return done


def longest_between(done, what):
    return max(b - a for a, b in itertools.pairwise([sequence for sequence, one in done.items() if one is what]))


def test_each_is_done_as_often_as_it_should_where_every_frame_is_seen():
    done = done_over(600, 1)
    for what, between in FRAMES_BETWEEN.items():
        begun = GLANCES_AFTER_LOOK if what is Due.GLANCE else 0
        assert (600 - begun) / list(done.values()).count(what) == pytest.approx(between, rel=0.3)
        assert longest_between(done, what) <= between + 2 * REST + 2


@pytest.mark.parametrize("step", [1, 3, 10])
def test_frames_without_anything_lie_between_and_nothing_is_left_undone(step):
    done = done_over(3000, step)
    rests = [b - a for a, b in itertools.pairwise(done) if done[b] is not Due.SURFACE]
    assert min(rests) > min(REST * step, LONGEST_REST)
    share = {what: count * FRAMES_BETWEEN[what] for what, count in Counter(done.values()).items()}
    assert share.keys() == FRAMES_BETWEEN.keys()
    # where there is no time for all, each comes later by about as much, but the tissue never too late to plan by
    assert max(share.values()) < 1.6 * min(share.values())
    assert longest_between(done, Due.SURFACE) <= OLDEST_S[Due.SURFACE] * RATE_HZ + (REST + 1) * step


@pytest.mark.parametrize("rate_hz", [2.0, 5.0, 15.0])
def test_the_tissue_is_never_too_old_to_plan_by_however_slow_the_camera(rate_hz):
    assert SURFACE.maximum_age_ms is not None
    oldest_ms = 1e3 * longest_between(done_over(300, 1, rate_hz=rate_hz), Due.SURFACE) / rate_hz
    assert oldest_ms < SURFACE.maximum_age_ms


def test_only_the_surface_and_what_may_hide_thread_are_made_beside_what_is_not_followed():
    assert set(done_over(200, 1, is_watched=False).values()) == {Due.OCCLUDERS, Due.SURFACE}
    last = told(observed())
    assert due(stamped(last, 1), last, False) is Due.SURFACE
