"""A thread that is followed leaves nothing else unseen: parts of the images are glanced at, and the pair is judged."""

import dataclasses
import functools

import cv2
import numpy as np
import pytest

from agents.camera.scene_source import calibration_of
from agents.perception.agent import Perception
from agents.perception.due import FRAMES_BETWEEN, Due
from agents.perception.glances.glance import glance, part_score
from agents.perception.glances.parts import PARTS, Part, next_part
from agents.perception.watched import FRAMES_BETWEEN_LOOKS_WATCHED
from schemas.codec import decode, encode
from schemas.messages import FrameStamp, ImageEncoding, Status, StereoFrame, ThreadObservations
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS
from shared.images import decode_image, encode_image
from shared.runtime.agent import Received, outputs_in
from shared.scene.__main__ import make_scene
from shared.scene.render import render

EVERY, EIGHT_SECONDS = 3, 240
"""Of the frames of a camera of 30 Hz these are seen, as by a slow machine."""
EVERY_PART = [Part(eye, row, column) for eye in (0, 1) for row in (0, 1) for column in (0, 1)]


@functools.cache
def scene(config="medium", seed=32):
    made = make_scene(config, "tissue", seed)
    pair = render(made)
    return calibration_of(made.camera), (pair.left_bgr, pair.right_bgr)


def started(config="medium", seed=32):
    agent = Perception()
    list(agent.step(Received(CALIBRATION, str(CALIBRATION), 0, scene(config, seed)[0])))
    return agent


def seen(agent, sequence, images):
    """What is observed, over the wire; each picture by its own noise, as of a camera."""
    noise = np.random.default_rng(sequence).integers(0, 3, images[0].shape, np.uint8)
    left, right = (encode_image(cv2.add(image, noise), ImageEncoding.RAW) for image in images)
    frame = StereoFrame(FrameStamp(sequence, sequence * 33_000_000, sequence * 33_000_000, ""), left, right)
    outputs = outputs_in(agent.step(Received(FRAMES, str(FRAMES), sequence, frame)))
    return decode(ThreadObservations, encode(outputs[0].message))


@functools.cache
def known(config="medium", seed=32):
    """Observations of a frame in which the thread was followed."""
    agent = started(config, seed)
    found = [seen(agent, k, scene(config, seed)[1]) for k in (0, 1)]
    assert found[1].segmented_sequence == 0
    return found[1]


def coverages(observed):
    return decode_image(observed.mask_left), decode_image(observed.mask_right)


def with_another(images, down):
    """The images with the thread once more, so many rows farther down."""
    both = []
    for image, mask in zip(images, coverages(known()), strict=True):
        wide = cv2.dilate(mask, np.ones((5, 5), np.uint8))
        both.append(np.where(np.roll(wide, down, axis=0)[..., None] > 0, np.roll(image, down, axis=0), image))
    return tuple(both)


def without_half(images):
    """The images with tissue where the left half of the thread was."""
    both = []
    for image, mask in zip(images, coverages(known()), strict=True):
        columns = np.flatnonzero(mask.any(axis=0))
        half = cv2.dilate(mask, np.ones((9, 9), np.uint8))
        half[:, (columns[0] + columns[-1]) // 2 :] = 0
        both.append(cv2.inpaint(image, half, 5, cv2.INPAINT_TELEA))
    return tuple(both)


def with_cuts(observed, is_cut):
    """The observations with all pieces of thread cut at both ends, or with none."""
    trails = {}
    for name in ("trail_left", "trail_right"):
        trail = getattr(observed, name)
        loose = np.full_like(trail.loose_start, not is_cut)
        trails[name] = dataclasses.replace(trail, loose_start=loose, loose_end=loose)
    return dataclasses.replace(observed, **trails)


def said(images, observed):
    """What each part of the left image shows that is not known."""
    covered = coverages(observed)
    scores = {part: part_score(images[part.eye], part) for part in EVERY_PART if part.eye == 0}
    return {glance(score, observed, covered[part.eye], part) for part, score in scores.items()} - {""}


@pytest.mark.slow
def test_thread_elsewhere_and_thread_that_is_gone_are_told():
    images = scene()[1]
    assert said(images, known()) == set()
    assert said(with_another(images, 110), known()) == {"thread where none is known"}
    assert said(without_half(images), known()) == {"no thread where one is known"}


@pytest.mark.slow
def test_strands_that_meet_and_that_meet_no_longer_are_told():
    assert said(scene()[1], with_cuts(known(), True)) == {"strands meet no longer"}
    assert said(scene("crossing")[1], with_cuts(known("crossing"), False)) == {"strands meet where none did"}


def test_every_part_of_both_images_is_looked_at_in_turn():
    met = [next_part(dataclasses.replace(known(), glances=count)) for count in range(PARTS)]
    assert set(met) == set(EVERY_PART)
    covered = np.zeros((2, 271, 481), int)
    for part in met:
        covered[part.eye][part.inner(covered.shape[1:])] += 1
    assert (covered == 1).all()


@pytest.mark.slow
@pytest.mark.parametrize("change", [lambda images: with_another(images, 110), without_half])
def test_what_following_does_not_see_is_found_within_eight_seconds_by_a_slow_machine(change):
    agent, images = started(), scene()[1]
    for sequence in range(0, 42, EVERY):
        assert seen(agent, sequence, images).looked_sequence == 0
    now = change(images)
    looked = (seen(agent, sequence, now) for sequence in range(42, 42 + EIGHT_SECONDS, EVERY))
    found = next(observed for observed in looked if observed.looked_sequence > 0)
    assert found.status is Status.OK


def steady(frames):
    """What is observed of a thread at rest."""
    agent = started()
    return [seen(agent, k, scene()[1]) for k in range(0, frames, EVERY)]


@pytest.mark.slow
def test_an_agent_that_is_fed_the_observations_of_any_frame_goes_on_alike():
    before, other = steady(150), started()
    list(other.step(Received(OBSERVATIONS, str(OBSERVATIONS), 14, before[14])))
    again = [seen(other, o.stamp.sequence, scene()[1]) for o in before[15:]]
    assert [encode(o) for o in again] == [encode(o) for o in before[15:]]
    assert {o.judged_sequence for o in again} > {None}
    assert again[-1].glances > again[0].glances


@pytest.mark.slow
def test_a_thread_at_rest_hardly_needs_a_look_at_the_whole_for_twenty_seconds_but_is_judged_every_few():
    told = steady(FRAMES_BETWEEN_LOOKS_WATCHED + 10)
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
