"""Units are made millimetres, and as many messages are shown as an eye can follow and a machine can spare."""

import dataclasses

import numpy as np
import pytest

from agents.viewer.entity import (
    IN_A_FULL_MACHINE,
    MOST_PER_SECOND,
    Thinning,
    observations_in_mm,
    reconstruction_in_mm,
)
from agents.viewer.live import MachineLoad
from schemas import topics
from schemas.topics import FRAMES, PLAN, ROBOT_STATE, THREAD

SECOND = 1_000_000_000
START = 1_760_000_000 * SECOND


def test_a_session_in_metres_becomes_the_same_one_in_millimetres(session_messages, scene):
    observations = observations_in_mm(session_messages[topics.OBSERVATIONS])
    thread, expected = reconstruction_in_mm(session_messages[topics.THREAD]), scene.reconstruction
    assert observations.camera.baseline == pytest.approx(5.5)
    assert thread.camera.metres_per_unit == 1e-3
    assert np.allclose(observations.points_camera, scene.observations.points_camera)
    assert np.allclose(thread.control_points_camera, expected.control_points_camera)
    assert np.allclose(thread.regions.centre_camera, expected.regions.centre_camera)
    assert np.allclose(thread.regions.bound_depth, expected.regions.bound_depth)
    assert np.array_equal(thread.regions.bound_px, expected.regions.bound_px)
    inches = dataclasses.replace(expected.camera, metres_per_unit=0.0254)
    predicted = dataclasses.replace(
        expected, camera=inches, posterior_s=np.array([0.5]), posterior_covariance=np.eye(3)[None]
    )
    assert np.allclose(reconstruction_in_mm(predicted).posterior_covariance, 25.4**2 * np.eye(3))
    unknown = dataclasses.replace(expected, camera=dataclasses.replace(expected.camera, metres_per_unit=None))
    for known_or_not in (expected, unknown):
        assert reconstruction_in_mm(known_or_not) is known_or_not


def kept(thinning, topic, key, rate_hz):
    """When messages are shown, of two seconds of them."""
    times = [START + SECOND * k // rate_hz for k in range(2 * rate_hz)]
    return [at for at in times if thinning.keeps(topic, key, at)]


def test_no_more_a_second_are_shown_than_promised_slow_topics_and_events_whole():
    for topic, most in MOST_PER_SECOND.items():
        assert len(kept(Thinning(), topic, "key", 100)) == 2 * most
        assert len(kept(Thinning(), topic, "key", 1)) == 2
    thinning = Thinning()
    assert len(kept(thinning, PLAN, "plan", 100)) == 200
    assert kept(thinning, ROBOT_STATE, "psm1", 100) == kept(thinning, ROBOT_STATE, "psm2", 100)
    assert kept(thinning, FRAMES, "frames", 30) == kept(thinning, THREAD, "thread", 30)
    assert thinning.keeps(ROBOT_STATE, "psm1", START), "time may jump back"
    thinning = Thinning()
    thinning.there_is_room = False
    frames = kept(thinning, FRAMES, "frames", 30)
    assert len(frames) == 2 * IN_A_FULL_MACHINE
    assert frames == kept(thinning, THREAD, "thread", 30)
    assert len(kept(thinning, ROBOT_STATE, "psm1", 100)) == 2 * MOST_PER_SECOND[ROBOT_STATE]


def test_a_machine_is_full_where_its_processor_is_waited_for_and_a_little_waiting_changes_nothing():
    room = MachineLoad()

    def judged(share, seconds):
        """Whether there is room after so many seconds of work, in messages of 10 ms each; how often that changed."""
        changes = sum(room.worked(0.01 * share, 0.01) for _ in range(round(100 * seconds)))
        return room.there_is, changes

    assert judged(1.0, 3) == (True, 0)
    assert judged(0.7, 3) == (True, 0)
    assert not room.worked(0.01, 0.4), "a single slow message is not enough"
    assert judged(0.4, 4) == (False, 1)
    assert judged(0.7, 3) == (False, 0)
    assert judged(0.95, 3) == (True, 1)
