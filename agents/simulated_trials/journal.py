"""The journal of an evaluation: what is tried on its first line, and one line for each trial that came to an end.

Lines are appended whole, so whatever ends a run costs it the trials under way; a line cut short is left out, and
written anew.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar, Generic, TypeVar

from pydantic import ValidationError

from agents.simulated_trials.look import Came
from agents.simulated_trials.protocol import Protocol, Tried
from shared.runtime.config import ConfigError, Settings

AnyProtocol = TypeVar("AnyProtocol", bound=Settings)
AnyCame = TypeVar("AnyCame", bound=Tried)
AnyTrial = TypeVar("AnyTrial", bound=Settings)


class JournalOf(Generic[AnyProtocol, AnyCame]):
    """A journal that is open for one run.

    Fields:
        protocol_type, came_type: what its lines are, which each kind of evaluation names.
        protocol: what is tried.
        came: what came of the trials so far.
    """

    protocol_type: ClassVar[type[Settings]]
    came_type: ClassVar[type[Tried]]

    def __init__(self, path: Path, protocol: AnyProtocol | None) -> None:
        """Read a journal, or begin one with a protocol where there is none.

        Raises:
            ConfigError: where it is none, or holds another protocol.
            OSError: where it cannot be read or written.
        """
        self._path = path
        self.protocol: AnyProtocol
        self.came: list[AnyCame]
        if path.exists() and path.stat().st_size:
            self.protocol, self.came = self._read()
            if protocol is not None and protocol != self.protocol:
                raise ConfigError(f"{path} is of another evaluation: {_otherwise(self.protocol, protocol)}")
        elif protocol is None:
            raise ConfigError(f"there is no {path}, so there is nothing to tell")
        else:
            self.protocol, self.came = protocol, []
            path.write_text(protocol.model_dump_json() + "\n", encoding="utf-8")

    def note(self, came: AnyCame) -> None:
        """Add what came of a trial."""
        self.came.append(came)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(came.model_dump_json(exclude_none=True) + "\n")

    def left(self, trials: Iterable[AnyTrial]) -> list[AnyTrial]:
        """Those of the trials that came to no end yet."""
        ended = {one.trial for one in self.came}
        return [trial for trial in trials if trial not in ended]

    def _read(self) -> tuple[AnyProtocol, list[AnyCame]]:
        path = self._path
        text = path.read_text(encoding="utf-8")
        lines = text.split("\n")
        if not text.endswith("\n"):
            # the end of a line that was cut short would spoil the next one
            path.write_text("".join(f"{line}\n" for line in lines[:-1]), encoding="utf-8")
        try:
            protocol, *came = lines[:-1]
            read = self.protocol_type.model_validate_json(protocol)
            return read, [self.came_type.model_validate_json(line) for line in came]  # pyright: ignore[reportReturnType]
        except (ValueError, ValidationError):
            raise ConfigError(f"{path} is no journal of an evaluation; give another folder") from None


class Journal(JournalOf[Protocol, Came]):
    """Of an evaluation of grasping."""

    protocol_type, came_type = Protocol, Came


def _otherwise(noted: Settings, asked: Settings) -> str:
    told = [
        f"{name} {getattr(noted, name)!r}, not {getattr(asked, name)!r}"
        for name in type(noted).model_fields
        if getattr(noted, name) != getattr(asked, name)
    ]
    return "; ".join(told) + "; give another folder"
