"""Stop always wins: whatever fails beside it, in whatever state, a command that stops is carried out."""

import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.launch.audit import AuditError, AuditLog
from agents.launch.audited_bridge import AuditedBridge
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.messages import ChangeState, CommandHeader, ExecutionKind, Hold, Outcome, ReplayClock, StateWord
from schemas.topics import CHANGE_STATE, HOLD, REPLAY_CLOCK
from shared.runtime.agent import Command
from tests.agents.robot_bridge.drive import SECOND, Drive, plan

STATES = ("never ticked", "at rest", "armed", "moving", "held", "replayed", "at fault")
FAILURES = ("none", "audit", "state", "clock back", "clock ahead", "stalled")
STOPS = ("hold", "pause", "disable")


class RecordingArm(SimulatedPsm):
    """A simulated arm that writes down what it is told, and fails where a test wants it to."""

    accepts_replayed_time = False
    broken_state, broken_holds, was_halted, confirms = False, 0, False, True

    def __init__(self) -> None:
        super().__init__()
        self.told: list[str] = []

    def state(self, now_ns: int) -> Any:
        if self.broken_state:
            raise OSError("nothing can be measured")
        return super().state(now_ns)

    def hold(self) -> bool:
        if self.broken_holds:
            self.broken_holds -= 1
            raise OSError("the link is gone")
        self.told.append("hold")
        return super().hold()

    @property
    def holds(self) -> bool:
        return self.confirms

    @property
    def halted(self) -> bool:
        return self.was_halted

    def halt(self) -> None:
        self.was_halted = True
        self.hold()

    def lets_through(self, arming_id: str) -> bool:
        return True

    def rearm(self, asked_ns: int) -> bool:
        self.was_halted = False
        return True

    def change_state(self, word: StateWord, now_ns: int) -> str:
        self.told.append(word.name.lower())
        return ""


class Rig(Drive):
    """An audited bridge that can be brought into any state."""

    def __init__(self, folder: Path, state: str) -> None:
        self.audit = AuditLog(folder / "audit.jsonl")
        super().__init__(
            backend=RecordingArm(),
            make=lambda config, arm: AuditedBridge(config, arm, self.audit),
            ticked=state != "never ticked",
        )
        if state in ("armed", "moving", "held"):
            self.armed(plan())
        if state in ("moving", "held"):
            assert self.run(30).bridge.executes
        if state == "held":
            self.command("hold")
        if state == "replayed":
            self.hear(REPLAY_CLOCK, ReplayClock(1, 1.0))
        if state == "at fault":
            self.backend.broken_state = True
            with pytest.raises(OSError, match="measured"):
                self.tick()
        self.backend.told.clear()

    def fail(self, failure: str) -> None:
        if failure == "audit":
            self.audit._file = os.open("/dev/full", os.O_WRONLY)
        elif failure == "state":
            self.backend.broken_state = True
        self.now_ns += {"clock back": -3600, "clock ahead": 3600, "stalled": 5}.get(failure, 0) * SECOND

    def command(self, stop: str) -> list[Any]:
        # late, too: its deadline was an hour ago
        header = CommandHeader("stop", self.now_ns - 3600 * SECOND, "ben")
        if stop == "hold":
            return self.feed(Command(HOLD, "psm1", Hold(header, "psm1"), self.now_ns))
        word = StateWord[stop.upper()]
        return self.feed(Command(CHANGE_STATE, "psm1", ChangeState(header, "psm1", word), self.now_ns))


@given(state=st.sampled_from(STATES), failure=st.sampled_from(FAILURES), stop=st.sampled_from(STOPS))
def test_what_stops_is_never_a_no_op(tmp_path_factory, state, failure, stop):
    rig = Rig(tmp_path_factory.mktemp("rig"), state)
    moved = rig.bridge.executes
    rig.fail(failure)
    answer, *events = rig.command(stop)
    assert answer.outcome is Outcome.ACCEPTED
    assert rig.backend.told == ["hold"] + ([stop] if stop != "hold" else [])
    assert not rig.bridge.executes
    assert [(e.message.kind, bool(e.message.plan_id)) for e in events] == [(ExecutionKind.HELD, moved)]


@pytest.mark.parametrize("stop", STOPS)
@pytest.mark.parametrize("times", [1, 7])
def test_a_hold_that_the_backend_did_not_take_is_said_in_each_tick_until_it_does(tmp_path, stop, times):
    rig = Rig(tmp_path, "moving")
    rig.backend.broken_holds, rig.backend.confirms = times, False
    assert rig.command(stop)[0].outcome is Outcome.ACCEPTED
    for count in range(times + 3):
        assert rig.bridge.tick_hz == 100, "no turn is left out before it holds"
        rig.beat()
        rig.tick()
        assert rig.backend.told.count("hold") == max(0, count + 2 - times)
    rig.backend.confirms = True
    for _ in range(5):
        rig.tick()
    assert rig.backend.told.count("hold") == 4, "it is known to hold"


def test_where_a_turn_fails_the_arm_holds_and_everybody_is_told_before_the_failure_goes_on(tmp_path):
    rig = Rig(tmp_path, "moving")
    rig.backend.broken_state = True
    with pytest.raises(OSError, match="measured"):
        rig.tick()
    assert rig.backend.told == ["hold"]
    assert rig.ended == (ExecutionKind.HELD, "fault")


def test_a_motion_that_nobody_can_read_about_afterwards_does_not_go_on_and_says_so(tmp_path):
    rig = Rig(tmp_path, "moving")
    rig.fail("audit")
    with pytest.raises(AuditError):
        rig.run(3000)
    # the phase that could not be written down, and that the arm holds
    kinds = [event.kind for event in rig.events]
    assert kinds == [ExecutionKind.ACCEPTED, ExecutionKind.PHASE_REACHED, ExecutionKind.HELD]
    assert rig.backend.told[-1] == "hold"


def test_a_halt_from_another_thread_ends_the_motion_in_the_next_turn(tmp_path):
    rig = Rig(tmp_path, "moving")
    rig.bridge.halt()
    rig.beat()
    rig.tick()
    assert not rig.bridge.executes
    assert rig.ended == (ExecutionKind.HELD, "hold_command")
