"""What perception, reconstruction and planner said live, they say again on a recording, byte for byte."""

import dataclasses
import random

import pytest

from agents.perception.agent import Perception
from agents.planner.agent import Planner
from agents.reconstruction.agent import Reconstruction
from schemas.codec import decode, encode
from schemas.messages import GraspPlan, Status, ThreadReconstruction
from schemas.topics import CALIBRATION, FRAME_NOTICE, FRAMES, OBSERVATIONS, PLAN, THREAD, key, topic_of
from shared.recording.mcap_file import read_recording
from shared.runtime.replay import replay

AGENTS = (Perception, Reconstruction, Planner)
OUTPUT = {Perception: OBSERVATIONS, Reconstruction: THREAD, Planner: PLAN}
# a live session of several seconds, and its frames segmented again and again
pytestmark = pytest.mark.slow
every_agent = pytest.mark.parametrize("agent", AGENTS)


@pytest.fixture(scope="session")
def recorded(live):
    return list(read_recording(live.path))


def outputs_of(entries, topic):
    return [entry for entry in entries if topic_of(entry.key) is topic]


def test_the_session_has_something_to_show(recorded):
    threads = [decode(ThreadReconstruction, e.payload) for e in outputs_of(recorded, THREAD)]
    plans = [decode(GraspPlan, e.payload) for e in outputs_of(recorded, PLAN)]
    assert sum(thread.status is Status.OK for thread in threads) >= 10
    assert [plan for plan in plans if plan.status is Status.OK]
    assert len(plans) >= 4
    # and frames that nobody consumed
    consumed = {c for e in outputs_of(recorded, OBSERVATIONS) for c in decode(OBSERVATIONS.message, e.payload).consumed}
    frames = [e for e in recorded if e.key == key("replayed", FRAMES)]
    assert len([c for c in consumed if c.key == key("replayed", FRAMES)]) < len(frames)


@every_agent
def test_every_output_is_the_same_and_a_restarted_agent_is_a_run_of_its_own(agent, recorded):
    replayed = list(replay(agent, recorded))
    live = outputs_of(recorded, OUTPUT[agent])
    assert [r.then for r in replayed if topic_of(r.key) is OUTPUT[agent]] == [e.payload for e in live]
    assert len(replayed) >= 4
    # the router may drop a robot state on its way to whoever records; what was made from it cannot be repeated
    assert all(r.same or r.missing for r in replayed)
    assert sum(r.same for r in replayed) > 0.7 * len(replayed)
    runs = {e.epoch for e in live}
    assert len(runs) == 2
    assert {r.epoch for r in replayed if r.same} == runs


@every_agent
def test_a_change_of_one_input_shows(agent, recorded):
    """Otherwise the comparison would compare nothing."""
    topic = {Perception: FRAMES, Reconstruction: OBSERVATIONS, Planner: THREAD}[agent]
    last = decode(OUTPUT[agent].message, outputs_of(recorded, OUTPUT[agent])[-1].payload)
    place = next((c.key, c.epoch, c.sequence) for c in last.consumed if topic_of(c.key) is topic)

    def changed(entry):
        if (entry.key, entry.epoch, entry.sequence) != place:
            return entry
        message = decode(topic.message, entry.payload)
        stamp = dataclasses.replace(message.stamp, sequence=10**6)
        return dataclasses.replace(entry, payload=encode(dataclasses.replace(message, stamp=stamp)))

    replayed = [r for r in replay(agent, [changed(e) for e in recorded]) if topic_of(r.key) is OUTPUT[agent]][-1]
    assert not replayed.same
    assert replayed.now is not None


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
    calibration = [entry for entry in recorded if topic_of(entry.key).name == "calibration"]
    later = [*calibration, *recorded[len(recorded) // 3 :]]
    replayed = list(replay(agent, later))
    assert all(r.same or r.missing for r in replayed)
    # how many were under way depends on the machine; from the first that can be repeated on, all can
    same = [r.same for r in replayed if topic_of(r.key) is OUTPUT[agent]]
    assert all(same[same.index(True) :])


def test_the_scene_camera_films_the_same_frames_again(camera, recorded):
    replayed = list(replay(camera, recorded))
    assert len(replayed) > 20
    assert {str(topic_of(r.key)) for r in replayed} == {str(FRAMES), str(FRAME_NOTICE), str(CALIBRATION)}
    # a frame or a state of the field may be lost on its way to whoever records, and nothing is known from there on
    assert all(r.same or r.missing for r in replayed)
    assert replayed[0].same
