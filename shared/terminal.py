"""What a command says: its summary on standard output, everything else on standard error, one line each."""

import contextlib
import os
import sys
from collections.abc import Generator
from pathlib import Path


class UsageError(ValueError):
    """A command line that cannot be carried out; the text says what to give instead."""


def open_missing_streams() -> None:
    """Give Python streams that lead nowhere where a daemon has closed them, as libraries expect some."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115


def say(sentence: str) -> None:
    """Print one line to standard output; characters that it cannot show are escaped."""
    show(printable(sentence))


def show(line: str) -> bool:
    """Print a line whose spaces matter, as in a table, at once; whether anybody took it."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    with without_readers():
        print(line.encode(encoding, "backslashreplace").decode(encoding), flush=True)
        return True
    return False


def warn(sentence: str) -> None:
    """Print one line about a doubt to standard error."""
    print(f"warning: {printable(sentence)}", file=sys.stderr)


def complain(sentence: str, status: int) -> int:
    """Print the one line about a failure to standard error, and return the exit status that goes with it."""
    print(f"suturegrasp: {printable(sentence)}", file=sys.stderr)
    return status


def flush_output() -> None:
    """Write out what is buffered for standard output, if anybody takes it."""
    with without_readers():
        print(end="", flush=True)


@contextlib.contextmanager
def without_readers() -> Generator[None]:
    """Let the work go on where nobody reads standard output any more, as after `| head -1`, or its disk is full."""
    try:
        yield
    except OSError as error:
        # what is still buffered must not fail again when Python exits
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
        if not isinstance(error, BrokenPipeError):
            warn(f"standard output cannot be written to: {error.strerror or error}")


def printable(sentence: str) -> str:
    """The sentence as any terminal can show it, whatever names of files it quotes."""
    return "".join(char if char.isprintable() else "?" for char in " ".join(sentence.split()))
