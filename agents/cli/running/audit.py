"""Who had a real arm do what: a line of JSON for every command, answer, refusal, arming and end of a motion.

Lines are only ever added. Each is written with one call as it happens, before the answer leaves, so that what a process
has answered is in the file however the process ends. Where nothing can be written nothing is carried out.
"""

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import schemas
from agents.cli.rig.config import RigConfig
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.backend import Backend
from schemas.messages import Arm, ChangeState, CommandAnswer, ExecutionEvent
from schemas.topics import EXECUTION
from shared.clock import now_ns
from shared.runtime.agent import Command, Output, Received, Tick

STATE_DIRECTORY = "STATE_DIRECTORY"
"""Where systemd lets a service write."""
FOLDER, OTHERWISE = "audit", Path("sessions")
MODE = 0o640


class AuditError(RuntimeError):
    """An audit log that cannot be written; the text names the file and the reason."""


def audit_of(rig: RigConfig, name: str) -> "AuditLog":
    """The log of a process, such as `robot_bridge psm1`, on this host."""
    kept = os.environ.get(STATE_DIRECTORY)
    sessions = rig.recorder.folder if rig.recorder is not None else OTHERWISE
    return AuditLog((Path(kept) if kept else sessions) / FOLDER / f"{name.replace(' ', '-')}.jsonl")


class AuditLog:
    """A file that lines are added to; it is opened with the first of them."""

    def __init__(self, path: Path) -> None:
        self.path, self._file = path, None

    def add(self, what: str, at_ns: int, **told: Any) -> None:
        """Add a line.

        Raises:
            AuditError: where it cannot be written.
        """
        line = json.dumps({"at_ns": at_ns, "what": what} | told) + "\n"
        try:
            if self._file is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._file = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, MODE)
            written = os.write(self._file, line.encode())
        except OSError as error:
            raise AuditError(f"the audit log {self.path} cannot be written: {error.strerror or error}") from None
        if written < len(line):
            raise AuditError(f"the audit log {self.path} cannot be written: the disk is full")


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
