"""The commands of the live dataflow as a person meets them: options, health, doctor, sessions, completion."""

import contextlib
import re
import shutil
import signal
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from agents.cli.demo.command import APART, FROM_END, goals_of
from agents.cli.live.command import event_sentence
from agents.diagnostics.status.health_watch import HealthWatch, health_table
from agents.launch.session_folder import free_path, new_session_folder
from agents.operator.operator import Stood
from agents.planner.agent import Planner
from schemas.messages import Checked, CommandAnswer, ExecutionEvent, ExecutionKind, Outcome
from shared.runtime.connection import connected
from shared.runtime.session import free_local_endpoint
from tests.conftest import wait_until

BASH = shutil.which("bash") or ""


@pytest.fixture
def nowhere(tmp_path):
    """The configuration of a rig whose router nobody has started."""
    path = tmp_path / "rig.toml"
    path.write_text(f'[router]\nendpoint = "{free_local_endpoint()}"\nstart = false\n[planner]\n')
    return path


@pytest.mark.slow
def test_without_router_a_command_says_so_in_one_line(suturegrasp, nowhere, monkeypatch):
    monkeypatch.setattr("agents.cli.live.command.connected", lambda settings: connected(settings, within_s=0.1))
    for command in ("goal --pixel 1 2", "arm x", "hold", "prompt --pixel 1 2"):
        ended = suturegrasp(*command.split(), "--config", nowhere)
        assert (ended.status, ended.out, len(ended.err.splitlines())) == (2, "", 1), command
        assert "no router answers on tcp/127.0.0.1" in ended.err


def test_a_recorder_that_met_no_router_leaves_no_file(nowhere, tmp_path):
    output = tmp_path / "session.mcap"
    command = [sys.executable, "-m", "agents.cli", "record", "--config", nowhere, "--output", output]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        wait_until(output.exists)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=20)
    assert "no router came, so nothing was recorded" in said
    assert not output.exists()


@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("goal", "give one of --s, --pixel, --point and --from-swage-mm"),
        ("goal --s 0.5 --pixel 1 2", "give one of --s, --pixel, --point and --from-swage-mm"),
        ("goal --s 1.5", "s runs from 0 to 1"),
        ("goal --s nan", "s runs from 0 to 1"),
        ("arm", "give the id of a plan, as goal prints it"),
        ("demo --view hologram", "--view"),
        ("up --restart maybe", "suturegrasp up --help"),
        ("run planner --config none.toml", "none.toml cannot be read"),
    ],
)
def test_a_mistake_is_one_line(suturegrasp, command, told):
    ended = suturegrasp(*command.split())
    assert (ended.status, ended.out, len(ended.err.splitlines())) == (2, "", 1)
    assert told in ended.err


EVERY = [
    "demo",
    "play",
    "up",
    "goal",
    "arm",
    "hold",
    "prompt",
    "set",
    "status",
    "doctor",
    "run camera",
    "record",
    "view",
]


def test_every_command_has_a_help(suturegrasp):
    for command in EVERY:
        ended = suturegrasp(*command.split(), "--help")
        assert ended.status == 0
        assert f"suturegrasp {command}" in ended.out


@pytest.mark.slow
@pytest.mark.skipif(not BASH, reason="there is no bash")
def test_bash_completes_commands(console_script, tmp_path):
    ended = console_script("--tyro-print-completion", "bash")
    assert (ended.status, ended.err) == (0, "")
    script = tmp_path / "suturegrasp"
    script.write_text(ended.out)
    function = re.search(r"^complete .*-F (\w+) suturegrasp$", ended.out, flags=re.M)
    assert function, ended.out[-500:]
    asked = (
        f"source {script}; COMP_WORDS=(suturegrasp dem); COMP_CWORD=1; COMP_LINE='suturegrasp dem'; COMP_POINT=15; "
        f"COMP_TYPE=9; {function[1]}; echo ${{COMPREPLY[*]}}"
    )
    done = subprocess.run([BASH, "-c", asked], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["demo"], done.stderr


def test_health_names_who_is_silent_and_who_was_never_heard_of(settings, in_threads, until):
    with connected(settings, 60.0) as connection:
        watch = HealthWatch(connection, ["camera", "planner"])
        assert [(fare.name, fare.state) for fare in watch.fares()] == [("camera", "starting"), ("planner", "starting")]
        with in_threads(settings, Planner()):
            until(lambda: watch.fares()[1].state == "well")
        assert watch.changes() == []
        table = shown(watch.fares())
    assert re.search(r"camera +starting +-", table)
    assert re.search(r"planner +well", table)


def test_silence_and_recovery_are_told_once(monkeypatch):
    deaf: Any = SimpleNamespace(listen=lambda *_: None)
    now = [0.0]
    monkeypatch.setattr("agents.diagnostics.status.health_watch.monotonic_s", lambda: now[0])
    watch = HealthWatch(deaf, ["camera"])
    assert watch.changes() == []
    now[0] = 11.0
    assert watch.changes() == ["camera: never heard of for 11 s"]
    now[0] = 12.0
    assert watch.changes() == []
    assert "never heard of for 12 s" in shown(watch.fares())


def shown(fares):
    console = Console(width=200)
    with console.capture() as capture:
        console.print(health_table(fares))
    return capture.get()


def test_sessions_get_folders_of_their_own_and_a_restarted_recorder_a_file_beside_the_first(tmp_path):
    folders = [new_session_folder(tmp_path / "sessions") for _ in range(2)]
    assert folders[0].path != folders[1].path
    assert all(folder.path.is_dir() for folder in folders)
    assert folders[0].log("robot_bridge psm1").name == "robot_bridge_psm1.log"
    names = []
    for _ in range(3):
        free = free_path(tmp_path / "session.mcap")
        free.touch()
        names.append(free.name)
    assert names == ["session.mcap", "session-2.mcap", "session-3.mcap"]


def test_every_event_has_its_words_and_what_was_refused_or_held_its_reason():
    for kind in ExecutionKind:
        ended = kind in (ExecutionKind.REFUSED, ExecutionKind.HELD)
        code, reason = ("stale", "too old") if ended else ("", "")
        sentence = event_sentence(ExecutionEvent("plan-1", "psm1", 0, kind, None, code, reason))
        assert sentence.startswith("psm1: ")
        assert ("stale" in sentence and "too old" in sentence) == ended


class Attempted:
    """In the place of what stands by an arm and hears of a grasp: each one misses, and another is planned for."""

    def __init__(self, is_real):
        self.is_real, self.armed = is_real, []

    def arm(self, _connection, arm, plan_id, _stopped, _told):
        self.armed.append(plan_id)
        end = ExecutionEvent(plan_id, arm, 0, ExecutionKind.FINISHED, None, "", "")
        return Stood(CommandAnswer("id", Outcome.ACCEPTED, "", ""), end, is_real=self.is_real)

    def check_of(self, plan_id):
        return SimpleNamespace(plan_id=plan_id, sentence="the thread is not held", verdict=Checked.MISSED)

    def plan_after(self, _check):
        return SimpleNamespace(plan_id=f"plan-{len(self.armed) + 1}")


@pytest.mark.parametrize(("is_real", "armed"), [(True, ["plan-1"]), (False, ["plan-1", "plan-2", "plan-3"])])
def test_on_a_real_arm_no_further_attempt_arms_itself(suturegrasp, nowhere, monkeypatch, is_real, armed):
    command, attempted = "agents.cli.live.command", Attempted(is_real)
    monkeypatch.setattr(f"{command}.connected", lambda _settings: contextlib.nullcontext(None))
    monkeypatch.setattr(f"{command}.Attempts", lambda _connection: attempted)
    monkeypatch.setattr(f"{command}.arm_and_stand_by", attempted.arm)
    monkeypatch.setattr(f"{command}.plan_sentence", lambda plan: plan.plan_id)
    ended = suturegrasp("arm", "plan-1", "--attempts", "3", "--config", nowhere)
    assert ended.status == 3
    assert attempted.armed == armed
    said = "psm1 is real, so that a person arms each attempt: suturegrasp arm plan-2 --arm psm1"
    assert (said in ended.err) == is_real


def known(confidence) -> Any:
    """As much of a thread as goals are chosen by."""
    return SimpleNamespace(confidence=np.array(confidence), confidence_s=np.linspace(0, 1, len(confidence)))


@given(
    st.lists(st.lists(st.floats(0, 1), min_size=2, max_size=20), min_size=1, max_size=4),
    st.integers(0, 12),
    st.floats(0, 1),
)
def test_goals_are_apart_and_the_least_known_of_those_known_enough_come_first(confidences, count, enough):
    threads = [known(confidence) for confidence in confidences]
    goals = goals_of(threads, count, enough)
    places = sorted(s for s, _ in goals)
    assert len(goals) <= count
    assert all(FROM_END - 1e-9 <= s <= 1 - FROM_END + 1e-9 for s in places)
    assert (np.diff(places) >= APART - 1e-9).all()
    sure = [all(np.interp(s, t.confidence_s, t.confidence) >= enough for t in threads) for s, _ in goals]
    first = [c for (_, c), is_sure in zip(goals, sure, strict=True) if is_sure]
    last = [c for (_, c), is_sure in zip(goals, sure, strict=True) if not is_sure]
    assert [c for _, c in goals] == sorted(first) + sorted(last, reverse=True)


def test_goals_are_where_frames_agree_that_little_is_known_but_enough():
    dip_at_60 = [1, 1, 1, 1, 1, 1, 0.2, 1, 1, 1, 1]
    threads = [known(dip_at_60), known([1.0] * 11)]
    (goal,) = goals_of(threads, 1, 0.1)
    assert goal == pytest.approx((0.6, 0.6), abs=0.02)
    ((s, confidence),) = goals_of(threads, 1, 0.6)
    assert (abs(s - 0.6), confidence) == pytest.approx((0.05, 0.8), abs=0.05)
    assert goals_of([known([])], 3, 0.5) == []
