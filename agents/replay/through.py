"""Agents on a recording: each is fed exactly what it consumed, and says what it makes of it now.

What one of them says takes the place of what was recorded before whoever consumed that is fed. So a change of
perception shows in threads and plans, and in what perception itself makes of those threads. Where an output cannot be
repeated, the recorded one stays.
"""

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from schemas.messages import CommandAnswer
from shared.clock import monotonic_s
from shared.recording.mcap_file import Entry
from shared.runtime.agent import Agent, Command, Output, Received, Tick, awaited
from shared.runtime.replay import Place, Replay, Replayed, Step, place_of


@dataclass(frozen=True)
class Stage:
    """An agent to replay.

    Fields:
        name: such as `robot_bridge/psm1`.
        build: makes it as it was before its first step.
        given: fields of its config that this replay gives, which stay so though they were set while it ran.
    """

    name: str
    build: Callable[[], Agent]
    given: frozenset[str] = frozenset()


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
    replaying = [_Replaying(stage, recording) for stage in stages]
    try:
        together = _Together(replaying, recording)
        for owner, number in together.in_order():
            together.run_until(owner, number)
        outcomes = [each.outcome() for each in replaying]
    finally:
        for each in replaying:
            each.close()
    return outcomes, with_replayed(recording, [output for outcome in outcomes for output in outcome.outputs])


def with_replayed(recording: Iterable[Entry], outputs: Iterable[Replayed]) -> list[Entry]:
    """The recording with the replayed outputs in the places of the recorded ones; without those made no more."""
    now: dict[Place, bytes | None] = {place_of(r): r.now for r in outputs if not r.missing}
    result: list[Entry] = []
    for entry in recording:
        payload = now.get(place_of(entry), entry.payload)
        if payload is not None:
            result.append(entry if payload is entry.payload else replace(entry, payload=payload))
    return result


class _Replaying:
    """One stage, and how far it has come.

    Fields:
        done: how many of its steps were repeated.
    """

    def __init__(self, stage: Stage, recording: Sequence[Entry]) -> None:
        self._stage, self._timed = stage, list[_Timed]()
        self.replay = Replay(self._build, recording, from_own_state=True)
        self.done = 0
        self._outputs = list[Replayed]()

    def _build(self) -> "_Timed":
        self._timed.append(_Timed(self._stage.build(), self._stage.given))
        return self._timed[-1]

    def repeat_next(self) -> list[Replayed]:
        """The outputs of the next step."""
        step = self.replay.steps[self.done]
        self.done += 1
        made = self.replay.repeat(step)
        self._outputs += made
        return made

    def outcome(self) -> Outcome:
        """What became of it."""
        faults = [fault for agent in self._timed for fault in agent.faults]
        steps_ms = tuple(step_ms for agent in self._timed for step_ms in agent.steps_ms)
        return Outcome(self._stage.name, tuple(self._outputs), steps_ms, len(faults), faults[0] if faults else "")

    def close(self) -> None:
        """Let the agents go."""
        for agent in self._timed:
            agent.close()


class _Together:
    """Several stages, each step after those that made what it consumed: agents may consume each other's outputs."""

    def __init__(self, stages: Sequence[_Replaying], recording: Sequence[Entry]) -> None:
        self._stages, self._recorded = stages, {place_of(entry): entry for entry in recording}
        self._made_by = {
            place_of(output): (stage, number)
            for stage in stages
            for number, step in enumerate(stage.replay.steps)
            for output in step.outputs
        }

    def in_order(self) -> list[tuple[_Replaying, int]]:
        """All steps, by when the recorder heard of them."""
        steps = [(stage, number) for stage in self._stages for number in range(len(stage.replay.steps))]
        return sorted(steps, key=lambda step: self._received_ns(step[0].replay.steps[step[1]]))

    def run_until(self, stage: _Replaying, number: int) -> None:
        """Repeat steps of a stage up to this one, and before each what it consumed."""
        while stage.done <= number:
            for consumed in stage.replay.steps[stage.done].consumed:
                made_by = self._made_by.get(place_of(consumed))
                if made_by is not None and made_by[0] is not stage:
                    self.run_until(*made_by)
            for output in stage.repeat_next():
                self._put(output, stage)

    def _put(self, output: Replayed, by: _Replaying) -> None:
        """Have what is made now consumed by other stages in place of what was recorded; its own goes on by itself."""
        if output.missing:
            return
        place = place_of(output)
        for messages in (stage.replay.messages for stage in self._stages if stage is not by):
            if place in messages:
                if output.now is None:
                    del messages[place]
                else:
                    messages[place] = replace(self._recorded[place], payload=output.now)

    def _received_ns(self, step: Step) -> int:
        return min(self._recorded[place_of(output)].received_ns for output in step.outputs)


class _Timed(Agent):
    """An agent whose steps are timed and counted; one that raises is a fault, and gives nothing, as when live."""

    def __init__(self, agent: Agent, given: frozenset[str]) -> None:
        self._agent, self._given = agent, given
        self.steps_ms: list[float] = []
        self.faults: list[str] = []
        self.kind, self.instance, self.tick_hz = agent.kind, agent.instance, agent.tick_hz
        self.inputs, self.outputs, self.commands = agent.inputs, agent.outputs, agent.commands
        self.goes_on_from, self.config = agent.goes_on_from, agent.config

    def step(self, arrived: Received | Tick | Command) -> list[Output | CommandAnswer]:
        began_s = monotonic_s()
        try:
            return awaited(self._agent.step(arrived))
        except Exception as error:
            self.faults.append(f"{type(error).__name__}: {error}")
            return []
        finally:
            self.steps_ms.append(1e3 * (monotonic_s() - began_s))

    def configure(self, config: Any) -> None:
        kept = {name: getattr(self.config, name) for name in self._given}
        self.config = dataclasses.replace(config, **kept)
        self._agent.configure(self.config)

    def close(self) -> None:
        self._agent.close()
