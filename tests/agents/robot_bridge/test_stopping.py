"""Stop always wins: whatever fails beside it, in whatever state, a command that stops is carried out."""

import contextlib
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.cli.running.audit import AuditError, AuditLog
from agents.cli.running.audited_bridge import AuditedBridge
from agents.robot_bridge.agent import RobotBridgeConfig
from agents.robot_bridge.dvrk.psm import DvrkPsm
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
from shared.ros import crtk
from shared.ros.naming import Ros2dds
from shared.runtime.agent import Command, Output, Received, Tick
from shared.runtime.commands import new_header, send_command
from shared.runtime.session import SessionSettings
from tests.agents.robot_bridge.test_agent import EPOCH, SECOND, TICK, plan

STATES = ("never ticked", "at rest", "armed", "moving", "held", "replayed", "at fault")
FAILURES = ("none", "audit", "state", "clock back", "clock ahead", "stalled")
UNWRITTEN = ("never ticked", "at rest", "at fault")
"""States of a bridge that could write nothing down yet: nothing is armed there."""
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

    def hold(self) -> bool:
        if self.broken_holds:
            self.broken_holds -= 1
            raise OSError("the link is gone")
        self.told.append("hold")
        return super().hold()

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


@pytest.mark.parametrize("state", UNWRITTEN)
@pytest.mark.parametrize("stop", STOPS)
def test_what_stops_is_no_no_op_where_the_audit_log_could_never_be_written(tmp_path, state, stop):
    rig = Rig(tmp_path)
    rig.fail("audit")
    with pytest.raises((AuditError, OSError)) if state != "never ticked" else contextlib.nullcontext():
        rig.bring_to(state)
    rig.arm.told.clear()
    rig.arm.broken_state, rig.arm.confirms = False, False
    assert rig.command(stop)[0].outcome is Outcome.ACCEPTED
    assert rig.arm.told == ["hold"] + ([stop] if stop != "hold" else [])
    with pytest.raises(AuditError):
        rig.tick()
    assert rig.arm.told[-1] == "hold", "it is told again in each turn until it is known to hold"


class Wire:
    """A link to a console that must be opened first, and hands nothing over while it is down."""

    failed, broken = "", 0

    def __init__(self, _settings: Any, _naming: Any, heard: Any, *_rest: Any) -> None:
        self.heard = {each.topic: each.receive for each in heard}
        self.opened, self.down, self.said = False, False, list[str]()

    def open(self) -> None:
        self.opened = True

    def say(self, topic: str, payload: bytes) -> bool:  # noqa: ARG002
        if not self.opened or self.down:
            return False
        self.said.append(topic)
        return True

    def close(self) -> None:
        self.opened = False


class Console:
    """A bridge of a real arm on such a link, whose console tells where its joints are as long as it is asked to."""

    def __init__(self, folder: Path) -> None:
        self.now_ns, self.wires, self.tells = EPOCH, list[Wire](), True

        def linked(*given: Any) -> Wire:
            self.wires.append(Wire(*given))
            return self.wires[-1]

        naming, clock = Ros2dds(), lambda: self.now_ns
        self.arm = DvrkPsm(
            "PSM1", SessionSettings(), naming, "", dry_run=False, linked=linked, clock=clock, monotonic=clock
        )
        self.audit = AuditLog(folder / "audit.jsonl")
        self.bridge = AuditedBridge(RobotBridgeConfig(), self.arm, self.audit)
        self.wire = self.wires[0]

    def tick(self, times: int = 1, speed: float = 0.0) -> None:
        for _ in range(times):
            self.now_ns += TICK
            if self.tells:
                joints = np.full(6, 0.1 + 1e-9 * speed * (self.now_ns - EPOCH))
                self.wire.heard["PSM1/measured_js"](crtk.joint_command(joints, self.now_ns), self.now_ns)
                self.wire.heard["PSM1/jaw/measured_js"](crtk.joint_command(joints[:1], self.now_ns), self.now_ns)
            with contextlib.suppress(AuditError):
                list(self.bridge.step(Tick(self.now_ns)))

    def hold(self) -> CommandAnswer:
        header = CommandHeader("stop", self.now_ns, "ben")
        answer, *_ = self.bridge.step(Command(HOLD, "psm1", Hold(header, "psm1"), self.now_ns))
        assert isinstance(answer, CommandAnswer)
        return answer

    @property
    def holds_said(self) -> int:
        return self.wire.said.count("PSM1/hold")


def test_a_console_is_told_to_hold_though_no_disk_has_room_from_the_start(tmp_path):
    console = Console(tmp_path)
    console.audit._file = os.open("/dev/full", os.O_WRONLY)
    console.tick(3)
    answer = console.hold()
    assert (answer.outcome, answer.reason) == (Outcome.ACCEPTED, "")
    assert console.holds_said == 1


def test_a_hold_that_could_not_be_handed_over_says_so_and_is_said_in_each_turn_until_the_arm_is_measured_to_stand(
    tmp_path,
):
    console = Console(tmp_path)
    console.tick()
    console.wire.down = True
    answer = console.hold()
    assert (answer.outcome, "told again in each turn" in answer.reason) == (Outcome.ACCEPTED, True)
    console.tick(5)
    console.wire.down = False
    console.tick(50, speed=1.0)
    assert console.holds_said == 50, "it still moves"
    console.tells = False
    console.tick(50)
    assert console.holds_said == 100, "where nothing is measured nobody knows that it stands"
    console.tells = True
    console.tick(60)
    settled = console.holds_said
    assert 100 < settled < 130
    console.tick(20)
    assert console.holds_said == settled, "it is known to stand"


def test_of_many_halts_at_once_the_console_hears_one(tmp_path):
    console = Console(tmp_path)
    console.tick()
    for _ in range(600):
        console.bridge.halt()
    assert console.holds_said == 1
    console.now_ns += TICK
    console.bridge.halt()
    assert console.holds_said == 2


def test_what_a_console_never_told_is_not_known_until_it_tells_it(tmp_path):
    console = Console(tmp_path)
    console.tick()
    assert set(console.arm._untold()) == {"teleoperation", "endoscope_arm", "clutch"}
    assert len(console.arm.state(console.now_ns).untold) == 3
    # also what cannot be read has been told
    for topic in ("console/teleop/enabled", "ECM/local/measured_cp", "footpedals/clutch"):
        told = console.arm._untold()
        console.wire.heard[topic](b"", console.now_ns)
        assert len(console.arm._untold()) == len(told) - 1, topic
    assert console.arm.state(console.now_ns).untold == ()


def test_challenges_come_often_while_a_plan_may_be_armed_so_that_the_way_of_an_answer_is_known(tmp_path):
    console = Console(tmp_path)
    console.tick(150)
    resting, config = console.bridge.tick_hz, console.bridge.config
    list(console.bridge.step(Received(PLAN, "", 0, plan())))
    assert (resting, console.bridge.tick_hz) == (config.resting_hz, config.tick_hz)
    console.now_ns += round(1e9 * config.maximum_plan_age_s)
    console.tick()
    assert console.bridge.tick_hz == config.resting_hz


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("broken", ["shared.runtime.outlets.payload_of", "shared.runtime.outlets.pack"])
def test_in_every_state_what_stops_is_carried_out_where_nothing_can_be_encoded_or_published(
    tmp_path, running, session, until, monkeypatch, broken, state
):
    rig = Rig(tmp_path)
    rig.bring_to(state)
    running(rig.bridge)
    until(lambda: hold(session).outcome is Outcome.ACCEPTED)

    def fails(*_given: Any, **_named: Any) -> Any:
        raise OSError("nothing leaves")

    with monkeypatch.context() as failing:
        failing.setattr(broken, fails)
        for topic, message, told in (
            (HOLD, Hold(new_header("ben"), "psm1"), ["hold"]),
            (CHANGE_STATE, ChangeState(new_header("ben"), "psm1", StateWord.PAUSE), ["hold", "pause"]),
        ):
            rig.arm.told.clear()
            answer = send_command(session, "test", topic, message, "psm1", timeout_s=20.0)
            assert answer.outcome is Outcome.ACCEPTED
            # a turn that fails beside it holds too
            assert set(told) <= set(rig.arm.told)


def hold(session: Any) -> CommandAnswer:
    return send_command(session, "test", HOLD, Hold(new_header("ben"), "psm1"), "psm1", timeout_s=20.0)


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


def test_pause_and_disable_are_said_whatever_time_it_is_for_the_bridge(tmp_path):
    console = Console(tmp_path)
    console.tick()
    # as after a tick that stalled, and as while a recording is replayed
    console.arm.state(console.now_ns - 3 * SECOND)
    assert [console.arm.change_state(StateWord[word.upper()], console.now_ns) for word in STOPS[1:]] == ["", ""]
    assert console.wire.said.count("PSM1/state_command") == 2
