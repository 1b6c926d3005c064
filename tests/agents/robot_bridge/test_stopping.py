"""Stop always wins: whatever fails beside it, in whatever state, a command that stops is carried out."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.launch.audit import AuditError, AuditLog
from agents.launch.audited_bridge import AuditedBridge
from agents.robot_bridge.dvrk.psm import DvrkPsm
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.messages import (
    ChangeState,
    CommandHeader,
    ExecutionKind,
    Hold,
    Outcome,
    ReplayClock,
    StateWord,
)
from schemas.topics import CHANGE_STATE, HOLD, REPLAY_CLOCK
from shared.ros import crtk
from shared.ros.naming import Ros2dds
from shared.runtime.agent import Command
from shared.runtime.session import SessionSettings
from tests.agents.robot_bridge.drive import EPOCH, SECOND, TICK, Drive, plan

STATES = ("never ticked", "at rest", "armed", "moving", "held", "replayed", "at fault")
FAILURES = ("none", "audit", "state", "clock back", "clock ahead", "stalled")
STOPS = ("hold", "pause", "disable")


class RecordingArm(SimulatedPsm):
    """A simulated arm that writes down what it is told, and fails where a test wants it to."""

    accepts_replayed_time = False

    def __init__(self) -> None:
        super().__init__()
        self.told: list[str] = []
        self.broken_state, self.broken_holds, self.confirms, self.was_halted = False, 0, True, False

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

    def halt(self) -> None:
        self.was_halted = True
        self.hold()

    @property
    def halted(self) -> bool:
        return self.was_halted

    def rearm(self) -> None:
        self.was_halted = False

    def change_state(self, word: StateWord, now_ns: int) -> str:
        self.told.append(word.name.lower())
        return ""


class Rig(Drive):
    """An audited bridge that can be brought into any state."""

    def __init__(self, folder: Path) -> None:
        self.audit = AuditLog(folder / "audit.jsonl")
        super().__init__(
            backend=RecordingArm(), make=lambda config, arm: AuditedBridge(config, arm, self.audit), ticked=False
        )

    def bring_to(self, state: str) -> None:
        if state == "never ticked":
            return
        self.tick(0)
        if state in ("armed", "moving", "held"):
            self.armed(plan())
        if state in ("moving", "held"):
            self.run(30)
            assert self.bridge.executes
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
    rig = Rig(tmp_path_factory.mktemp("rig"))
    rig.bring_to(state)
    moved = rig.bridge.executes
    rig.fail(failure)
    answer, *events = rig.command(stop)
    assert answer.outcome is Outcome.ACCEPTED
    assert rig.backend.told == ["hold"] + ([stop] if stop != "hold" else [])
    assert not rig.bridge.executes
    assert [e.message.kind for e in events] == [ExecutionKind.HELD] * moved


@pytest.mark.parametrize("stop", STOPS)
@pytest.mark.parametrize("times", [1, 7])
def test_a_hold_that_the_backend_did_not_take_is_said_in_each_tick_until_it_does(tmp_path, stop, times):
    rig = Rig(tmp_path)
    rig.bring_to("moving")
    rig.backend.broken_holds, rig.backend.confirms = times, False
    assert rig.command(stop)[0].outcome is Outcome.ACCEPTED
    for count in range(times + 3):
        assert rig.bridge.tick_hz == 100, "no turn is left out before it holds"
        rig.beat()
        rig.tick()
        assert rig.backend.told.count("hold") == max(0, count + 2 - times)
    rig.backend.confirms = True
    rig.tick()
    held = rig.backend.told.count("hold")
    for _ in range(5):
        rig.tick()
    assert rig.backend.told.count("hold") == held, "it is known to hold"


def test_where_a_turn_fails_the_arm_holds_and_everybody_is_told_before_the_failure_goes_on(tmp_path):
    rig = Rig(tmp_path)
    rig.bring_to("moving")
    rig.backend.broken_state = True
    with pytest.raises(OSError, match="measured"):
        rig.tick()
    assert rig.backend.told == ["hold"]
    assert rig.ended == (ExecutionKind.HELD, "fault")


def test_a_motion_that_nobody_can_read_about_afterwards_does_not_go_on_and_says_so(tmp_path):
    rig = Rig(tmp_path)
    rig.bring_to("moving")
    rig.fail("audit")
    with pytest.raises(AuditError):
        rig.run(3000)
    # the phase that could not be written down, and that the arm holds
    kinds = [event.kind for event in rig.events]
    assert kinds == [ExecutionKind.ACCEPTED, ExecutionKind.PHASE_REACHED, ExecutionKind.HELD]
    assert rig.backend.told[-1] == "hold"


def test_a_halt_from_another_thread_ends_the_motion_in_the_next_turn(tmp_path):
    rig = Rig(tmp_path)
    rig.bring_to("moving")
    rig.bridge.halt()
    rig.beat()
    rig.tick()
    assert not rig.bridge.executes
    assert rig.ended == (ExecutionKind.HELD, "hold_command")


class Wire:
    """A link to a console that must be opened first, and hands nothing over while it is down."""

    failed, broken = "", 0

    def __init__(self, _settings: Any, _naming: Any, heard: Any, *_rest: Any) -> None:
        self.heard = {each.topic: each.receive for each in heard}
        self.opened, self.down, self.said = False, False, list[str]()

    def open(self) -> None:
        self.opened = True

    def say(self, topic: str, payload: bytes) -> bool:
        if not self.opened or self.down:
            return False
        self.said.append(topic)
        return True

    def close(self) -> None:
        self.opened = False


class Console(Drive):
    """A bridge of a real arm on such a link, whose console tells where its joints are as long as it is asked to."""

    def __init__(self) -> None:
        self.now_ns, self.tells = EPOCH, True
        wires, naming, clock = list[Wire](), Ros2dds(), lambda: self.now_ns

        def linked(*given: Any) -> Wire:
            wires.append(Wire(*given))
            return wires[0]

        arm = DvrkPsm("PSM1", SessionSettings(), naming, "", dry_run=False, linked=linked, clock=clock, monotonic=clock)
        self.wire = wires[0]
        super().__init__(backend=arm, ticked=False)
        self.turns()

    def turns(self, times: int = 1, speed: float = 0.0) -> None:
        for _ in range(times):
            self.now_ns += TICK
            if self.tells:
                joints = np.full(6, 0.1 + 1e-9 * speed * (self.now_ns - EPOCH))
                self.wire.heard["PSM1/measured_js"](crtk.joint_command(joints, self.now_ns), self.now_ns)
                self.wire.heard["PSM1/jaw/measured_js"](crtk.joint_command(joints[:1], self.now_ns), self.now_ns)
            self.tick(0)

    @property
    def holds_said(self) -> int:
        return self.wire.said.count("PSM1/hold")


def test_a_hold_that_could_not_be_handed_over_says_so_and_is_said_in_each_turn_until_the_arm_is_measured_to_stand():
    console = Console()
    console.wire.down = True
    answer = console.hold()
    assert (answer.outcome, "told again in each turn" in answer.reason) == (Outcome.ACCEPTED, True)
    console.turns(5)
    console.wire.down = False
    console.turns(50, speed=1.0)
    assert console.holds_said == 50, "it still moves"
    console.tells = False
    console.turns(50)
    assert console.holds_said == 100, "where nothing is measured nobody knows that it stands"
    console.tells = True
    console.turns(60)
    settled = console.holds_said
    assert 100 < settled < 130
    console.turns(20)
    assert console.holds_said == settled, "it is known to stand"


def test_of_many_halts_at_once_the_console_hears_one():
    console = Console()
    for _ in range(600):
        console.bridge.halt()
    assert console.holds_said == 1
    console.now_ns += TICK
    console.bridge.halt()
    assert console.holds_said == 2


def test_what_a_console_never_told_is_not_known_until_it_tells_it():
    console = Console()
    arm = console.backend
    assert set(arm._untold()) == {"teleoperation", "endoscope_arm", "clutch"}
    assert len(arm.state(console.now_ns).untold) == 3
    # also what cannot be read has been told
    for topic in ("console/teleop/enabled", "ECM/local/measured_cp", "footpedals/clutch"):
        untold = len(arm._untold())
        console.wire.heard[topic](b"", console.now_ns)
        assert len(arm._untold()) == untold - 1, topic
    assert arm.state(console.now_ns).untold == ()


def test_challenges_come_often_while_a_plan_may_be_armed_so_that_the_way_of_an_answer_is_known():
    console = Console()
    console.turns(150)
    resting, config = console.bridge.tick_hz, console.bridge.config
    console.publish(plan())
    assert (resting, console.bridge.tick_hz) == (config.resting_hz, config.tick_hz)
    console.now_ns += round(1e9 * config.maximum_plan_age_s)
    console.turns()
    assert console.bridge.tick_hz == config.resting_hz


def test_hold_pause_and_disable_are_said_whatever_time_it_is_for_the_bridge():
    console = Console()
    # as after a tick that stalled, and as while a recording is replayed
    console.backend.state(console.now_ns - 3 * SECOND)
    assert console.backend.hold()
    assert [console.backend.change_state(StateWord[word.upper()], console.now_ns) for word in STOPS[1:]] == ["", ""]
    assert (console.holds_said, console.wire.said.count("PSM1/state_command")) == (1, 2)
