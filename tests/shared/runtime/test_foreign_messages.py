"""What no agent sends: wildcard keys, numbers that nobody can count to, and what is remembered without a number."""

import pytest

from schemas.codec import decode, encode
from schemas.messages import AgentHealth, FrameStamp, Image, ImageEncoding, StereoFrame
from schemas.topics import FRAMES, HEALTH, key
from shared.runtime.agent import Input
from shared.runtime.attachment import Attachment, pack
from shared.runtime.taps import tap

IMAGE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))
FRAME = encode(StereoFrame(FrameStamp(0, 0, 0, ""), IMAGE, IMAGE))
OWN = key("test", FRAMES)


class Consumer:
    """Hears frames, or only remembers them and looks at the newest at each tick."""

    kind, instance, outputs, commands = "perception", "main", (), ()

    def __init__(self, remembers):
        self.tick_hz = 20.0 if remembers else None
        self.inputs = (Input(FRAMES, only_newest_counts=True, only_remembered=remembers),)

    def step(self, _arrived):
        return ()


@pytest.fixture(params=[False, True], ids=["looks at each", "remembers"])
def account(request, running, session, heard_by_others, until):
    """The newest account of frames, once one for which a condition holds has come."""
    running(Consumer(request.param))
    healths = []

    def hear(tapped):
        # what names many keys is heard under all of them, and belongs to none
        if tapped.beside is not None:
            healths.append(decode(AgentHealth, tapped.payload))

    kept = tap(session, "test", (HEALTH,), hear, lambda *_: None)
    heard_by_others(session, OWN)

    def when(condition):
        return until(lambda: healths and condition(healths[-1].inputs[0]) and healths[-1].inputs[0], "such an account")

    yield when
    for declared in kept:
        declared.undeclare()


def test_numbers_far_ahead_are_told_and_end_nobody(account, session):
    for turn in range(6):
        session.put(OWN, FRAME, attachment=pack(Attachment(turn // 2, (2**64 - 1) * (turn % 2), 0, 0.0)))
    account(lambda a: a.received + a.dropped == 6)


def test_what_has_no_number_or_names_many_keys_is_refused_and_counted(account, session):
    session.put(OWN, FRAME)
    session.put(OWN.replace("/frames", "/*"), FRAME, attachment=pack(Attachment(1, 0, 0, 0.0)))
    session.put(OWN, b"damaged", attachment=pack(Attachment(1, 1, 0, 0.0)))
    seen = account(lambda a: a.refused + a.dropped == 3)
    assert (seen.received, seen.missed) == (0, 0)


def test_a_listener_numbers_nothing_that_names_many_keys(session, heard_by_others, until):
    heard = []
    kept = tap(session, "test", (FRAMES,), heard.append, lambda *_: None)
    heard_by_others(session, OWN)
    session.put(OWN.replace("/frames", "/*"), FRAME, attachment=pack(Attachment(1, 0, 0, 0.0)))
    until(lambda: heard)
    for declared in kept:
        declared.undeclare()
    assert heard[0].beside is None
