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
    FrameStamp,
    Image,
    ImageEncoding,
    Outcome,
    SetParameter,
    StereoFrame,
)
from schemas.topics import COMMANDS, CONFIGURATION, EXECUTION, FRAMES, SET, key
from shared.recording.entry import Entry as Recorded
from shared.runtime.agent import Agent, Command, Input, Output, Received
from shared.runtime.attachment import Attachment, pack
from shared.runtime.commands import new_header, send_command
from shared.runtime.connection import connected
from shared.runtime.parameters import Between, OneOf, Parameters, meant, settable
from shared.runtime.replay import replay
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


class Counting(Agent):
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
    assert type(config.count) is int
    assert 1 <= config.count <= 10
    assert 0.1 <= config.patience_s <= 30
    assert config.method in (None, "ridge", "threshold")
    assert (answer.outcome is Outcome.ACCEPTED) == (getattr(config, name) == meant(value) and type(value) is not bool)
    assert type(config.gain) is float


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


def test_the_configuration_tells_all_parameters_and_what_was_set_and_restores_that_alone():
    parameters = Parameters(Counting())
    before = parameters.told(1, "c0ffee")
    assert json.loads(before.parameters)["place"] == [[1, 0], [0, 1]]
    assert [p.name for p in before.settable] == ["gain", "count", "patience_s", "method"]
    assert (before.config_hash, any(p.is_set for p in before.settable)) == ("c0ffee", False)
    asked(parameters, "gain", "4")
    asked(parameters, "method", '"ridge"')
    during = parameters.told(2, "c0ffee")
    assert json.loads(during.parameters)["gain"] == 4
    assert [p.name for p in during.settable if p.is_set] == ["gain", "method"]
    assert during.config_hash != "c0ffee"
    elsewhere = Counting(Config(count=5))
    list(Parameters(elsewhere).step(Received(CONFIGURATION, "k", 0, during)))
    assert (elsewhere.config.gain, elsewhere.config.method, elsewhere.config.count) == (4.0, "ridge", 5)
    asked(parameters, "gain", "2.0")
    asked(parameters, "method", "null")
    assert parameters.told(1, "c0ffee") == before


def test_an_agent_without_config_has_no_parameters():
    class Bare(Agent):
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
    repeated: bool = False


class Session:
    """A rig of one agent: its frames are sent here, and all is recorded."""

    def __init__(self, session):
        self.entries, self._session, self._numbers = [], session, iter(range(10**6))
        self.kept = tap(session, "test", (FRAMES, EXECUTION, COMMANDS, CONFIGURATION), self._record, lambda *_: None)

    def _record(self, tapped):
        self.entries.append(Entry(tapped.key, tapped.beside.epoch, tapped.beside.sequence, tapped.payload))

    def of(self, name):
        return [entry for entry in list(self.entries) if entry.key.endswith(name)]

    def says_of_the_next_frame(self, what):
        """Send one; whether the newest output says so."""
        number = next(self._numbers)
        payload = encode(StereoFrame(FrameStamp(number, 0, 0, ""), IMAGE, IMAGE))
        self._session.put(key("test", FRAMES), payload, attachment=pack(Attachment(7, number, 0, 0.0)))
        said = [decode(ExecutionEvent, entry.payload).reason for entry in self.of("execution")]
        return bool(said) and what in said[-1]


@pytest.fixture
def rig(session):
    made = Session(session)
    yield made
    for declared in made.kept:
        declared.undeclare()


def test_a_parameter_is_set_while_the_agent_runs_and_replays_repeat_what_follows(
    running, session, settings, rig, until, caplog
):
    running(Counting())
    until(lambda: rig.says_of_the_next_frame("at gain 2.0, None"))
    with connected(settings, DEADLINE_S) as connection:
        command = SetParameter(new_header("anna", DEADLINE_S), "gain", "5")
        for _ in range(2):
            answer = send_command(session, "test", SET, command, "psm1", agent="robot_bridge")
            assert answer.outcome is Outcome.ACCEPTED
        until(lambda: rig.says_of_the_next_frame("at gain 5.0, None"))
        assert connection.set_parameter("robot_bridge", "psm1", "gain", 50, "anna").code == "out_of_range"
        assert connection.set_parameter("robot_bridge", "psm1", "method", "ridge", "ben").outcome is Outcome.ACCEPTED
        until(lambda: rig.says_of_the_next_frame("at gain 5.0, ridge"))
        told = until(lambda: (c := connection.configurations().get("robot_bridge/psm1")) and c.settable[3].is_set and c)
    assert json.loads(told.parameters)["gain"] == 5.0
    until(lambda: len(rig.of("command")) == len(rig.of("configuration")) == 3)
    records = [decode(CommandRecord, entry.payload) for entry in rig.of("command")]
    audit = [(decode(SetParameter, r.payload).header.sender, r.answer.outcome) for r in records]
    assert audit == [("anna", Outcome.ACCEPTED), ("anna", Outcome.REFUSED), ("ben", Outcome.ACCEPTED)]
    told_to_people = [said for said in caplog.messages if "was set to" in said]
    assert told_to_people == ["gain was set to 5 by anna", 'method was set to "ridge" by ben']
    entries = list(rig.entries)
    repeated = list(replay(Counting, entries))
    assert len(repeated) == sum(entry.key.endswith("execution") for entry in entries)
    assert all(r.same and not r.missing for r in repeated)


def test_a_recording_that_began_after_all_was_set_knows_of_it_by_the_configuration_alone():
    there = Parameters(Counting())
    asked(there, "gain", "5")
    name, state = key("test", EXECUTION, "psm1"), key("test", CONFIGURATION, "psm1", "robot_bridge")
    configuration = Entry(state, 9, 1, encode(there.told(1, "")))
    seen = Entry(key("test", FRAMES), 7, 3, encode(StereoFrame(FrameStamp(3, 0, 0, ""), IMAGE, IMAGE)))
    listed = Consumed(state, 9, 1), Consumed(seen.key, 7, 3)
    said = "frame 3 at gain 5.0, None"
    event = ExecutionEvent("p", "psm1", 0, ExecutionKind.HELD, None, "said", said, "a", consumed=listed)
    output = Entry(name, 9, 0, encode(event))
    (last,) = replay(Counting, [configuration, seen, output])
    assert (last.same, last.missing) == (True, ())
    (without,) = replay(Counting, [seen, output])
    assert without.missing == (listed[0],)


def test_agents_that_are_replayed_together_have_what_was_set_but_for_what_the_replay_gives():
    there = Parameters(Counting())
    asked(there, "gain", "5")
    asked(there, "count", "7")
    name, state = key("test", EXECUTION, "psm1"), key("test", CONFIGURATION, "psm1", "robot_bridge")
    frame = StereoFrame(FrameStamp(3, 0, 0, ""), IMAGE, IMAGE)
    listed = Consumed(state, 9, 1), Consumed(key("test", FRAMES), 7, 3)
    event = ExecutionEvent("p", "psm1", 0, ExecutionKind.HELD, None, "said", "frame 3 at gain 5.0, None", "a", listed)
    entries = [
        Recorded(state, 9, 1, encode(there.told(1, "")), 1, 1),
        Recorded(key("test", FRAMES), 7, 3, encode(frame), 2, 2),
        Recorded(name, 9, 0, encode(event), 3, 3),
    ]
    made = list[Counting]()

    def build():
        made.append(Counting())
        return made[-1]

    for given_here, gain in ((frozenset[str](), 5.0), (frozenset({"gain"}), 2.0)):
        (outcome,), _ = replay_through([Stage("robot_bridge/psm1", build, given_here)], entries)
        (output,) = outcome.outputs
        assert (output.same, outcome.faults) == (not given_here, 0)
        assert (made[-1].config.gain, made[-1].config.count) == (gain, 7)


def test_auto_leaves_the_choice_to_the_agent():
    agent = Counting()
    parameters = Parameters(agent)
    asked(parameters, "method", '"ridge"')
    assert asked(parameters, "method", '"auto"').outcome is Outcome.ACCEPTED
    assert agent.config.method is None
    assert json.loads(parameters.told(1, "").parameters)["method"] == "auto"
