"""Files that are there whole or not at all."""

import contextlib
import os
from collections.abc import Generator
from pathlib import Path

from shared.terminal import UsageError


class OutputError(UsageError):
    """A result that cannot be written; the text names the file and the reason."""


@contextlib.contextmanager
def whole_file(path: Path) -> Generator[Path]:
    """Where to write what takes the place of `path` at the end of the block; until then what is there stays.

    Devices and pipes are written directly. A link stays, and the file that it leads to is replaced.

    Raises:
        OutputError: where the file cannot be written.
    """
    direct = path.exists() and not path.is_file()
    target = Path(os.path.realpath(path))
    unfinished = path if direct else target.with_name(f".suturegrasp-{os.getpid()}{target.suffix}")
    try:
        yield unfinished
        if not direct:
            unfinished.replace(target)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error
    finally:
        if not direct:
            with contextlib.suppress(OSError):
                unfinished.unlink(missing_ok=True)
