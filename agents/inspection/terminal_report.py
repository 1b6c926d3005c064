"""Tables in the terminal: as wide as it is; elsewhere, as in a pipe, plain lines that are never wrapped."""

import io
from collections.abc import Iterable, Iterator

import rich.table
from rich.console import Console
from rich.text import Text

from agents.inspection.table import Table, all_printable, first_rows, printable

ROWS_SHOWN = 40
UNWRAPPED = 10_000


def lines(heads: Iterable[str], tables: Iterable[Table], width: int | None) -> Iterator[str]:
    """What to print: sentences, then tables; without a width nothing is wrapped, cut or coloured."""
    for head in heads:
        yield printable(head)
    for table in tables:
        yield ""
        yield from _table_lines(table, width)


def _table_lines(table: Table, width: int | None) -> Iterator[str]:
    shown, left = first_rows(table, ROWS_SHOWN)
    drawn = rich.table.Table(box=None, pad_edge=False, title=None, header_style="dim")
    for column in table.columns:
        is_figure = column.startswith(" ")
        drawn.add_column(Text(column.strip()), justify="right" if is_figure else "left", overflow="fold")
    for row in all_printable(shown):
        drawn.add_row(*(Text(cell) for cell in row))
    out = io.StringIO()
    console = Console(
        file=out,
        width=width or UNWRAPPED,
        force_terminal=width is not None,
        no_color=width is None,
        highlight=False,
        legacy_windows=False,
    )
    console.print(Text(table.title, style="bold"))
    console.print(drawn)
    yield from (line.rstrip() for line in out.getvalue().splitlines())
    if left:
        yield f"... and {left} more, which --json and --html show"
