"""The journal of an evaluation: what is tried on its first line, and one line for each trial that came to an end.

Lines are appended whole, so whatever ends a run costs it the trials under way; a line cut short is left out, and
written anew.
"""

from collections.abc import Iterable
from pathlib import Path

from pydantic import ValidationError

from agents.simulated_trials.look import Came
from agents.simulated_trials.protocol import Protocol, Trial
from shared.runtime.config import ConfigError


class Journal:
    """A journal that is open for one run.

    Fields:
        protocol: what is tried.
        came: what came of the trials so far.
    """

    def __init__(self, path: Path, protocol: Protocol | None) -> None:
        """Read a journal, or begin one with a protocol where there is none.

        Raises:
            ConfigError: where it is none, or holds another protocol.
            OSError: where it cannot be read or written.
        """
        self._path = path
        if path.exists() and path.stat().st_size:
            self.protocol, self.came = _read(path)
            if protocol is not None and protocol != self.protocol:
                raise ConfigError(f"{path} is of another evaluation: {_otherwise(self.protocol, protocol)}")
        elif protocol is None:
            raise ConfigError(f"there is no {path}, so there is nothing to tell")
        else:
            self.protocol, self.came = protocol, []
            path.write_text(protocol.model_dump_json() + "\n", encoding="utf-8")

    def note(self, came: Came) -> None:
        """Add what came of a trial."""
        self.came.append(came)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(came.model_dump_json(exclude_none=True) + "\n")

    def left(self, trials: Iterable[Trial]) -> list[Trial]:
        """Those of the trials that came to no end yet."""
        ended = {(one.trial.name, one.trial.tool_error_mm) for one in self.came}
        return [trial for trial in trials if (trial.name, trial.tool_error_mm) not in ended]


def _read(path: Path) -> tuple[Protocol, list[Came]]:
    text = path.read_text(encoding="utf-8")
    lines = text.split("\n")
    if not text.endswith("\n"):
        # the end of a line that was cut short would spoil the next one
        path.write_text("".join(f"{line}\n" for line in lines[:-1]), encoding="utf-8")
    try:
        protocol, *came = lines[:-1]
        return Protocol.model_validate_json(protocol), [Came.model_validate_json(line) for line in came]
    except (ValueError, ValidationError):
        raise ConfigError(f"{path} is no journal of an evaluation; give another folder") from None


def _otherwise(noted: Protocol, asked: Protocol) -> str:
    told = [
        f"{name} {getattr(noted, name)!r}, not {getattr(asked, name)!r}"
        for name in Protocol.model_fields
        if getattr(noted, name) != getattr(asked, name)
    ]
    return "; ".join(told) + "; give another folder"
