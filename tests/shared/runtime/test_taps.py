"""Taps: whoever listens without being an agent."""

from schemas.topics import GOAL, HEARTBEAT, REPLAY_CLOCK
from shared.runtime.session import open_session
from shared.runtime.taps import tap


def test_commands_are_not_listened_to_and_a_message_without_attachment_is_handed_over(settings, until):
    heard = []
    with open_session(settings) as session, open_session(settings) as foreign:
        kept = tap(session, "test", (GOAL, HEARTBEAT, REPLAY_CLOCK), heard.append, lambda *_: None)
        assert kept

        def put():
            foreign.put("suturegrasp/test/operator/psm1/goal", b"a")
            foreign.put("suturegrasp/other/operator/psm1/heartbeat", b"b")
            foreign.put("suturegrasp/test/operator/psm1/heartbeat", b"c")
            return heard

        until(put)
        for declared in kept:
            declared.undeclare()
    assert {(t.key, t.payload, t.beside) for t in heard} == {("suturegrasp/test/operator/psm1/heartbeat", b"c", None)}
