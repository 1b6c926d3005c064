"""What rich draws for commands: tables as lines of text, and a bar while a long one works."""

from collections.abc import Callable, Generator, Iterable
from typing import TypeVar

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from shared.terminal import show

Result = TypeVar("Result")


def printed(drawn: RenderableType, columns: int | None) -> None:
    """Show something so many columns wide, or as wide as the terminal is."""
    console = Console(width=columns)
    with console.capture() as capture:
        console.print(drawn)
    for line in capture.get().splitlines():
        show(line.rstrip())


def counted(
    results: Iterable[Result], what: str, total: int, before: int, name_of: Callable[[Result], str]
) -> Generator[Result]:
    """The same results, counted from `before` to `total` on a bar on standard error, where that is a terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task(what, total=total, completed=before)
        for one in results:
            progress.update(bar, advance=1, description=name_of(one))
            yield one
