"""A bar on standard error while a long command works, where that is a terminal."""

from collections.abc import Callable, Generator, Iterable
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

Result = TypeVar("Result")


def counted(
    results: Iterable[Result], what: str, total: int, before: int, name_of: Callable[[Result], str]
) -> Generator[Result]:
    """The same results, counted from `before` to `total` as they come; each by its name."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task(what, total=total, completed=before)
        for one in results:
            progress.update(bar, advance=1, description=name_of(one))
            yield one
