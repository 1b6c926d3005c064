"""Who had a real arm do what: a line of JSON for every command, answer, refusal, arming and end of a motion.

Lines are only ever added. Each is written with one call as it happens, before the answer leaves, so that what a process
has answered is in the file however the process ends. Where nothing can be written nothing is carried out.
"""

import json
import os
from pathlib import Path
from typing import Any

from agents.configuration.rig import RigConfig

STATE_DIRECTORY = "STATE_DIRECTORY"
"""Where systemd lets a service write."""
FOLDER = "audit"
MODE = 0o640


class AuditError(RuntimeError):
    """An audit log that cannot be written; the text names the file and the reason."""


def audit_of(rig: RigConfig, name: str) -> "AuditLog":
    """The log of a process, such as `robot_bridge psm1`, on this host."""
    return AuditLog(state_folder(rig) / FOLDER / f"{name.replace(' ', '-')}.jsonl")


def state_folder(rig: RigConfig, of: Path | None = None) -> Path:
    """Where a process of this host keeps what it must know when it begins anew: beside the file that it is `of`."""
    if kept := os.environ.get(STATE_DIRECTORY):
        return Path(kept)
    if of is not None:
        return of.resolve().parent
    return rig.sessions


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
