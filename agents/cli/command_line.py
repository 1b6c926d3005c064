"""The command line as options of a sub-command. What tyro would say in a box is said in one line."""

import contextlib
import io
import os
import re
from collections.abc import Generator
from typing import Any

import tyro

from agents.cli.commands import COMMANDS
from agents.cli.reconstruct.options import UsageError

OF_ALL = {name: command.options for name, command in COMMANDS.items()}
IN_TWO_WORDS: dict[tuple[str, ...], str] = {("calibrate", "hand-eye"): "calibrate-hand-eye"}

HELP = ("-h", "--help")
MISTYPED = re.compile(
    r"error parsing (?P<option>--\S+): No type matching .*argument helptext: \S+ (?P<wanted>[^,]+),", re.I
)
"""What tyro says of an option that takes several values, or may be left out, with all that it has tried."""
ESCAPE_SEQUENCE = re.compile(r"\x1b\[[0-9;]*m")
RULE = re.compile(r"[─-]{3,}")
CORNERS = ("╭", "╰")
EXPLANATION_INDENT = 6
FOOTER = "For full helptext"


def parsed(arguments: list[str]) -> Any:
    """The options of the command that these arguments name; help is printed, and ends the program.

    Raises:
        UsageError: where the arguments are no command with its options.
    """
    if joined := IN_TWO_WORDS.get(tuple(arguments[:2])):
        arguments = [joined, *arguments[2:]]
    _check_command(arguments)
    first, said = arguments[0], io.StringIO()
    # reading the options of all commands takes three times as long as those of the one that is named
    read = {first: OF_ALL[first]} if first in OF_ALL else OF_ALL
    try:
        with contextlib.redirect_stderr(said), _width_for(arguments):
            return tyro.extras.subcommand_cli_from_dict(read, args=arguments, prog="suturegrasp")
    except SystemExit as end:
        if not end.code:
            raise
    raise UsageError(condensed(said.getvalue(), first))


def condensed(box: str, command: str) -> str:
    """What tyro prints about a mistake in the command line of a command, as one sentence."""
    title, *sections = _sections(ESCAPE_SEQUENCE.sub("", box))
    told = [_sentence(lines) for lines in sections if lines and not lines[0].lstrip().startswith(FOOTER)]
    said = "; ".join(told or title)
    if mistyped := MISTYPED.match(said):
        said = f"{mistyped['option']} needs {mistyped['wanted']}"
    return f"{said}; see suturegrasp {command} --help"


def _sections(box: str) -> list[list[str]]:
    """The lines between the rules of a box, of which the first hold its title at most."""
    sections: list[list[str]] = [[]]
    for line in box.splitlines():
        content = line.removeprefix("│ ").removesuffix(" │").rstrip()
        if RULE.fullmatch(content.strip()) or line.startswith(CORNERS):
            sections.append([])
        elif content.strip():
            sections[-1].append(content)
    return sections


def _sentence(lines: list[str]) -> str:
    """What a section begins with, and the names listed under it; deeper lines explain, which help does better."""
    shallowest = min(_indent(line) for line in lines)
    depth = [_indent(line) - shallowest for line in lines]
    names = ", ".join(line.strip() for line, d in zip(lines, depth, strict=True) if 0 < d < EXPLANATION_INDENT)
    heads = " ".join(line.strip() for line, d in zip(lines, depth, strict=True) if d == 0)
    return f"{heads[:1].lower()}{heads[1:]} {names}".strip().rstrip(".")


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def _check_command(arguments: list[str]) -> None:
    names = ", ".join(COMMANDS)
    if not arguments:
        raise UsageError(f"give a command: {names}; see suturegrasp --help")
    first = arguments[0]
    if first not in (*COMMANDS, *HELP) and not first.startswith("--tyro-"):
        raise UsageError(f"{first} is no command; give one first: {names}; see suturegrasp --help")


@contextlib.contextmanager
def _width_for(arguments: list[str]) -> Generator[None]:
    """Help keeps the terminal's width; what is to be condensed must not be wrapped within a name."""
    before = os.environ.get("COLUMNS")
    if not set(HELP) & set(arguments):
        os.environ["COLUMNS"] = "10000"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop("COLUMNS", None)
        else:
            os.environ["COLUMNS"] = before
