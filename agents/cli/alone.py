"""One command at a time in a folder of results: two would try everything twice."""

import contextlib
from collections.abc import Generator
from pathlib import Path

from shared.runtime.config import ConfigError


@contextlib.contextmanager
def alone(folder: Path, what: str) -> Generator[None]:
    """Have the folder for as long as this lasts.

    Args:
        what: is carried out in it, such as "experiment".

    Raises:
        ConfigError: where another one has it.
    """
    import fcntl  # not everywhere, and the other commands do without

    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(f"another {what} runs in {folder}") from None
        yield
