"""What no agent sends: wildcard keys, numbers that nobody can count to, and what is remembered without a number."""

from typing import Any

import pytest

from schemas.codec import decode, encode
from schemas.messages import AgentHealth, FrameStamp, Image, ImageEncoding, StereoFrame
from schemas.topics import FRAMES, HEALTH, key
from shared.runtime.agent import Agent, Input
from shared.runtime.attachment import Attachment, pack
from shared.runtime.taps import tap

IMAGE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))
FRAME = encode(StereoFrame(FrameStamp(0, 0, 0, ""), IMAGE, IMAGE))
OWN = key("test", FRAMES)
OF_MANY = OWN.replace("/frames", "/*")


class Consumer(Agent):
    """Hears frames, or only remembers them and looks at the newest at each tick."""

    kind, instance, outputs, commands = "perception", "main", (), ()

    def __init__(self, remembers):
        self.tick_hz = 20.0 if remembers else None
        self.inputs = (Input(FRAMES, only_newest_counts=True, only_remembered=remembers),)

    def step(self, arrived: Any):
        return ()


@pytest.mark.parametrize("remembers", [False, True])
def test_what_cannot_be_numbered_is_refused_and_counted_and_numbers_far_ahead_end_nobody(
    remembers, running, session, heard_by_others, until, monkeypatch
):
    monkeypatch.setattr("shared.runtime.runner.HEALTH_PERIOD_S", 0.05)
    frames, healths = [], []
    kept = tap(session, "test", (HEALTH,), healths.append, lambda *_: None)
    running(Consumer(remembers))
    heard_by_others(session, OWN)
    kept += tap(session, "test", (FRAMES,), frames.append, lambda *_: None)

    def account_is(condition):
        # what names many keys is heard under all of them, and belongs to none
        told = [decode(AgentHealth, tapped.payload).inputs[0] for tapped in healths if tapped.beside is not None]
        return any(condition(account) for account in told)

    session.put(OWN, FRAME)
    session.put(OF_MANY, FRAME, attachment=pack(Attachment(1, 0, 0, 0.0)))
    session.put(OWN, b"damaged", attachment=pack(Attachment(1, 1, 0, 0.0)))
    until(lambda: account_is(lambda a: (a.received, a.missed, a.refused + a.dropped) == (0, 0, 3)))
    for turn in range(6):
        session.put(OWN, FRAME, attachment=pack(Attachment(turn // 2, (2**64 - 1) * (turn % 2), 0, 0.0)))
    until(lambda: account_is(lambda a: a.received + a.dropped + a.refused == 9))
    until(lambda: len(frames) == 9)
    # one message for many keys is none of any of them, and is numbered nowhere
    assert [tapped.beside for tapped in frames if tapped.key == OF_MANY] == [None]
    for declared in kept:
        declared.undeclare()
