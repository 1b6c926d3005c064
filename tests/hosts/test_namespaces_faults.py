"""Faults in the middle of a grasp, on four hosts and a router; `python -m benchmarks.faults` tries many more."""

import pytest

from benchmarks.faults.faults import cut_off, full_disk
from benchmarks.faults.recorded import missing_events
from benchmarks.faults.trial import trial
from schemas.topics import ROBOT_STATE

# what it takes to start all processes, and to wait for a plan, may both fall to one test
pytestmark = pytest.mark.timeout(600)
LEASE_S = 2.0
"""After so long of silence, the router closes the links of a host."""


def test_while_the_links_of_a_host_that_was_cut_off_are_closed_the_router_hears_the_others(lab):
    fault = cut_off("strong")
    seen = trial(lab, fault)
    dead_s = [at_s for at_s, sentence in seen.said if sentence.startswith("perception: ")]
    assert dead_s
    states = [h for h in lab.observer.messages(ROBOT_STATE) if 0 <= h.at_s - seen.begin_s - LEASE_S <= 0.5]
    later = [h for h in lab.observer.messages(ROBOT_STATE) if 0.5 <= h.at_s - seen.begin_s - LEASE_S <= 1.0]
    assert states
    assert later
    assert None not in seen.recovery_s.values()
    assert not seen.lost


def test_an_arm_that_is_cut_off_from_its_operator_holds_and_comes_back(lab):
    seen = trial(lab, cut_off("robot"))
    assert seen.ended == "heartbeat_lost"
    assert None not in seen.recovery_s.values()
    assert not seen.lost
    assert seen.name


def test_a_recorder_whose_disk_is_full_says_so_and_goes_on_where_there_is_room_with_all_events(lab):
    seen = trial(lab, full_disk())
    assert seen.name
    assert None not in seen.recovery_s.values()
    assert len(list(lab.recording.parent.glob("*.mcap"))) > 1
    heard, missing = missing_events(lab)
    assert heard
    assert not missing
