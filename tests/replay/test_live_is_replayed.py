"""What perception, reconstruction and planner said live, they say again on a recording, byte for byte."""

import random

import pytest

from agents.perception.agent import Perception
from agents.planner.agent import Planner
from agents.reconstruction.agent import Reconstruction
from schemas.messages import Status
from schemas.topics import CALIBRATION, FRAME_NOTICE, FRAMES, OBSERVATIONS, PLAN, THREAD, topic_of
from shared.runtime.replay import replay
from tests.replay.conftest import of, scene_camera

OUTPUT = {Perception: OBSERVATIONS, Reconstruction: THREAD, Planner: PLAN}
# a live session of several seconds, and its frames segmented again and again
pytestmark = pytest.mark.slow
every_agent = pytest.mark.parametrize("agent", OUTPUT)


def test_the_session_has_something_to_show(recorded):
    assert sum(thread.status is Status.OK for thread in of(recorded, THREAD)) >= 10
    plans = of(recorded, PLAN)
    assert len(plans) >= 4
    assert [plan for plan in plans if plan.status is Status.OK]


@every_agent
def test_every_output_is_the_same_and_a_restarted_agent_is_a_run_of_its_own(agent, recorded):
    replayed = list(replay(agent, recorded))
    live = [entry for entry in recorded if topic_of(entry.key) is OUTPUT[agent]]
    assert [r.then for r in replayed if topic_of(r.key) is OUTPUT[agent]] == [e.payload for e in live]
    # the router may drop a robot state on its way to whoever records; what was made from it cannot be repeated
    assert all(r.same or r.missing for r in replayed)
    assert sum(r.same for r in replayed) > 0.7 * len(replayed)
    runs = {e.epoch for e in live}
    assert len(runs) == 2
    assert {r.epoch for r in replayed if r.same} == runs


@every_agent
@pytest.mark.parametrize("seed", range(2))
def test_of_a_recording_with_holes_every_output_is_the_same_or_names_what_is_missing(agent, seed, recorded):
    rng = random.Random(seed)
    holed = [entry for entry in recorded if rng.random() > 0.2]
    held = {(e.key, e.epoch, e.sequence) for e in holed}
    for replayed in replay(agent, holed):
        assert replayed.same != bool(replayed.missing)
        assert not [c for c in replayed.missing if (c.key, c.epoch, c.sequence) in held]


@every_agent
def test_a_recording_that_begins_in_mid_session_is_replayed_from_there(agent, recorded):
    calibration = [entry for entry in recorded if topic_of(entry.key) is CALIBRATION]
    replayed = list(replay(agent, [*calibration, *recorded[len(recorded) // 3 :]]))
    assert all(r.same or r.missing for r in replayed)
    # how many were under way depends on the machine; from the first that can be repeated on, all can
    same = [r.same for r in replayed if topic_of(r.key) is OUTPUT[agent]]
    assert all(same[same.index(True) :])


def test_the_scene_camera_films_the_same_frames_again(recorded):
    replayed = list(replay(scene_camera, recorded))
    assert len(replayed) > 20
    assert {topic_of(r.key) for r in replayed} == {FRAMES, FRAME_NOTICE, CALIBRATION}
    # a frame or a state of the field may be lost on its way to whoever records, and nothing is known from there on
    assert all(r.same or r.missing for r in replayed)
    assert replayed[0].same
