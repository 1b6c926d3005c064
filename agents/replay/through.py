"""Agents on a recording, one after the other: each is fed exactly what it consumed, and says what it makes of it now.

What one of them says takes the place of what was recorded, at its recorded time, before the next one is fed. So a
change of perception shows in threads and plans. Where an output cannot be repeated, the recorded one stays.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from schemas.messages import CommandAnswer
from schemas.topics import Topic
from shared.clock import monotonic_s
from shared.recording.mcap_file import Entry
from shared.runtime.agent import Agent, Command, Input, Output, Received, Tick, awaited
from shared.runtime.replay import Replayed, replay

Place = tuple[str, int, int]
"""Key, run and number of a message."""


@dataclass(frozen=True)
class Stage:
    """An agent to replay: its name, such as `robot_bridge/psm1`, and what builds it as it was before its first step."""

    name: str
    build: Callable[[], Agent]


@dataclass(frozen=True)
class Outcome:
    """What became of one stage.

    Fields:
        steps_ms: how long each step took.
        faults: how many of them raised, the first of them with these words.
    """

    stage: str
    outputs: tuple[Replayed, ...]
    steps_ms: tuple[float, ...]
    faults: int
    first_fault: str

    @property
    def step_s(self) -> float:
        """What the steps took together."""
        return 1e-3 * sum(self.steps_ms)

    @property
    def unrepeatable(self) -> list[Replayed]:
        """The outputs whose inputs the recording lacks."""
        return [output for output in self.outputs if output.missing]

    @property
    def compared(self) -> list[Replayed]:
        """The other ones."""
        return [output for output in self.outputs if not output.missing]


def replay_through(stages: Sequence[Stage], recording: Sequence[Entry]) -> tuple[list[Outcome], list[Entry]]:
    """What each stage says, and the recording with that in it; the same recording always gives the same bytes.

    Raises:
        ReplayError, MessageError: where the recording holds what cannot be fed.
    """
    outcomes: list[Outcome] = []
    for stage in stages:
        outcome = _replayed(stage, recording)
        outcomes.append(outcome)
        recording = with_replayed(recording, outcome.outputs)
    return outcomes, list(recording)


def with_replayed(recording: Iterable[Entry], outputs: Iterable[Replayed]) -> list[Entry]:
    """The recording with the replayed outputs in the places of the recorded ones; without those made no more."""
    now: dict[Place, bytes | None] = {(r.key, r.epoch, r.sequence): r.now for r in outputs if not r.missing}
    result: list[Entry] = []
    for entry in recording:
        payload = now.get((entry.key, entry.epoch, entry.sequence), entry.payload)
        if payload is not None:
            result.append(entry if payload is entry.payload else replace(entry, payload=payload))
    return result


def _replayed(stage: Stage, recording: Iterable[Entry]) -> Outcome:
    timed: list[_Timed] = []

    def build() -> Agent:
        timed.append(_Timed(stage.build()))
        return timed[-1]

    try:
        outputs = tuple(replay(build, recording, from_own_state=True))
    finally:
        for agent in timed:
            agent.close()
    faults = [fault for agent in timed for fault in agent.faults]
    first = faults[0] if faults else ""
    steps_ms = tuple(step_ms for agent in timed for step_ms in agent.steps_ms)
    return Outcome(stage.name, outputs, steps_ms, len(faults), first)


class _Timed:
    """An agent whose steps are timed and counted; one that raises is a fault, and gives nothing, as when live."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self.steps_ms: list[float] = []
        self.faults: list[str] = []
        self.kind, self.instance, self.tick_hz = agent.kind, agent.instance, agent.tick_hz
        self.inputs: tuple[Input, ...] = agent.inputs
        self.outputs: tuple[Topic, ...] = agent.outputs
        self.commands: tuple[Topic, ...] = agent.commands
        self.goes_on_from: Topic | None = getattr(agent, "goes_on_from", None)

    def step(self, arrived: Received | Tick | Command) -> list[Output | CommandAnswer]:
        began_s = monotonic_s()
        try:
            return awaited(self._agent.step(arrived))
        except Exception as error:
            self.faults.append(f"{type(error).__name__}: {error}")
            return []
        finally:
            self.steps_ms.append(1e3 * (monotonic_s() - began_s))

    def close(self) -> None:
        close: Any = getattr(self._agent, "close", None)
        if close is not None:
            close()
