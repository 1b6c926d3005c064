"""What bridge and guard say to each other: it comes back as it was, and nothing else passes for it."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.ros.guarded import (
    ALIVE,
    CHALLENGE,
    LONGEST_TEXT,
    SET_POINT,
    Alive,
    Challenge,
    Gate,
    GuardedError,
    SetPoint,
    alive_bytes,
    alive_from,
    challenge_bytes,
    challenge_from,
    key_of,
    set_point_bytes,
    set_point_from,
)

counts = st.integers(0, 2**64 - 1)
ids = st.text("abcdef0123456789-", max_size=32)
finite = st.floats(allow_nan=False, allow_infinity=False)
set_points = st.builds(SetPoint, counts, counts, ids, st.lists(finite, min_size=1, max_size=9).map(tuple))
alives = st.builds(Alive, counts, counts, ids, st.booleans())
challenges = st.builds(
    Challenge,
    st.integers(1, 2**64 - 1),
    counts,
    finite,
    st.sampled_from(Gate),
    st.booleans(),
    ids,
    st.text(max_size=80),
)
KINDS = {
    SET_POINT: (set_points, set_point_bytes, set_point_from),
    ALIVE: (alives, alive_bytes, alive_from),
    CHALLENGE: (challenges, challenge_bytes, challenge_from),
}
kinds = pytest.mark.parametrize("topic", KINDS)


@kinds
@given(data=st.data())
def test_a_message_comes_back_as_it_was_under_its_key_and_is_none_under_another(topic, data):
    made, to_bytes, from_bytes = KINDS[topic]
    key, said = key_of("PSM1", topic), data.draw(made)
    sent = to_bytes(key, said)
    found = from_bytes(key, sent)
    if isinstance(said, Challenge):
        said = dataclasses.replace(said, reason=said.reason.encode(errors="replace").decode())
    assert found == said
    others = [key_of("PSM2", topic), key_of("PSM", topic), key_of("PSM1", "other")]
    for other in (*others, *(key_of("PSM1", other) for other in KINDS if other != topic)):
        with pytest.raises(GuardedError, match="another key"):
            from_bytes(other, sent)


@kinds
@given(data=st.binary(max_size=150))
def test_foreign_bytes_are_none_or_a_message(topic, data):
    _, _, from_bytes = KINDS[topic]
    key = key_of("PSM1", topic)
    for prefix in (b"", b"SG1" + bytes((len(key),)) + key.encode()):
        try:
            from_bytes(key, prefix + data)
        except GuardedError:
            continue


def test_a_set_point_that_is_none_or_whose_arming_does_not_fit_is_not_sent():
    key = key_of("PSM1", SET_POINT)
    for positions in ((), (math.nan,), (0.0, math.inf)):
        with pytest.raises(GuardedError, match="all of them finite"):
            set_point_bytes(key, SetPoint(1, 2, "a", positions))
    for arming_id in ("a" * 33, "a\0b"):
        with pytest.raises(GuardedError, match="at most 32 bytes"):
            set_point_bytes(key, SetPoint(1, 2, arming_id, (0.0,)))


def test_what_is_cut_off_or_speaks_of_an_arming_that_is_no_text_is_none():
    key = key_of("PSM1", SET_POINT)
    sent = set_point_bytes(key, SetPoint(1, 2, "ab", (0.5,)))
    garbled = sent.replace(b"ab\0", b"a\0b"), sent.replace(b"ab\0", b"\xff\xfe\0")
    for data in (sent[:-1], sent[:-8], sent[:-9], *garbled):
        with pytest.raises(GuardedError):
            set_point_from(key, data)
    key = key_of("PSM1", ALIVE)
    sent = alive_bytes(key, Alive(1, 2))
    for data in (sent[:-1], sent + b"\0", sent[:-1] + b"\2"):
        with pytest.raises(GuardedError, match=r"being alive|cut off"):
            alive_from(key, data)


def test_a_long_reason_is_cut():
    key = key_of("PSM1", CHALLENGE)
    told = challenge_from(key, challenge_bytes(key, Challenge(1, 0, 0.0, Gate.HELD, False, "a", "x" * 1000)))
    assert len(told.reason) == LONGEST_TEXT


@pytest.mark.parametrize(("at", "value"), [(16, 3), (17, 2), (0, 0)])
def test_a_challenge_with_what_it_cannot_have_is_none(at, value):
    key = key_of("PSM1", CHALLENGE)
    data = bytearray(challenge_bytes(key, Challenge(1, 0, 0.0, Gate.HELD, False)))
    data[4 + len(key) + at] = value
    with pytest.raises(GuardedError, match="a value that it cannot have"):
        challenge_from(key, bytes(data))
