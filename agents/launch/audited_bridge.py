"""A robot bridge that writes down what it is told, what it answers, and what becomes of it (audit.py).

What leads to motion is written down before it is carried out, and is not carried out where that cannot be. What stops
is carried out first: where it cannot be written down, the log says so, and the arm holds all the same.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import schemas
from agents.launch.audit import AuditError, AuditLog
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.backend import Backend
from agents.robot_bridge.plans import Code, Refusal
from schemas.messages import Arm, ChangeState, CommandAnswer, ExecutionEvent
from schemas.topics import EXECUTION
from shared.clock import now_ns
from shared.runtime.agent import Command, Output, Received, Tick
from shared.runtime.commands import stops


class AuditedBridge(RobotBridge):
    """A robot bridge that writes down what it is told, what it answers, and what becomes of it."""

    def __init__(self, config: RobotBridgeConfig, backend: Backend, audit: AuditLog) -> None:
        super().__init__(config, backend)
        self._audit, self._begun, self._dry_run = audit, False, backend.dry_run

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output | CommandAnswer]:
        """As the bridge does; a command that cannot be written down is not carried out, unless it stops the arm.

        Raises:
            AuditError: where it, or what a tick led to, cannot be written down; the arm holds.
        """
        if isinstance(arrived, Command):
            return self._stopped(arrived) if stops(arrived.message) else self._commanded(arrived)
        return self._followed(arrived)

    def _stopped(self, command: Command) -> list[Output | CommandAnswer]:
        """First the hold, then what is written of it."""
        said = list(super().step(command))
        try:
            self._note_command(command)
            for one in said:
                self._note_output(one)
        except AuditError as error:
            self._log.error("%s: the arm was stopped all the same", error)
        return said

    def _commanded(self, command: Command) -> list[Output | CommandAnswer]:
        self._note_command(command)
        said = list(super().step(command))
        try:
            for one in said:
                self._note_output(one)
        except AuditError:
            self.stop(_unwritten(), command.now_ns)
            raise
        return said

    def _followed(self, arrived: Received | Tick) -> Iterator[Output | CommandAnswer]:
        """First the bridge's own step; what nobody can read afterwards does not go on, and is told all the same."""
        unwritten: AuditError | None = None
        for one in super().step(arrived):
            try:
                self._note_output(one)
            except AuditError as error:
                unwritten = error
            yield one
        try:
            self._begin()
        except AuditError as error:
            unwritten = error
        if unwritten is not None:
            if self.executes:
                yield from self.stop(_unwritten(), arrived.now_ns if isinstance(arrived, Tick) else now_ns())
            raise unwritten

    def _begin(self) -> None:
        if not self._begun:
            self._audit.add("started", now_ns(), version=schemas.__version__, dry_run=self._dry_run)
            self._begun = True

    def _add(self, what: str, at_ns: int, **told: Any) -> None:
        self._begin()
        self._audit.add(what, at_ns, **told)

    def close(self) -> None:
        """Write down that it ends as it was told to."""
        super().close()
        if self._begun:
            self._audit.add("stopped", now_ns())

    def _note_command(self, command: Command) -> None:
        message = command.message
        told = {"topic": str(command.topic), "id": message.header.id, "sender": message.header.sender}
        plan = {"plan_id": message.plan_id} if isinstance(message, Arm) else {}
        if isinstance(message, ChangeState):
            told["word"] = message.word.name.lower()
        self._add("command", command.now_ns, **told, arm=getattr(message, "arm", command.instance), **plan)

    def _note_output(self, output: Output | CommandAnswer) -> None:
        if isinstance(output, CommandAnswer):
            answer = {"id": output.id, "outcome": output.outcome.name.lower()}
            self._add("answer", now_ns(), **answer, code=output.code, reason=output.reason)
        elif output.topic is EXECUTION:
            self._note_event(output.message)

    def _note_event(self, event: ExecutionEvent) -> None:
        told = {"kind": event.kind.name.lower(), "plan_id": event.plan_id, "arming_id": event.arming_id}
        phase = event.phase.name.lower() if event.phase is not None else ""
        self._add("event", event.at_ns, **told, phase=phase, code=event.code, reason=event.reason)


def _unwritten() -> Refusal:
    return Refusal(Code.FAULT, "the audit log cannot be written: make room, or see to its folder, then arm again")
