"""The commands of a running rig as a person meets them: set, arm, health, sessions, and a rig without a router."""

import contextlib
import json
import re
import signal
import subprocess
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from agents.cli.demo.command import APART, FROM_END, goals_of
from agents.cli.live.set import agent_and_rest, value_of
from agents.diagnostics.status.health_watch import HealthWatch, health_table
from agents.launch.session_folder import free_path, new_session_folder
from agents.operator.operator import Stood
from agents.planner.agent import Planner
from schemas.messages import Checked, CommandAnswer, ExecutionEvent, ExecutionKind, Outcome
from shared.execution_words import event_told
from shared.runtime.connection import connected
from shared.runtime.session import free_local_endpoint
from tests.agents.cli.conftest import SCRIPT, refused


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
        refused(suturegrasp(*command.split(), "--config", nowhere), "no router answers on tcp/127.0.0.1")


def test_a_recorder_that_met_no_router_leaves_no_file(nowhere, tmp_path, until):
    output = tmp_path / "session.mcap"
    command = [SCRIPT, "record", "--config", nowhere, "--output", output]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        until(output.exists)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=20)
    assert "no router came, so nothing was recorded" in said
    assert not output.exists()


def test_parameters_are_listed_set_and_refused(settings, running, suturegrasp, rig_file, until):
    running(Planner())
    config = rig_file("[planner]")
    with connected(settings, 60.0) as connection:
        until(connection.configurations)

    def said(*words):
        ended = suturegrasp("set", *words, "--config", config)
        assert (ended.status, ended.err) == (0, "")
        return ended.out

    listed = said("planner")
    assert re.search(r"^least_probability +0\.5 +a number from 0 to 1$", listed, flags=re.M)
    assert re.search(r"^samples +100 +not while it runs$", listed, flags=re.M)
    assert said("planner", "least_probability", "0.7") == "least_probability of planner is 0.7 now\n"
    assert re.search(r"^least_probability +0\.7 +a number .*\(set since it started\)$", said("planner"), re.M)
    for words, reason in (
        (("planner", "least_probability", "7"), "least_probability cannot be 7; it may be a number from 0 to 1"),
        (("planner/main", "samples", "7"), "samples of planner cannot be set while it runs"),
        (("planner", "sampels", "7"), "planner has no parameter sampels"),
        (("robot_bridge", "psm1"), "robot_bridge psm1 does not run; there are planner"),
    ):
        refused(suturegrasp("set", *words, "--config", config), reason, status=3)


NAMES = st.from_regex(r"[a-z_]{1,8}", fullmatch=True)


@given(NAMES, NAMES, st.none() | st.tuples(NAMES, st.text(min_size=1)), st.sampled_from("/ "))
def test_an_agent_is_named_in_one_word_or_two_and_a_value_is_json_or_text(kind, instance, parameter, separator):
    rest = parameter or ()
    assert agent_and_rest((kind, *rest)) == (kind, "main", parameter)
    assert agent_and_rest(("robot-bridge", instance)) == ("robot_bridge", instance, None)
    for words in ((kind, instance), (f"{kind}{separator}{instance}",)):
        assert agent_and_rest((*words, *rest)) == (kind, instance, parameter)
    for text in rest:
        value = value_of(text)
        assert value == text or json.dumps(json.loads(text)) == json.dumps(value)


def shown(fares):
    console = Console(width=200)
    with console.capture() as capture:
        console.print(health_table(fares))
    return capture.get()


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


def test_silence_is_told_once(monkeypatch):
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


def test_sessions_get_folders_of_their_own_and_a_restarted_recorder_a_file_beside_the_first(tmp_path):
    folders = [new_session_folder(tmp_path / "sessions") for _ in range(2)]
    assert folders[0].path != folders[1].path
    assert all(folder.path.is_dir() for folder in folders)
    assert folders[0].log("robot_bridge psm1").name == "robot_bridge_psm1.log"
    for name in ("session.mcap", "session-2.mcap", "session-3.mcap"):
        free = free_path(tmp_path / "session.mcap")
        assert free.name == name
        free.touch()


def test_every_event_has_its_words_and_what_was_refused_or_held_its_reason():
    for kind in ExecutionKind:
        ended = kind in (ExecutionKind.REFUSED, ExecutionKind.HELD)
        code, reason = ("stale", "too old") if ended else ("", "")
        sentence = event_told(ExecutionEvent("plan-1", "psm1", 0, kind, None, code, reason))
        assert sentence.startswith("psm1")
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
    monkeypatch.setattr(f"{command}.attempts_on", lambda _connection: contextlib.nullcontext(attempted))
    monkeypatch.setattr(f"{command}.arm_and_stand_by", attempted.arm)
    monkeypatch.setattr(f"{command}.plan_sentence", lambda plan: plan.plan_id)
    ended = suturegrasp("arm", "plan-1", "--attempts", "3", "--config", nowhere)
    assert ended.status == 3
    assert attempted.armed == armed
    said = "psm1 is real, so that a person arms each attempt: suturegrasp arm plan-2 --arm psm1"
    assert (said in ended.err) == is_real


class Holding:
    """In the place of a rig's bridges, each of which has its answer; who does not answer is not there."""

    def __init__(self, **answers):
        self.answers, self.held = answers, []

    def hold(self, _connection, arm):
        self.held.append(arm)
        if arm in self.answers:
            return CommandAnswer("id", Outcome.ACCEPTED, "", self.answers[arm])
        return CommandAnswer("id", Outcome.UNKNOWN, "late", "nobody answers")

    def present(self):
        return ["camera/main", *(f"robot_bridge/{arm}" for arm in self.answers)]


UNTOLD = "the arm could not be told yet"
BOTH = "[robot.psm1]\n[robot.psm2]"


@pytest.mark.parametrize(
    ("rig", "words", "answers", "status", "out", "err"),
    [
        (BOTH, "", {"psm1": "", "psm2": ""}, 0, ["psm1: holds", "psm2: holds"], []),
        (BOTH, "--arm psm2", {"psm1": "", "psm2": ""}, 0, ["psm2: holds"], []),
        (BOTH, "", {"psm1": UNTOLD, "psm2": ""}, 3, ["psm2: holds"], [f"psm1 was told to hold, but {UNTOLD}"]),
        (BOTH, "", {"psm1": ""}, 3, ["psm1: holds"], ["psm2: nobody answers"]),
        ("[robot.psm1]", "", {"psm1": "", "psm2": ""}, 0, ["psm1: holds", "psm2: holds"], []),
        ("[camera]", "", {"psm3": ""}, 0, ["psm3: holds"], []),
        ("[camera]", "", {}, 3, [], ["no arm is named by the rig's file, and none is there: name one with --arm"]),
    ],
)
def test_hold_is_for_all_arms_unless_one_is_named_and_says_of_each_what_became_of_it(
    suturegrasp, rig_file, monkeypatch, rig, words, answers, status, out, err
):
    holding = Holding(**answers)
    monkeypatch.setattr("agents.cli.live.command.connected", lambda _settings: contextlib.nullcontext(holding))
    monkeypatch.setattr("agents.cli.live.command.hold", holding.hold)
    ended = suturegrasp("hold", *words.split(), "--config", rig_file(rig))
    assert (ended.status, ended.out.splitlines()) == (status, out)
    assert ended.err.splitlines() == [f"suturegrasp: {line}" for line in err]
    assert sorted(holding.held) == sorted({line.split()[0].rstrip(":") for line in [*out, *err]} - {"no"})


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
    goals = goals_of([*threads, known([])], count, enough)
    places = sorted(s for s, _ in goals)
    assert len(goals) <= count
    assert all(FROM_END - 1e-9 <= s <= 1 - FROM_END + 1e-9 for s in places)
    assert (np.diff(places) >= APART - 1e-9).all()
    sure = [all(np.interp(s, t.confidence_s, t.confidence) >= enough for t in threads) for s, _ in goals]
    first = [c for (_, c), is_sure in zip(goals, sure, strict=True) if is_sure]
    last = [c for (_, c), is_sure in zip(goals, sure, strict=True) if not is_sure]
    assert [c for _, c in goals] == sorted(first) + sorted(last, reverse=True)
    assert goals_of([known([])], count, enough) == []
