"""Where a session's files lie: a folder of its own, named for when it began."""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from shared.clock import now_ns


@dataclass(frozen=True)
class SessionFolder:
    """The files of one session."""

    path: Path

    @property
    def recording(self) -> Path:
        """Everything that was published."""
        return self.path / "session.mcap"

    @property
    def rerun(self) -> Path:
        """What the viewer shows of it."""
        return self.path / "session.rrd"

    def log(self, name: str) -> Path:
        """What one process printed."""
        return self.path / f"{name.replace(' ', '_')}.log"


def new_session_folder(folder: Path) -> SessionFolder:
    """A new folder for a session that begins now.

    Raises:
        OSError: where it cannot be made.
    """
    stem = datetime.fromtimestamp(now_ns() * 1e-9, UTC).astimezone().strftime("%Y-%m-%d_%H-%M-%S")
    for number in range(1000):
        path = folder / (stem if number == 0 else f"{stem}_{number}")
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        return SessionFolder(path)
    raise FileExistsError(f"{folder} already holds sessions of this second")


def free_path(path: Path) -> Path:
    """That path, or, where it is taken by what a process wrote before it was restarted, one with a number."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_stem(f"{path.stem}-{number}")
    return free
