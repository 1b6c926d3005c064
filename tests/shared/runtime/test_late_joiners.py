"""Whoever comes late gets what still holds: the calibration, what agents are set to, and the last plan."""

import contextlib
from typing import Any

import numpy as np

from schemas.codec import decode
from schemas.messages import FrameStamp, GraspPlan, Policy, Status, StereoCalibration
from schemas.topics import CALIBRATION, CONFIGURATION, PLAN
from shared.runtime.agent import Agent, Output
from shared.runtime.session import open_session
from shared.runtime.taps import tap

RIGHT = np.eye(4) - 5e-3 * np.eye(4, k=3)
K = np.diag([9.0, 9.0, 1.0])
MADE = StereoCalibration(4, 2, K, K, np.zeros(5), np.zeros(5), RIGHT, 1.0)


class Once(Agent):
    """Publishes something at its first tick, and never again."""

    instance, inputs, commands, tick_hz = "main", (), (), 20.0

    def __init__(self, topic, *messages):
        self.kind, self.outputs, self.messages, self.ticks = topic.agent, (topic,), messages, 0

    def step(self, arrived: Any):
        self.ticks += 1
        messages, self.messages = self.messages, ()
        return [Output(self.outputs[0], message) for message in messages]


def rejected(name):
    stamp = FrameStamp(0, 0, 0, "")
    return GraspPlan(name, "psm1", name, stamp, Status.FAILED, "too far", Policy.DIRECT, None, None, 0.0, 0.0, (), ())


def test_a_subscriber_that_starts_late_gets_calibration_configurations_and_the_last_plan(running, settings, until):
    camera, planner = Once(CALIBRATION, MADE), Once(PLAN, rejected("first"), rejected("last"))
    running(camera)
    running(planner)
    # all was said long ago
    until(lambda: camera.ticks > 10 and planner.ticks > 10)
    heard = []
    with contextlib.ExitStack() as stack:
        late = stack.enter_context(open_session(settings))
        for declared in tap(late, "test", (CALIBRATION, CONFIGURATION, PLAN), heard.append, lambda *_: None):
            stack.callback(declared.undeclare)
        until(lambda: len(heard) == 5)
    by_topic = {topic: [t for t in heard if t.topic is topic] for topic in (CALIBRATION, CONFIGURATION, PLAN)}
    assert [decode(StereoCalibration, t.payload).image_width for t in by_topic[CALIBRATION]] == [4]
    assert sorted(t.key.split("/")[2] for t in by_topic[CONFIGURATION]) == ["camera", "planner"]
    assert [decode(GraspPlan, t.payload).plan_id for t in by_topic[PLAN]] == ["first", "last"]
