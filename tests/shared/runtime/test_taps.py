"""Taps: what is lost of a key is counted from its sequence, and a publisher that restarts has lost nothing."""

from hypothesis import given
from hypothesis import strategies as st

from schemas.topics import GOAL, HEARTBEAT, REPLAY_CLOCK
from shared.runtime.attachment import Attachment
from shared.runtime.session import open_session
from shared.runtime.taps import KeyLosses, tap


def beside(sequence, epoch=1):
    return Attachment(epoch, sequence, 0, 0.0)


@given(st.sets(st.integers(0, 200), min_size=1), st.integers(0, 1000))
def test_what_was_published_since_the_first_that_came_was_received_or_lost(came, offset):
    losses = KeyLosses()
    for sequence in sorted(came):
        losses.count(beside(sequence + offset))
    assert losses.received == len(came)
    assert losses.received + losses.lost == max(came) - min(came) + 1
    # a new run begins a new sequence
    for attachment in (beside(0, epoch=2), beside(2, epoch=2)):
        losses.count(attachment)
    assert losses.received + losses.lost == max(came) - min(came) + 1 + 3


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
