"""Whoever listens without being an agent, and how far consumers tell that they have got."""

from schemas.messages import Consumed
from schemas.topics import FRAMES, GOAL, HEARTBEAT, LOG, REPLAY_CLOCK, key
from shared.runtime.agent import Input
from shared.runtime.delivery import declare_publisher
from shared.runtime.facts import ask_progress, matches
from shared.runtime.taps import tap
from tests.shared.runtime.conftest import Idle, beside, frame_bytes

NAME = key("test", FRAMES)


def test_commands_are_not_listened_to_and_a_message_without_attachment_is_handed_over(receiver, session, keep, until):
    heard = []
    keep(*tap(receiver, "test", (GOAL, HEARTBEAT, REPLAY_CLOCK), heard.append, lambda *_: None))

    def put():
        session.put("suturegrasp/test/operator/psm1/goal", b"a")
        session.put("suturegrasp/other/operator/psm1/heartbeat", b"b")
        session.put("suturegrasp/test/operator/psm1/heartbeat", b"c")
        return heard

    until(put)
    assert {(t.key, t.payload, t.beside) for t in heard} == {("suturegrasp/test/operator/psm1/heartbeat", b"c", None)}


class Perception(Idle):
    kind, inputs = "perception", (Input(FRAMES),)


def test_an_agent_and_a_listener_tell_what_they_are_done_with_readable_or_not(running, session, keep, until):
    kept = tap(session, "test", (FRAMES, LOG), lambda _: None, lambda *_: None)
    running(Perception())
    until(lambda: "perception/main" in ask_progress(session, "test"))
    publisher = keep(declare_publisher(session, NAME, FRAMES, waits=True))
    said = {}
    for number, payload in enumerate((frame_bytes(), b"\xff", frame_bytes(), b"\xff")):

        def done(number=number, payload=payload):
            # whoever has just declared a subscription may miss the first one
            publisher.put(payload, attachment=beside(number, epoch=5))
            said = ask_progress(session, "test")
            return all(Consumed(NAME, 5, number) in progress.handled for progress in said.values()) and said

        said = until(done)
    (listener,) = (name for name in said if name.startswith("tap/"))
    assert sorted(said) == ["perception/main", listener]
    assert (said["perception/main"].listens, said[listener].listens.count("/*/*/log")) == (NAME, 1)
    heard_by = [any(matches(selector, NAME) for selector in one.listens.split()) for one in said.values()]
    assert heard_by == [True, True]
    assert not matches(NAME, key("test", LOG, agent="camera"))
    for declared in kept:
        declared.undeclare()
    until(lambda: list(ask_progress(session, "test")) == ["perception/main"])
