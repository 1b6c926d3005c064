from datetime import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.replay.window import WindowError, window_ns

BEGIN_NS = round(datetime(2026, 11, 20, 14, 30).astimezone().timestamp()) * 10**9
SECOND = 10**9


@given(st.floats(0, 60), st.floats(0, 60))
def test_seconds_are_counted_from_the_start(begin_s, end_s):
    begin, end = sorted((round(begin_s, 3), round(end_s, 3)))
    window = window_ns(f"{begin:.3f}", f"{end:.3f}", BEGIN_NS, BEGIN_NS + 60 * SECOND)
    assert window == (BEGIN_NS + round(begin * SECOND), BEGIN_NS + round(end * SECOND))


@pytest.mark.parametrize("written", ["14:30:05", "2026-11-20T14:30:05", "2026-11-20 14:30:05.0"])
def test_a_time_of_the_day_is_meant_where_one_is_written(written):
    assert window_ns(written, None, BEGIN_NS, BEGIN_NS + 60 * SECOND) == (BEGIN_NS + 5 * SECOND, BEGIN_NS + 60 * SECOND)


@pytest.mark.parametrize(
    ("begin", "end", "said"),
    [
        ("61", None, "--from 61 lies beyond the end of the recording, which lasts 60.0 s"),
        ("20", "10", "--to 10 lies before --from 20"),
        (None, "14:00", "--to 14:00 lies before the recording, which begins at 2026-11-20 14:30:00"),
        ("soon", None, "--from 'soon' is no moment"),
        (None, "25:00", "--to '25:00' is no moment"),
        ("9" * 400, None, "is no moment"),
    ],
)
def test_what_makes_no_sense_is_said_in_a_sentence(begin, end, said):
    with pytest.raises(WindowError) as refused:
        window_ns(begin, end, BEGIN_NS, BEGIN_NS + 60 * SECOND)
    assert said in str(refused.value)
