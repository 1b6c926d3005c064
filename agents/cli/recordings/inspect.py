"""`suturegrasp inspect`: what a recording tells, in the terminal, as JSON, and as a page."""

import dataclasses
import json
import shutil
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from agents.cli.places import check_outputs
from agents.cli.recordings.options import Inspect
from agents.cli.whole_file import whole_file
from agents.launch.process import EXIT_DAMAGED, EXIT_OK
from agents.session_report.comparison import comparison_tables
from agents.session_report.document import document, lines, names_of
from agents.session_report.page import comparison_page, session_page
from agents.session_report.pictures import pictures_of
from agents.session_report.session import Session, read_session
from agents.session_report.tables import head_lines, session_tables
from agents.session_report.time_offsets import ArmOffset, offset_table, time_offsets
from shared.terminal import UsageError, show, warn


def run(options: Inspect) -> int:
    """Read the recordings and tell of them."""
    if not options.recordings:
        raise UsageError("give a recording, or two to compare them")
    if options.time_offset and len(options.recordings) > 1:
        raise UsageError("--time-offset is of one recording; give one")
    if options.html is not None:
        check_outputs({"--html": options.html}, (("the recording", path) for path in options.recordings))
    sessions = [read_session(path) for path in options.recordings]
    names = names_of(list(options.recordings))
    offsets = time_offsets(sessions[0].path) if options.time_offset else None
    for line in _told(sessions, names, options.json, offsets):
        show(line)
    if options.html is not None:
        _write(options.html, _page(sessions, names))
    damaged = [session for session in sessions if session.damage]
    for session in damaged:
        warn(session.damage)
    return EXIT_DAMAGED if damaged else EXIT_OK


def _told(
    sessions: list[Session], names: list[str], as_json: bool, offsets: tuple[ArmOffset, ...] | None
) -> Iterator[str]:
    if as_json:
        told = [document(session) for session in sessions]
        if offsets is not None:
            told[0]["time_offsets"] = [dataclasses.asdict(one) for one in offsets]
        yield json.dumps(told[0] if len(told) == 1 else told, indent=1)
        return
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    if len(sessions) == 1:
        tables = session_tables(sessions[0])
        if offsets is not None:
            tables.append(offset_table(offsets))
        yield from lines(head_lines(sessions[0]), tables, width)
        return
    heads = [
        line if line.startswith(f"{name}:") else f"{name}: {line}"
        for session, name in zip(sessions, names, strict=True)
        for line in head_lines(session)
    ]
    yield from lines(heads, comparison_tables(sessions, names), width)


def _page(sessions: list[Session], names: list[str]) -> Iterator[str]:
    if len(sessions) == 1:
        return session_page(sessions[0], pictures_of(sessions[0]))
    return comparison_page(sessions, names, comparison_tables(sessions, names))


def _write(path: Path, pieces: Iterable[str]) -> None:
    with whole_file(path) as unfinished, unfinished.open("w", encoding="utf-8", errors="backslashreplace") as file:
        file.writelines(pieces)
