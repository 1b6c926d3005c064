"""What the scaling benchmark counts, and each of its runs once, shortly, with real routers and processes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.faults.network import CannotError
from benchmarks.scaling import rig_bytes
from benchmarks.scaling_load import streams
from benchmarks.scaling_record import measure_recorder
from benchmarks.scaling_rigs import TLS, account, measure
from benchmarks.scaling_sites import measure_sites

KEY = "suturegrasp/lab/camera/r0/frames"
SECONDS = 1.0


@given(first=st.integers(0, 20), count=st.integers(1, 50), heard=st.sets(st.integers(0, 80)))
def test_what_was_sent_while_it_counted_was_heard_or_is_missing(first, count, heard):
    end = first + count
    rows = [[number, 1.0] for number in sorted(heard)]
    consumers = [{"heard": {KEY: [*rows, *rows]}, "lost": {KEY: 3}}]
    (frames,) = account(consumers, [{KEY: [first, end]}]).values()
    counted = heard & set(range(first, end))
    assert (frames.sent, frames.missing, frames.told) == (count, count - len(counted), 3)
    assert len(frames.ms) == len(counted)


def test_a_rig_publishes_what_was_recorded_and_no_simulator():
    rows = {row["topic"]: row for row in rig_bytes()}
    assert rows["camera/frames"]["kB/s"] == pytest.approx(30e-3 * rows["camera/frames"]["bytes"], rel=1e-3)
    assert {stream.agent for stream in streams()}.isdisjoint({"simulator", "replay"})
    assert rows["*/health"]["keys"] == 5


def test_two_rigs_on_one_router_lose_no_event(tmp_path):
    row = measure(TLS, 2, SECONDS, tmp_path)
    assert row["events lost"] == 0
    assert all(topic["delivered %"] > 0 for topic in row["topics"].values())
    assert row["router in MB/s"] > 0


def test_one_recorder_holds_several_rigs(tmp_path):
    row = measure_recorder(2, SECONDS, foxglove=False, folder=tmp_path)
    assert "planner/plan" not in row["missing by topic"]
    assert "32 keys" in row["said"]


def test_over_the_link_goes_only_what_is_read_across(tmp_path):
    try:
        (followed,) = measure_sites(SECONDS, tmp_path, ("followed",))
    except CannotError as error:
        pytest.skip(str(error))
    payload = sum(s.bytes * s.rate_hz for s in streams() if str(s.topic) == "reconstruction/thread") * 1e-3
    assert 0.1 * payload < followed["north to south kB/s"] < 3 * payload
    assert followed["south to north kB/s"] < 0.1 * payload
    assert followed["events lost"] == 0
    assert all(topic["delivered %"] > 0 for topic in followed["topics"].values())
