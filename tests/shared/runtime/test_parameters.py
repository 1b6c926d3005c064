"""Parameters of running agents: what may be set, what is refused, who is told, and what a replay makes of it."""

import json
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.checks import require
from schemas.codec import decode, encode
from schemas.messages import (
    CommandAnswer,
    CommandRecord,
    ExecutionEvent,
    ExecutionKind,
    FrameStamp,
    Image,
    ImageEncoding,
    Outcome,
    SetParameter,
    StereoFrame,
)
from schemas.topics import COMMANDS, CONFIGURATION, EXECUTION, FRAMES, SET, key
from shared.runtime.agent import Command, Input, Output, Received
from shared.runtime.attachment import Attachment, pack
from shared.runtime.commands import new_header, send_command
from shared.runtime.connection import connected
from shared.runtime.parameters import Parameters
from shared.runtime.replay import replay
from shared.runtime.settable import Between, OneOf, settable
from shared.runtime.taps import tap

DEADLINE_S = 60.0
IMAGE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))


@dataclass(frozen=True, eq=False)
class Config:
    gain: float = settable(2.0, Between(0.5, 9.5))
    count: int = settable(3, Between(1, 10))
    patience_s: float = settable(30.0, Between(0.1))
    method: str | None = settable(None, OneOf((None, "ridge", "threshold")))
    place: np.ndarray = field(default_factory=lambda: np.eye(2))
    secret: int = 7

    def __post_init__(self):
        require(self.gain * self.count < 90, "gain times count must be below 90")


class Counting:
    """Says after every frame what it is set to; nothing of that is in what it says it goes on from."""

    kind, instance, commands, tick_hz = "robot_bridge", "psm1", (), None
    inputs, outputs = (Input(FRAMES, only_newest_counts=True),), (EXECUTION,)

    def __init__(self, config=Config()):
        self.config = config

    def configure(self, config):
        self.config = config

    def step(self, arrived):
        assert isinstance(arrived, Received)
        said = f"frame {arrived.message.stamp.sequence} at gain {self.config.gain}, {self.config.method}"
        yield Output(EXECUTION, ExecutionEvent("p", "psm1", 0, ExecutionKind.HELD, None, "said", said, "a"))


def asked(parameters, name, value) -> CommandAnswer:
    command = Command(SET, "psm1", SetParameter(new_header("a test"), name, value), 0)
    (answer,) = parameters.step(command)
    assert isinstance(answer, CommandAnswer)
    return answer


@given(gain=st.floats(0.5, 9.0) | st.integers(1, 9))
def test_a_value_within_its_range_is_taken(gain):
    agent = Counting()
    assert asked(Parameters(agent), "gain", json.dumps(gain)).outcome is Outcome.ACCEPTED
    assert agent.config.gain == gain
    assert type(agent.config.gain) is float


def anything_of_json():
    leaves = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
    return st.recursive(leaves, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=4)


@given(name=st.sampled_from(["gain", "count", "patience_s", "method"]), value=anything_of_json())
def test_whatever_is_asked_the_config_stays_within_what_is_allowed(name, value):
    agent = Counting()
    answer = asked(Parameters(agent), name, json.dumps(value))
    config = agent.config
    assert 0.5 <= config.gain <= 9.5
    assert type(config.count) is int
    assert 1 <= config.count <= 10
    assert 0.1 <= config.patience_s <= 30
    assert config.method in (None, "ridge", "threshold")
    assert (answer.outcome is Outcome.ACCEPTED) == (getattr(config, name) == value and type(value) is not bool)


@pytest.mark.parametrize(
    ("name", "value", "code", "said"),
    [
        ("gains", "1", "unknown_parameter", "no parameter gains; it has gain, count, patience_s, method, place"),
        ("secret", "1", "not_settable", "secret of robot_bridge cannot be set while it runs; what can be set is gain"),
        ("gain", "12.5", "out_of_range", "gain cannot be 12.5; it may be a number from 0.5 to 9.5"),
        ("gain", "NaN", "out_of_range", "a number from 0.5 to 9.5"),
        ("gain", '"2"', "out_of_range", 'gain cannot be "2"'),
        ("count", "2.0", "out_of_range", "a whole number from 1 to 10"),
        ("count", "true", "out_of_range", "count cannot be true"),
        ("patience_s", "31", "out_of_range", "a number from 0.1 to 30 (as configured)"),
        ("method", '"edges"', "out_of_range", 'one of null, "ridge", "threshold"'),
        ("method", "ridge", "unreadable_value", "texts need quotation marks"),
        ("count", "9" * 5000, "unreadable_value", "is no JSON"),
    ],
)
def test_what_cannot_be_set_is_refused_in_a_sentence_and_nothing_changes(name, value, code, said):
    as_configured = Config()
    agent = Counting(as_configured)
    answer = asked(Parameters(agent), name, value)
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, code)
    assert said in answer.reason
    assert agent.config is as_configured


def test_a_value_that_does_not_go_with_the_others_is_refused_by_the_config_itself():
    agent = Counting()
    parameters = Parameters(agent)
    assert asked(parameters, "count", "10").outcome is Outcome.ACCEPTED
    answer = asked(parameters, "gain", "9.5")
    assert (answer.code, "must be below 90" in answer.reason) == ("does_not_fit", True)
    assert agent.config.gain == 2.0


def test_what_was_made_smaller_can_be_made_as_great_as_it_was_configured():
    agent = Counting()
    parameters = Parameters(agent)
    for value in ("1.5", "30"):
        assert asked(parameters, "patience_s", value).outcome is Outcome.ACCEPTED
        assert agent.config.patience_s == float(value)


def test_the_configuration_tells_all_parameters_and_its_hash_changes_with_them():
    parameters = Parameters(Counting())
    before = parameters.told(1, "c0ffee")
    assert json.loads(before.parameters)["place"] == [[1, 0], [0, 1]]
    assert [p.name for p in before.settable] == ["gain", "count", "patience_s", "method"]
    assert (before.config_hash, any(p.is_set for p in before.settable)) == ("c0ffee", False)
    asked(parameters, "gain", "4")
    during = parameters.told(2, "c0ffee")
    assert json.loads(during.parameters)["gain"] == 4
    assert [p.name for p in during.settable if p.is_set] == ["gain"]
    assert during.config_hash != "c0ffee"
    asked(parameters, "gain", "2.0")
    assert parameters.told(1, "c0ffee") == before


def test_a_told_configuration_restores_what_was_set_and_nothing_else():
    there = Parameters(Counting())
    asked(there, "gain", "4")
    asked(there, "method", '"ridge"')
    agent = Counting(Config(count=5))
    list(Parameters(agent).step(Received(CONFIGURATION, "k", 0, there.told(1, ""))))
    assert (agent.config.gain, agent.config.method, agent.config.count) == (4.0, "ridge", 5)


def test_an_agent_without_config_has_no_parameters():
    class Bare:
        kind, instance, inputs, outputs, commands, tick_hz = "planner", "main", (), (), (), None

        def step(self, arrived) -> list[Output]:
            assert arrived
            return []

    parameters = Parameters(Bare())
    assert parameters.told(1, "c0ffee").parameters == "{}"
    assert "it has none" in asked(parameters, "gain", "1").reason


@dataclass(frozen=True)
class Entry:
    key: str
    epoch: int
    sequence: int
    payload: bytes


@pytest.fixture
def recorded(session):
    """Everything of an agent, and the frames, as a recording has them: a list that fills."""
    entries = []

    def record(tapped):
        entries.append(Entry(tapped.key, tapped.beside.epoch, tapped.beside.sequence, tapped.payload))

    kept = tap(session, "test", (FRAMES, EXECUTION, COMMANDS, CONFIGURATION), record, lambda *_: None)
    yield entries
    for declared in kept:
        declared.undeclare()


@pytest.fixture
def frames(session, heard_by_others):
    """Publishes the next frame."""
    heard_by_others(session, key("test", FRAMES))
    sent = iter(range(1000))

    def send():
        number = next(sent)
        payload = encode(StereoFrame(FrameStamp(number, 0, 0, ""), IMAGE, IMAGE))
        session.put(key("test", FRAMES), payload, attachment=pack(Attachment(7, number, 0, 0.0)))

    return send


def of(entries, name):
    return [entry for entry in list(entries) if entry.key.endswith(name)]


def said(entries):
    return [decode(ExecutionEvent, entry.payload).reason for entry in of(entries, "execution")]


def test_a_parameter_is_set_while_the_agent_runs_and_replays_repeat_what_follows(
    running, session, settings, recorded, frames, until, caplog
):
    running(Counting())
    until(lambda: frames() or said(recorded))
    with connected(settings, DEADLINE_S) as connection:
        command = SetParameter(new_header("anna", DEADLINE_S), "gain", "5")
        for _ in range(2):
            answer = send_command(session, "test", SET, command, "psm1", agent="robot_bridge")
            assert answer.outcome is Outcome.ACCEPTED
        until(lambda: frames() or "at gain 5.0, None" in said(recorded)[-1])
        refused = connection.set_parameter("robot_bridge", "psm1", "gain", 50, "anna")
        assert (refused.outcome, refused.code) == (Outcome.REFUSED, "out_of_range")
        assert connection.set_parameter("robot_bridge", "psm1", "method", "ridge", "ben").outcome is Outcome.ACCEPTED
        until(lambda: frames() or "at gain 5.0, ridge" in said(recorded)[-1])
        told = until(lambda: (c := connection.configurations().get("robot_bridge/psm1")) and c.settable[3].is_set and c)
    assert json.loads(told.parameters)["gain"] == 5.0
    records = [decode(CommandRecord, entry.payload) for entry in of(recorded, "command")]
    audit = [(decode(SetParameter, r.payload).header.sender, r.answer.outcome) for r in records]
    assert audit == [("anna", Outcome.ACCEPTED), ("anna", Outcome.REFUSED), ("ben", Outcome.ACCEPTED)]
    told_to_people = [said for said in caplog.messages if "was set to" in said]
    assert told_to_people == ["gain was set to 5 by anna", 'method was set to "ridge" by ben']
    ridges = len([text for text in said(recorded) if "ridge" in text])
    until(lambda: frames() or len([text for text in said(recorded) if "ridge" in text]) > ridges)
    entries = list(recorded)
    outputs = of(entries, "execution")
    repeated = list(replay(Counting, entries))
    assert all(r.same and not r.missing for r in repeated)
    assert len(repeated) == len(outputs)
    # a recording that began after all was set knows of the commands by the configuration alone
    late = [*of(entries, "configuration")[-1:], *of(entries, "frames"), outputs[-1]]
    (last,) = replay(Counting, late)
    assert (last.same, last.missing) == (True, ())
    (without,) = replay(Counting, late[1:])
    assert [c.key for c in without.missing] == [key("test", CONFIGURATION, "psm1", "robot_bridge")]
