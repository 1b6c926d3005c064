"""The audit log of a real arm: what it holds, that it is only added to, and that nothing is carried out without it."""

import json
import os
import subprocess
import sys

import pytest

from agents.launch.audit import AuditError, AuditLog
from agents.launch.audited_bridge import AuditedBridge
from agents.robot_bridge.agent import RobotBridgeConfig
from agents.robot_bridge.simulated import SimulatedPsm, waiting
from schemas.messages import Arm, ChangeState, CommandAnswer, CommandHeader, Hold, Outcome, StateWord
from schemas.topics import ARM, CHANGE_STATE, HOLD
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.runtime.agent import Command, Tick

NOW_NS = 1_800_000_000_000_000_000
FOREVER = """
import itertools, sys
from pathlib import Path
from agents.launch.audit import AuditLog
log = AuditLog(Path(sys.argv[1]))
for number in itertools.count():
    log.add("command", number, reason="x" * 500)
    print(number, flush=True)
"""


def bridge_with(path):
    made = AuditedBridge(RobotBridgeConfig(), SimulatedPsm(waiting(SIMULATED_T_CAMERA_BASE)), AuditLog(path))
    list(made.step(Tick(NOW_NS)))
    return made


def lines(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_every_command_its_sender_and_its_answer_are_written_and_only_added(tmp_path):
    path = tmp_path / "audit" / "psm1.jsonl"
    for _ in range(2):
        bridge = bridge_with(path)
        for topic, message in (
            (ARM, Arm(CommandHeader("a", NOW_NS, "ann"), "psm1", "p")),
            (HOLD, Hold(CommandHeader("b", NOW_NS, "ben"), "psm1")),
            (CHANGE_STATE, ChangeState(CommandHeader("c", NOW_NS, "ann"), "psm1", StateWord.HOME)),
        ):
            list(bridge.step(Command(topic, "psm1", message, NOW_NS)))
        bridge.close()
    told = [(line["what"], line.get("sender") or line.get("code") or line.get("outcome", "")) for line in lines(path)]
    assert told == 2 * [
        ("started", ""),
        ("command", "ann"),
        ("answer", "unknown_plan"),
        ("event", "unknown_plan"),
        ("command", "ben"),
        ("answer", "accepted"),
        ("event", "hold_command"),
        ("command", "ann"),
        ("answer", "no_states"),
        ("stopped", ""),
    ]
    assert [line["word"] for line in lines(path) if "word" in line] == ["home"] * 2
    assert path.stat().st_mode & 0o777 == 0o640


@pytest.mark.slow
def test_what_was_answered_before_a_kill_is_in_the_file(tmp_path):
    path = tmp_path / "psm1.jsonl"
    with subprocess.Popen([sys.executable, "-c", FOREVER, str(path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        said = [int(process.stdout.readline()) for _ in range(50)]
        process.kill()
        said += [int(line) for line in process.stdout]
    assert [line["at_ns"] for line in lines(path)][: len(said)] == said


@pytest.fixture
def full():
    """A file that takes nothing more."""
    opened = os.open("/dev/full", os.O_WRONLY)
    yield opened
    os.close(opened)


def test_a_command_that_cannot_be_written_down_is_not_carried_out(tmp_path, full):
    bridge = bridge_with(tmp_path / "psm1.jsonl")
    bridge._audit._file = full
    with pytest.raises(AuditError, match=r"psm1\.jsonl cannot be written: No space left"):
        bridge.step(Command(ARM, "psm1", Arm(CommandHeader("b", NOW_NS, "ben"), "psm1", "p"), NOW_NS))
    (tmp_path / "folder.jsonl").mkdir()
    with pytest.raises(AuditError, match="Is a directory"):
        bridge_with(tmp_path / "folder.jsonl")


@pytest.mark.parametrize("folder", [False, True])
def test_what_stops_is_carried_out_whether_or_not_it_can_be_written_down(tmp_path, full, folder):
    bridge = bridge_with(tmp_path / "psm1.jsonl")
    told = []
    bridge._backend.hold = lambda: told.append("hold") or True
    bridge._backend.change_state = lambda word, now_ns: told.append(word.name) or ""  # noqa: ARG005
    bridge._audit._file, bridge._begun = full, not folder
    header = CommandHeader("b", NOW_NS - 1, "ben")
    for topic, message, expected in (
        (HOLD, Hold(header, "psm1"), ["hold"]),
        (CHANGE_STATE, ChangeState(header, "psm1", StateWord.PAUSE), ["hold", "PAUSE"]),
        (CHANGE_STATE, ChangeState(header, "psm1", StateWord.DISABLE), ["hold", "DISABLE"]),
    ):
        told.clear()
        answer, *_ = bridge.step(Command(topic, "psm1", message, NOW_NS))
        assert isinstance(answer, CommandAnswer)
        assert (answer.outcome, told) == (Outcome.ACCEPTED, expected)
