"""Stop always wins: whatever fails beside it, in whatever state, a command that stops is carried out."""

import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.cli.running.audit import AuditError, AuditLog
from agents.cli.running.audited_bridge import AuditedBridge
from agents.robot_bridge.agent import RobotBridgeConfig
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.messages import (
    Arm,
    ChangeState,
    CommandAnswer,
    CommandHeader,
    ExecutionEvent,
    ExecutionKind,
    Heartbeat,
    Hold,
    Outcome,
    ReplayClock,
    RobotState,
    StateWord,
)
from schemas.topics import ARM, CHANGE_STATE, HEARTBEAT, HOLD, PLAN, REPLAY_CLOCK
from shared.runtime.agent import Command, Output, Received, Tick
from tests.agents.robot_bridge.test_agent import EPOCH, SECOND, TICK, plan

STATES = ("never ticked", "at rest", "armed", "moving", "held", "replayed", "at fault")
FAILURES = ("none", "audit", "state", "clock back", "clock ahead", "stalled")
STOPS = ("hold", "pause", "disable")


class RecordingArm(SimulatedPsm):
    """A simulated arm that writes down what it is told, and fails where a test wants it to."""

    accepts_replayed_time = False

    def __init__(self) -> None:
        super().__init__()
        self.told: list[str] = []
        self.broken_state, self.broken_holds, self.confirms = False, 0, True

    def state(self, now_ns: int) -> Any:
        if self.broken_state:
            raise OSError("nothing can be measured")
        return super().state(now_ns)

    def hold(self) -> None:
        if self.broken_holds:
            self.broken_holds -= 1
            raise OSError("the link is gone")
        self.told.append("hold")
        super().hold()

    @property
    def holds(self) -> bool:
        return self.confirms

    def change_state(self, word: StateWord, now_ns: int) -> str:  # noqa: ARG002
        self.told.append(word.name.lower())
        return ""


class Rig:
    """An audited bridge that can be brought into any state."""

    def __init__(self, folder: Path, arm: RecordingArm | None = None) -> None:
        self.arm = arm or RecordingArm()
        self.audit = AuditLog(folder / "audit.jsonl")
        self.bridge = AuditedBridge(RobotBridgeConfig(), self.arm, self.audit)
        self.now_ns, self.said = EPOCH, list[Any]()

    def feed(self, arrived: Any) -> list[Any]:
        self.said += (found := list(self.bridge.step(arrived)))
        return found

    def tick(self, elapsed_ns: int = TICK) -> list[Any]:
        self.now_ns += elapsed_ns
        return self.feed(Tick(self.now_ns))

    def beat(self) -> None:
        states = [o.message for o in self.said if isinstance(o, Output) and isinstance(o.message, RobotState)]
        self.feed(Received(HEARTBEAT, "", 0, Heartbeat("psm1", "p1", self.now_ns, "a", states[-1].challenge_ns)))

    def bring_to(self, state: str) -> None:
        if state == "never ticked":
            return
        self.tick(0)
        if state in ("armed", "moving", "held"):
            self.feed(Received(PLAN, "", 0, plan()))
            header = CommandHeader("a", self.now_ns + SECOND, "ann")
            answer = self.feed(Command(ARM, "psm1", Arm(header, "psm1", "p1"), self.now_ns))[0]
            assert answer.outcome is Outcome.ACCEPTED, answer
        if state in ("moving", "held"):
            for _ in range(30):
                self.beat()
                self.tick()
            assert self.bridge.executes
        if state == "held":
            self.command("hold")
        if state == "replayed":
            self.feed(Received(REPLAY_CLOCK, "", 0, ReplayClock(1, 1.0)))
        if state == "at fault":
            self.arm.broken_state = True
            with pytest.raises(OSError, match="measured"):
                self.tick()

    def fail(self, failure: str) -> None:
        if failure == "audit":
            self.audit._file = os.open("/dev/full", os.O_WRONLY)
        elif failure == "state":
            self.arm.broken_state = True
        self.now_ns += {"clock back": -3600, "clock ahead": 3600, "stalled": 5}.get(failure, 0) * SECOND

    def command(self, stop: str) -> list[Any]:
        # late, too: its deadline was an hour ago
        header = CommandHeader("stop", self.now_ns - 3600 * SECOND, "ben")
        if stop == "hold":
            return self.feed(Command(HOLD, "psm1", Hold(header, "psm1"), self.now_ns))
        word = StateWord[stop.upper()]
        return self.feed(Command(CHANGE_STATE, "psm1", ChangeState(header, "psm1", word), self.now_ns))


@settings(max_examples=150, deadline=None)
@given(state=st.sampled_from(STATES), failure=st.sampled_from(FAILURES), stop=st.sampled_from(STOPS))
def test_what_stops_is_never_a_no_op(tmp_path_factory, state, failure, stop):
    rig = Rig(tmp_path_factory.mktemp("rig"))
    rig.bring_to(state)
    moved = rig.bridge.executes
    rig.fail(failure)
    rig.arm.told.clear()
    answer, *events = rig.command(stop)
    assert isinstance(answer, CommandAnswer)
    assert answer.outcome is Outcome.ACCEPTED
    assert rig.arm.told == ["hold"] + ([stop] if stop != "hold" else [])
    assert not rig.bridge.executes
    assert [e.message.kind for e in events] == [ExecutionKind.HELD] * moved


@pytest.mark.parametrize("stop", STOPS)
@pytest.mark.parametrize("times", [1, 7])
def test_a_hold_that_the_backend_did_not_take_is_said_in_each_tick_until_it_does(tmp_path, stop, times):
    rig = Rig(tmp_path)
    rig.bring_to("moving")
    rig.arm.broken_holds, rig.arm.confirms = times, False
    rig.arm.told.clear()
    assert rig.command(stop)[0].outcome is Outcome.ACCEPTED
    for count in range(times + 3):
        assert rig.bridge.tick_hz == 100, "no turn is left out before it holds"
        rig.beat()
        rig.tick()
        assert rig.arm.told.count("hold") == max(0, count + 2 - times)
    rig.arm.confirms = True
    rig.tick()
    held = rig.arm.told.count("hold")
    for _ in range(5):
        rig.tick()
    assert rig.arm.told.count("hold") == held, "it is known to hold"


def test_where_a_turn_fails_the_arm_holds_and_everybody_is_told_before_the_failure_goes_on(tmp_path):
    rig = Rig(tmp_path)
    rig.bring_to("moving")
    rig.arm.broken_state = True
    rig.arm.told.clear()
    turn, said = iter(rig.bridge.step(Tick(rig.now_ns + TICK))), []
    with pytest.raises(OSError, match="measured"):
        said.extend(turn)
    assert rig.arm.told == ["hold"]
    (event,) = (o.message for o in said if isinstance(o.message, ExecutionEvent))
    assert (event.kind, event.code) == (ExecutionKind.HELD, "fault")


def test_a_motion_that_nobody_can_read_about_afterwards_does_not_go_on_and_says_so(tmp_path):
    rig = Rig(tmp_path)
    rig.bring_to("moving")
    rig.fail("audit")
    said: list[Any] = []
    with pytest.raises(AuditError):
        for _ in range(3000):
            rig.beat()
            rig.now_ns += TICK
            for one in rig.bridge.step(Tick(rig.now_ns)):
                said.append(one)
                rig.said.append(one)
    kinds = [o.message.kind for o in said if isinstance(o.message, ExecutionEvent)]
    # the phase that could not be written down, and that the arm holds
    assert kinds == [ExecutionKind.PHASE_REACHED, ExecutionKind.HELD]
    assert rig.arm.told[-1] == "hold"


def test_a_halt_from_another_thread_ends_the_motion_in_the_next_turn(tmp_path):
    class HaltedArm(RecordingArm):
        was = False

        @property
        def halted(self) -> bool:
            return self.was

        def halt(self) -> None:
            self.was = True
            self.hold()

    rig = Rig(tmp_path, HaltedArm())
    rig.bring_to("moving")
    rig.bridge.halt()
    rig.beat()
    rig.tick()
    assert not rig.bridge.executes
    assert rig.said[-1].message.code == "hold_command"
