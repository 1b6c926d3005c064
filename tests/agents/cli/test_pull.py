"""Asking for a pull and arming it with its bounds, without a rig."""

import contextlib

import numpy as np
import pytest

from agents.operator.operator import Stood
from schemas.messages import (
    CommandAnswer,
    ExecutionEvent,
    ExecutionKind,
    FrameStamp,
    GraspPlan,
    Outcome,
    Phase,
    Policy,
    Pull,
    PullBounds,
    PullStop,
    Status,
    Waypoint,
)
from tests.agents.cli.conftest import refused

COMMAND = "agents.cli.live.pull"
ACCEPTED = CommandAnswer("id", Outcome.ACCEPTED, "", "")
WAY = (Waypoint(np.eye(4), 0.0, Phase.PULL, None),)


def plan(name="pull-1", continues="", stop=None, bounds=None, status=Status.OK):
    pull = Pull(0.02, 1, None, None, None, None, None, bounds, stop is not None, stop, "the tail is 30.0 mm long")
    failed = status is not Status.OK
    told = name, "psm1", "g", FrameStamp(1, 1, 1, "c"), status, "the free end is hidden" if failed else ""
    way = (Policy.DIRECT, None, None, 1.0, 0.0, () if failed else WAY, ())
    return GraspPlan(*told, *way, continues=continues, pull=None if failed else pull)


@pytest.fixture
def nobody(monkeypatch):
    """No rig: what is asked for, and what comes of it, is a test's."""
    monkeypatch.setattr(f"{COMMAND}.connected", lambda _settings: contextlib.nullcontext(None))
    return monkeypatch


def test_a_pull_is_asked_for_and_its_arming_printed_with_the_bounds_that_it_needs(suturegrasp, nobody):
    asked = []
    bounds = PullBounds(0.065, 75.0, 0.055)

    def ask(_connection, arm, tail_m, pixel):
        asked.append((arm, tail_m, None if pixel is None else pixel.tolist()))
        return ACCEPTED, plan(bounds=bounds)

    nobody.setattr(f"{COMMAND}.ask_for_pull", ask)
    ended = suturegrasp("pull", "--tail-mm", "20", "--exit-pixel", "442", "270")
    assert (ended.status, asked) == (0, [("psm1", 0.02, [442.0, 270.0])])
    assert "suturegrasp arm pull-1 --arm psm1 --pull-mm 65 --pull-seconds 75 --pull-within-mm 55" in ended.out
    assert suturegrasp("pull", "--release").status == 0
    assert asked[-1] == ("psm1", None, None)
    nobody.setattr(f"{COMMAND}.ask_for_pull", lambda *_: (ACCEPTED, plan(status=Status.FAILED)))
    refused(suturegrasp("pull", "--tail-mm", "20"), "the free end is hidden", status=3)
    refused(suturegrasp("pull"), "give one of --tail-mm and --release")
    refused(suturegrasp("pull", "--tail-mm", "-3"), "--tail-mm -3 is no length of thread")


class Plans:
    """What the planner says meanwhile."""

    def __init__(self, *plans):
        self._plans = list(plans)

    def next(self, _timeout_s):
        return self._plans.pop(0) if self._plans else None


@pytest.mark.parametrize(("stop", "status"), [(PullStop.REACHED, 0), (PullStop.TENSION, 3)])
def test_a_pull_is_armed_with_all_three_bounds_and_says_why_it_ended(suturegrasp, nobody, stop, status):
    armed = []

    def stand_by(_connection, arm, plan_id, _stopped, told, pull):
        armed.append((arm, plan_id, pull))
        told(ExecutionEvent("pull-g.2", "psm1", 0, ExecutionKind.FINISHED, None, "", ""))
        return Stood(ACCEPTED, ExecutionEvent("pull-g.2", "psm1", 0, ExecutionKind.FINISHED, None, "", ""))

    plans = Plans(plan("another", stop=PullStop.NO_WAY), plan("pull-g.2", continues="pull-1", stop=stop))
    nobody.setattr(f"{COMMAND}.events_of", lambda *_: contextlib.nullcontext(plans))
    nobody.setattr(f"{COMMAND}.arm_and_stand_by", stand_by)
    ended = suturegrasp("arm", "pull-1", "--pull-mm", "40", "--pull-seconds", "60", "--pull-within-mm", "50")
    assert (ended.status, armed) == (status, [("psm1", "pull-1", PullBounds(0.04, 60.0, 0.05))])
    assert f"psm1: {stop.name.lower()}: the tail is 30.0 mm long" in ended.out
    refused(suturegrasp("arm", "pull-1", "--pull-mm", "40"), "--pull-mm, --pull-seconds and --pull-within-mm together")
