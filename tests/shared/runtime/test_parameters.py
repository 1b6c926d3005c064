"""Parameters of running agents: what may be set, what is refused, who is told, and what a replay makes of it."""

import json
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.replay.through import Stage, replay_through
from schemas.checks import require
from schemas.codec import decode, encode
from schemas.messages import (
    CommandAnswer,
    CommandRecord,
    Consumed,
    ExecutionEvent,
    ExecutionKind,
    Outcome,
    SetParameter,
)
from schemas.topics import COMMANDS, CONFIGURATION, EXECUTION, FRAMES, SET, key
from shared.recording.entry import Entry
from shared.runtime.agent import Agent, Command, Input, Output, Received
from shared.runtime.commands import new_header, send_command
from shared.runtime.connection import connected
from shared.runtime.parameters import Between, OneOf, Parameters, meant, settable
from shared.runtime.replay import replay
from shared.runtime.taps import tap
from tests.shared.runtime.conftest import Idle, beside, frame_bytes

DEADLINE_S = 60.0
FRAME_KEY, SAID_KEY = key("test", FRAMES), key("test", EXECUTION, "psm1")


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


def event(said, consumed=()):
    return ExecutionEvent("p", "psm1", 0, ExecutionKind.HELD, None, "said", said, "a", consumed)


class Counting(Agent):
    """Says after every frame what it is set to; nothing of that is in what it says it goes on from."""

    kind, instance = "robot_bridge", "psm1"
    inputs, outputs = (Input(FRAMES, only_newest_counts=True),), (EXECUTION,)

    def __init__(self, config=Config()):
        self.config = config

    def step(self, arrived):
        assert isinstance(arrived, Received)
        said = f"frame {arrived.message.stamp.sequence} at gain {self.config.gain}, {self.config.method}"
        yield Output(EXECUTION, event(said))


def asked(parameters, name, value) -> CommandAnswer:
    command = Command(SET, "psm1", SetParameter(new_header("a test"), name, value), 0)
    (answer,) = parameters.step(command)
    assert isinstance(answer, CommandAnswer)
    return answer


def anything_of_json():
    leaves = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
    return st.recursive(leaves, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=4)


@given(
    name=st.sampled_from(["gain", "count", "patience_s", "method"]),
    value=st.floats(0, 10) | st.integers(0, 10) | anything_of_json(),
)
def test_whatever_is_asked_the_config_stays_within_what_is_allowed(name, value):
    agent = Counting()
    answer = asked(Parameters(agent), name, json.dumps(value))
    config = agent.config
    assert 0.5 <= config.gain <= 9.5
    assert type(config.gain) is float
    assert 1 <= config.count <= 10
    assert type(config.count) is int
    assert 0.1 <= config.patience_s <= 30
    assert config.method in (None, "ridge", "threshold")
    assert (answer.outcome is Outcome.ACCEPTED) == (getattr(config, name) == meant(value) and type(value) is not bool)


@pytest.mark.parametrize(
    ("name", "value", "code", "said"),
    [
        ("gains", "1", "unknown_parameter", "no parameter gains; did you mean gain?"),
        ("secret", "1", "not_settable", "secret of robot_bridge cannot be set while it runs; what can be set is gain"),
        ("gain", "12.5", "out_of_range", "gain cannot be 12.5; it may be a number from 0.5 to 9.5"),
        ("count", "true", "out_of_range", "count cannot be true; it may be a whole number from 1 to 10"),
        ("patience_s", "31", "out_of_range", "a number from 0.1 to 30 (as configured)"),
        ("method", '"edges"', "out_of_range", 'one of "auto", "ridge", "threshold"'),
        ("method", "ridge", "unreadable_value", "texts need quotation marks"),
        ("count", "9" * 5000, "unreadable_value", "is no JSON"),
        ("gain", "9.5", "does_not_fit", "must be below 90"),
    ],
)
def test_what_cannot_be_set_is_refused_in_a_sentence_and_nothing_changes(name, value, code, said):
    as_configured = Config(count=9 + (code == "does_not_fit"))
    agent = Counting(as_configured)
    answer = asked(Parameters(agent), name, value)
    assert (answer.outcome, answer.code) == (Outcome.REFUSED, code)
    assert said in answer.reason
    assert agent.config is as_configured


def test_the_configuration_tells_all_parameters_and_what_was_set_and_restores_that_alone():
    parameters = Parameters(Counting())
    before = parameters.told(1, "c0ffee")
    assert json.loads(before.parameters)["place"] == [[1, 0], [0, 1]]
    assert [p.name for p in before.settable] == ["gain", "count", "patience_s", "method"]
    assert (before.config_hash, any(p.is_set for p in before.settable)) == ("c0ffee", False)
    for name, value in (("gain", "4"), ("method", '"ridge"'), ("patience_s", "1.5"), ("patience_s", "30")):
        # what was made smaller can be made as great as it was configured
        assert asked(parameters, name, value).outcome is Outcome.ACCEPTED
    during = parameters.told(2, "c0ffee")
    assert json.loads(during.parameters)["gain"] == 4
    assert [p.name for p in during.settable if p.is_set] == ["gain", "method"]
    assert during.config_hash != "c0ffee"
    elsewhere = Counting(Config(count=5))
    list(Parameters(elsewhere).step(Received(CONFIGURATION, "k", 0, during)))
    assert (elsewhere.config.gain, elsewhere.config.method, elsewhere.config.count) == (4.0, "ridge", 5)
    # auto leaves the choice to the agent
    for name, value in (("gain", "2.0"), ("method", '"auto"')):
        assert asked(parameters, name, value).outcome is Outcome.ACCEPTED
    assert parameters.told(1, "c0ffee") == before
    assert json.loads(before.parameters)["method"] == "auto"
    assert Parameters(Idle()).told(1, "c0ffee").parameters == "{}"


def test_what_is_set_while_an_agent_runs_is_repeated_by_replays(running, session, settings, keep, until, caplog):
    entries, numbers = [], iter(range(10**6))

    def record(tapped):
        entries.append(Entry(tapped.key, tapped.beside.epoch, tapped.beside.sequence, tapped.payload, 0, 0))

    def of(name):
        return [entry for entry in list(entries) if entry.key.endswith(name)]

    def says_of_the_next_frame(what):
        number = next(numbers)
        session.put(FRAME_KEY, frame_bytes(number), attachment=beside(number, epoch=7))
        said = [decode(ExecutionEvent, entry.payload).reason for entry in of("execution")]
        return bool(said) and what in said[-1]

    keep(*tap(session, "test", (FRAMES, EXECUTION, COMMANDS, CONFIGURATION), record, lambda *_: None))
    running(Counting())
    until(lambda: says_of_the_next_frame("at gain 2.0, None"))
    with connected(settings, DEADLINE_S) as connection:
        command = SetParameter(new_header("anna", DEADLINE_S), "gain", "5")
        for _ in range(2):
            answer = send_command(session, "test", SET, command, "psm1", agent="robot_bridge")
            assert answer.outcome is Outcome.ACCEPTED
        until(lambda: says_of_the_next_frame("at gain 5.0, None"))
        assert connection.set_parameter("robot_bridge", "psm1", "gain", 50, "anna").code == "out_of_range"
        assert connection.set_parameter("robot_bridge", "psm1", "method", "ridge", "ben").outcome is Outcome.ACCEPTED
        until(lambda: says_of_the_next_frame("at gain 5.0, ridge"))
        told = until(lambda: (c := connection.configurations().get("robot_bridge/psm1")) and c.settable[3].is_set and c)
    assert json.loads(told.parameters)["gain"] == 5.0
    until(lambda: len(of("command")) == len(of("configuration")) == 3)
    records = [decode(CommandRecord, entry.payload) for entry in of("command")]
    audit = [(decode(SetParameter, r.payload).header.sender, r.answer.outcome) for r in records]
    assert audit == [("anna", Outcome.ACCEPTED), ("anna", Outcome.REFUSED), ("ben", Outcome.ACCEPTED)]
    told_to_people = [said for said in caplog.messages if "was set to" in said]
    assert told_to_people == ["gain was set to 5 by anna", 'method was set to "ridge" by ben']
    repeated = list(replay(Counting, recorded := list(entries)))
    assert len(repeated) == sum(entry.key.endswith("execution") for entry in recorded)
    assert all(r.same and not r.missing for r in repeated)


def test_a_recording_that_began_after_all_was_set_knows_of_it_but_for_what_its_replay_gives():
    there, state = Parameters(Counting()), key("test", CONFIGURATION, "psm1", "robot_bridge")
    asked(there, "gain", "5")
    asked(there, "count", "7")
    listed = Consumed(state, 9, 1), Consumed(FRAME_KEY, 7, 3)
    configuration = Entry(state, 9, 1, encode(there.told(1, "")), 1, 1)
    seen = Entry(FRAME_KEY, 7, 3, frame_bytes(3), 2, 2)
    output = Entry(SAID_KEY, 9, 0, encode(event("frame 3 at gain 5.0, None", listed)), 3, 3)
    (last,) = replay(Counting, [configuration, seen, output])
    assert (last.same, last.missing) == (True, ())
    (without,) = replay(Counting, [seen, output])
    assert without.missing == (listed[0],)
    made = []
    for given_here, gain in ((frozenset(), 5.0), (frozenset({"gain"}), 2.0)):
        stage = Stage("robot_bridge/psm1", lambda: made.append(Counting()) or made[-1], given_here)
        (outcome,), _ = replay_through([stage], [configuration, seen, output])
        (repeated,) = outcome.outputs
        assert (repeated.same, outcome.faults) == (not given_here, 0)
        assert (made[-1].config.gain, made[-1].config.count) == (gain, 7)
