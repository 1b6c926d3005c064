"""A table of text, and how figures and names are written in it."""

from collections.abc import Iterable
from dataclasses import dataclass

from shared.terminal import printable

Row = tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """Rows under headings; those columns whose heading begins with a space hold figures, and stand to the right."""

    title: str
    columns: Row
    rows: tuple[Row, ...]


def short(key: str) -> str:
    """A key without its root and its rig."""
    parts = key.split("/")
    return "/".join(parts[2:]) if len(parts) == 5 else key


def megabytes(count: int) -> str:
    """Bytes as megabytes."""
    return f"{count * 1e-6:.1f}"


def decimal(value: float | None) -> str:
    """A number with one decimal, a dash for none."""
    return "-" if value is None else f"{value:.1f}"


def first_rows(table: Table, limit: int) -> tuple[tuple[Row, ...], int]:
    """The first rows, and how many are left out."""
    return table.rows[:limit], max(0, len(table.rows) - limit)


def all_printable(rows: Iterable[Row]) -> tuple[Row, ...]:
    """Rows that any terminal and any page can show."""
    return tuple(tuple(printable(cell) for cell in row) for row in rows)
