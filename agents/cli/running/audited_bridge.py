"""A robot bridge that writes down what it is told, what it answers, and what becomes of it (audit.py)."""

from collections.abc import Iterable

import schemas
from agents.cli.running.audit import AuditError, AuditLog
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.backend import Backend
from schemas.messages import Arm, ChangeState, CommandAnswer, ExecutionEvent
from schemas.topics import EXECUTION
from shared.clock import now_ns
from shared.runtime.agent import Command, Output, Received, Tick


class AuditedBridge(RobotBridge):
    """A robot bridge that writes down what it is told, what it answers, and what becomes of it."""

    def __init__(self, config: RobotBridgeConfig, backend: Backend, audit: AuditLog) -> None:
        super().__init__(config, backend)
        self._audit, self._begun, self._dry_run = audit, False, backend.dry_run

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output | CommandAnswer]:
        """As the bridge does; a command that cannot be written down is not carried out."""
        if not self._begun:
            self._audit.add("started", now_ns(), version=schemas.__version__, dry_run=self._dry_run)
            self._begun = True
        if isinstance(arrived, Command):
            self._note_command(arrived)
        outputs = list(super().step(arrived))
        try:
            for output in outputs:
                self._note_output(output)
        except AuditError:
            # what nobody can read afterwards does not go on
            self._execution, self._holding = None, True
            self._backend.hold()
            raise
        return outputs

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
        self._audit.add("command", command.now_ns, **told, arm=getattr(message, "arm", command.instance), **plan)

    def _note_output(self, output: Output | CommandAnswer) -> None:
        if isinstance(output, CommandAnswer):
            answer = {"id": output.id, "outcome": output.outcome.name.lower()}
            self._audit.add("answer", now_ns(), **answer, code=output.code, reason=output.reason)
        elif output.topic is EXECUTION:
            self._note_event(output.message)

    def _note_event(self, event: ExecutionEvent) -> None:
        told = {"kind": event.kind.name.lower(), "plan_id": event.plan_id, "arming_id": event.arming_id}
        phase = event.phase.name.lower() if event.phase is not None else ""
        self._audit.add("event", event.at_ns, **told, phase=phase, code=event.code, reason=event.reason)
