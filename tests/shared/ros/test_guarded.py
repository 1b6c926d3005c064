"""What bridge and guard say to each other: it comes back as it was, and nothing else passes for it."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.ros import guarded
from shared.ros.guarded import ALIVE, CHALLENGE, SET_POINT, Alive, Challenge, Gate, GuardedError, SetPoint, key_of

counts = st.integers(0, 2**64 - 1)
ids = st.text("abcdef0123456789-", max_size=32)
finite = st.floats(allow_nan=False, allow_infinity=False)
positions = st.lists(finite, min_size=1, max_size=9).map(tuple)
reasons = st.text(max_size=80) | st.just("x" * 1000)
fields = st.integers(1, 2**64 - 1), counts, finite, st.sampled_from(Gate), st.booleans(), ids, reasons
KINDS = {
    SET_POINT: (st.builds(SetPoint, counts, counts, ids, positions), guarded.set_point_bytes, guarded.set_point_from),
    ALIVE: (st.builds(Alive, counts, counts, ids, st.booleans()), guarded.alive_bytes, guarded.alive_from),
    CHALLENGE: (st.builds(Challenge, *fields), guarded.challenge_bytes, guarded.challenge_from),
}


@pytest.mark.parametrize("topic", KINDS)
@given(data=st.data())
def test_a_message_comes_back_as_it_was_under_its_key_and_is_none_under_another(topic, data):
    made, to_bytes, from_bytes = KINDS[topic]
    key, said = key_of("PSM1", topic), data.draw(made)
    sent = to_bytes(key, said)
    if isinstance(said, Challenge):
        said = dataclasses.replace(said, reason=said.reason.encode(errors="replace").decode()[: guarded.LONGEST_TEXT])
    assert from_bytes(key, sent) == said
    others = [key_of("PSM2", topic), key_of("PSM", topic), key_of("PSM1", "other")]
    for other in (*others, *(key_of("PSM1", other) for other in KINDS if other != topic)):
        with pytest.raises(GuardedError, match="another key"):
            from_bytes(other, sent)


def test_a_set_point_that_is_none_or_whose_arming_does_not_fit_is_not_sent():
    key = key_of("PSM1", SET_POINT)
    for said in ((), (math.nan,), (0.0, math.inf)):
        with pytest.raises(GuardedError, match="all of them finite"):
            guarded.set_point_bytes(key, SetPoint(1, 2, "a", said))
    for arming_id in ("a" * 33, "a\0b"):
        with pytest.raises(GuardedError, match="at most 32 bytes"):
            guarded.set_point_bytes(key, SetPoint(1, 2, arming_id, (0.0,)))


def test_what_is_cut_off_or_speaks_of_an_arming_that_is_no_text_is_none():
    key = key_of("PSM1", SET_POINT)
    sent = guarded.set_point_bytes(key, SetPoint(1, 2, "ab", (0.5,)))
    garbled = sent.replace(b"ab\0", b"a\0b"), sent.replace(b"ab\0", b"\xff\xfe\0")
    for data in (sent[:-1], sent[:-8], sent[:-9], *garbled):
        with pytest.raises(GuardedError):
            guarded.set_point_from(key, data)
    key = key_of("PSM1", ALIVE)
    sent = guarded.alive_bytes(key, Alive(1, 2))
    for data in (sent[:-1], sent + b"\0", sent[:-1] + b"\2"):
        with pytest.raises(GuardedError, match=r"being alive|cut off"):
            guarded.alive_from(key, data)


@pytest.mark.parametrize(("at", "value"), [(16, 3), (17, 2), (0, 0)])
def test_a_challenge_with_what_it_cannot_have_is_none(at, value):
    key = key_of("PSM1", CHALLENGE)
    data = bytearray(guarded.challenge_bytes(key, Challenge(1, 0, 0.0, Gate.HELD, False)))
    data[4 + len(key) + at] = value
    with pytest.raises(GuardedError, match="a value that it cannot have"):
        guarded.challenge_from(key, bytes(data))
