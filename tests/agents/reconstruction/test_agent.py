"""The reconstruction agent: one thread for each message of observations, whatever became of it."""

import dataclasses

import numpy as np
import pytest

from agents.reconstruction.agent import Reconstruction
from agents.reconstruction.methods import METHODS
from schemas.codec import decode, encode
from schemas.messages import FrameStamp, RectifiedStereo, Status, ThreadReconstruction
from schemas.topics import OBSERVATIONS, THREAD, key
from shared.runtime.agent import Received, Tick
from tests.agents.reconstruction.refined.conftest import centrelines_of

CAMERA = RectifiedStereo(640, 480, 600.0, 600.0, 319.5, 239.5, 0.005, 1.0)
REASON = "no thread was found in the left image"


@pytest.fixture
def observations(observe):
    def curve(t):
        x = 0.02 * t - 0.01
        return np.column_stack([x, 0.004 * np.sin(300 * x), 0.09 + 0.2 * x])

    left, right = (centrelines_of(curve, eye, camera=CAMERA) for eye in (0, 1))
    points, stamp = curve(np.linspace(0, 1, 12)), FrameStamp(3, 5, 6, "c")
    return observe(points, CAMERA, 1.0, stamp=stamp, centrelines_left=left, centrelines_right=right)


def fed(agent, message):
    outputs = list(agent.step(Received(OBSERVATIONS, key("lab", OBSERVATIONS), 0, message)))
    assert [output.topic for output in outputs] == [THREAD]
    return decode(ThreadReconstruction, encode(outputs[0].message))


@pytest.mark.parametrize("method", METHODS)
def test_observations_become_a_thread_of_the_same_frame_or_fail_with_their_reason(observations, observe, method):
    agent = Reconstruction(method)
    thread = fed(agent, observations)
    assert (thread.status, thread.reason) == (Status.OK, "")
    assert (thread.stamp, thread.method) == (FrameStamp(3, 5, 6, "c"), method)
    assert len(thread.regions.s) >= 8
    failed = fed(agent, observe(np.zeros((0, 3)), CAMERA, status=Status.FAILED, reason=REASON))
    assert failed.status is Status.FAILED
    assert REASON in failed.reason
    assert list(agent.step(Tick(1))) == []


@pytest.mark.parametrize(("method", "tracking"), [("refined", False), ("paper", False), ("paper", True)])
def test_without_tracking_nothing_is_kept_from_one_message_to_the_next(observations, observe, method, tracking):
    agent = Reconstruction(method, tracking)
    alone = encode(METHODS[method](observations))
    fed(agent, observe(np.zeros((0, 3)), CAMERA, status=Status.FAILED, reason=REASON))
    fed(agent, dataclasses.replace(observations, points_camera=observations.points_camera + 0.001))
    assert encode(fed(agent, observations)) == alone


def test_an_unknown_method_is_the_callers_mistake():
    with pytest.raises(KeyError):
        Reconstruction("magic")
