"""The smallest messages and agents of the runtime's tests, and what is said on their rig."""

import contextlib
from collections.abc import Iterable

import pytest

from schemas.codec import decode, encode
from schemas.messages import FrameStamp, GraspPlan, Image, ImageEncoding, Policy, Status, StereoFrame
from shared.runtime.agent import Agent, Reply
from shared.runtime.attachment import Attachment, pack
from shared.runtime.session import open_session
from shared.runtime.taps import tap

IMAGE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))


def frame_bytes(number=0):
    """A frame of that number as it travels."""
    return encode(StereoFrame(FrameStamp(number, 0, 0, ""), IMAGE, IMAGE))


def rejection(reason, consumed=(), goal_id="g"):
    """A plan without a path."""
    made = "p", "psm1", goal_id, FrameStamp(0, 0, 0, ""), Status.FAILED, reason, Policy.DIRECT, None, None, 0.0, 0.0
    return GraspPlan(*made, waypoints=(), alternatives=(), consumed=consumed)


def beside(sequence=0, epoch=1, published_ns=0):
    """What travels beside a message."""
    return pack(Attachment(epoch, sequence, published_ns, 0.0))


class Idle(Agent):
    """Hears and says nothing."""

    kind = "planner"

    def step(self, arrived) -> Iterable[Reply]:
        assert arrived
        return ()


@pytest.fixture(autouse=True)
def health_comes_often(monkeypatch):
    monkeypatch.setattr("shared.runtime.runner.HEALTH_PERIOD_S", 0.05)
    monkeypatch.setattr("shared.runtime.taps.PERIOD_S", 0.05)


@pytest.fixture
def receiver(settings):
    """Another session on the rig of `session`."""
    with open_session(settings) as opened:
        yield opened


@pytest.fixture
def keep(session, receiver):  # noqa: ARG001 - they outlive what is kept
    """Keep what was declared on either session until the end, and undeclare it before they are closed."""
    with contextlib.ExitStack() as stack:

        def kept(*declared):
            for one in declared:
                stack.callback(one.undeclare)
            return declared[0]

        yield kept


@pytest.fixture
def heard(session, keep):
    """What is published on a topic: a list that fills."""

    def listen(topic):
        messages = []
        hear = lambda tapped: messages.append(decode(topic.message, tapped.payload))  # noqa: E731
        keep(*tap(session, "test", (topic,), hear, lambda *_: None))
        return messages

    return listen
