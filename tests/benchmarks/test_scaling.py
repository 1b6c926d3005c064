"""What the scaling benchmark counts."""

from hypothesis import given
from hypothesis import strategies as st

from benchmarks.scaling_rigs import account

KEY = "suturegrasp/lab/camera/r0/frames"


@given(first=st.integers(0, 20), count=st.integers(1, 50), heard=st.sets(st.integers(0, 80)))
def test_what_was_sent_while_it_counted_was_heard_or_is_missing(first, count, heard):
    end = first + count
    rows = [[number, 1.0] for number in sorted(heard)]
    consumers = [{"heard": {KEY: [*rows, *rows]}, "lost": {KEY: 3}}]
    (frames,) = account(consumers, [{KEY: [first, end]}]).values()
    counted = heard & set(range(first, end))
    assert (frames.sent, frames.missing, frames.told) == (count, count - len(counted), 3)
    assert len(frames.ms) == len(counted)
