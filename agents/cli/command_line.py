"""The command line: which command it names, its options, and help. What tyro would say in a box is said in one line."""

import contextlib
import difflib
import io
import os
import re
from collections.abc import Generator, Sequence
from typing import Annotated, Any, Union

from agents.cli.commands import COMMANDS, FORMER, GROUPS, Command
from shared.terminal import UsageError

HELP = ("-h", "--help")
COMPLETION = "--tyro-print-completion"
MISTYPED = re.compile(
    r"error parsing (?P<option>--\S+): No type matching .*argument helptext: \S+ (?P<wanted>[^,]+),", re.I
)
"""What tyro says of an option that takes several values, or may be left out, with all that it has tried."""
LACKING = re.compile(r"missing value for argument '(?P<option>--\S+)'\. Expected (?P<count>\d+) values", re.I)
"""And of one that may be given several times."""
ESCAPE_SEQUENCE = re.compile(r"\x1b\[[0-9;]*m")
RULE = re.compile(r"[─-]{3,}")
CORNERS = ("╭", "╰")
EXPLANATION_INDENT = 6
FOOTER = "For full helptext"


def named(arguments: Sequence[str]) -> tuple[str, list[str]]:
    """The command that the arguments begin with, of one word or two, and what it is given.

    Raises:
        UsageError: where they begin with none.
    """
    for words in (2, 1):
        name = " ".join(arguments[:words])
        if name in COMMANDS:
            _refuse_former(name, arguments[words:])
            return name, list(arguments[words:])
    first = next(iter(arguments), "")
    _refuse_former(first, arguments[1:])
    of_first = _beginning(first) if first else []
    wrong = " ".join(arguments[:2]) if of_first and len(arguments) > 1 else "" if of_first else first
    names = ", ".join(of_first or dict.fromkeys(name.split()[0] for name in COMMANDS))
    # of two words, the first is right
    known = {name.removeprefix(f"{first} "): name for name in of_first or COMMANDS}
    if near := difflib.get_close_matches(wrong.removeprefix(f"{first} "), known, n=1):
        raise UsageError(f"{wrong} is no command; did you mean {known[near[0]]}? see suturegrasp --help")
    what = f"{wrong} is no command; give one first" if wrong else "give a command"
    raise UsageError(f"{what}: {names}; see suturegrasp --help")


def parsed(name: str, command: Command, arguments: list[str]) -> Any:
    """The options of a command; its help is printed, and ends the program.

    Raises:
        UsageError: where the arguments are not its options.
    """
    import tyro

    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), _width_for(arguments):
            return tyro.cli(command.options_type(), args=arguments, prog=f"suturegrasp {name}")
    except SystemExit as end:
        if not end.code:
            raise
    raise UsageError(condensed(said.getvalue(), name))


def completion(arguments: list[str]) -> None:
    """Print what a shell completes commands by, and end the program."""
    import tyro

    read: dict[str, Any] = {name: one.options_type() for name, one in COMMANDS.items() if " " not in name}
    of_run = [(name.partition(" ")[2], one) for name, one in COMMANDS.items() if name.startswith("run ")]
    agents = tuple(Annotated[one.options_type(), tyro.conf.subcommand(name)] for name, one in of_run)
    read["run"] = Union[agents]  # noqa: UP007, as many as there are
    tyro.extras.subcommand_cli_from_dict(read, args=arguments, prog="suturegrasp")


def overview(arguments: Sequence[str]) -> str:
    """What help says of no single command: all of them by what they are for, or those that begin with one word.

    Empty where the arguments ask for no such help.
    """
    asked = [one for one in arguments if one not in HELP]
    first = next(iter(asked), "")
    if asked == list(arguments) or len(asked) > 1 or first in COMMANDS or not _beginning(first):
        return ""
    lines = [f"usage: suturegrasp {first or 'COMMAND'} ... [--help]"]
    for heading, commands in GROUPS.items():
        rows = {name: one.does for name, one in commands.items() if name in _beginning(first)}
        if not first:
            rows = _agents_in_one_row(rows)
        lines += ["", f"{heading}:", *(f"  {name:<20} {does}" for name, does in rows.items())] if rows else []
    return "\n".join(lines)


def _beginning(first: str) -> list[str]:
    return [name for name in COMMANDS if not first or name.startswith(f"{first} ")]


def _agents_in_one_row(rows: dict[str, str]) -> dict[str, str]:
    agents = [name.partition(" ")[2] for name in rows if name.startswith("run ")]
    others = {name: does for name, does in rows.items() if not name.startswith("run ")}
    return others | ({"run AGENT": f"one agent, such as {agents[0]}; run --help names all"} if agents else {})


def _refuse_former(name: str, arguments: Sequence[str]) -> None:
    for (former, option), now in FORMER.items():
        if name == former and (not option or any(one.split("=")[0] == option for one in arguments)):
            said = f"{former} {option}".strip()
            raise UsageError(f"suturegrasp {said} is suturegrasp {now} now; its other options are the same")


def condensed(box: str, command: str) -> str:
    """What tyro prints about a mistake in the command line of a command, as one sentence."""
    title, *sections = _sections(ESCAPE_SEQUENCE.sub("", box))
    told = [_sentence(lines) for lines in sections if lines and not lines[0].lstrip().startswith(FOOTER)]
    said = "; ".join(told or title)
    if mistyped := MISTYPED.match(said):
        said = f"{mistyped['option']} needs {mistyped['wanted']}"
    if lacking := LACKING.match(said):
        count = int(lacking["count"])
        said = f"{lacking['option']} needs {'a value' if count == 1 else f'{count} values'}"
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
