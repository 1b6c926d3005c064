"""Which tests ran which lines, and how long they took, from what `make coverage` left.

Processes that a test starts are in it: their context is the test that started them. A line that runs when its module
is read belongs to no test, and gets those that ran its file's functions, or others that use a name which it assigns.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache, cached_property
from pathlib import Path
from xml.etree import ElementTree

from coverage import CoverageData

from tests.mutation.draw import PACKAGES

# what pytest-cov says in the process of the tests, and PYTEST_CURRENT_TEST in processes that they start
CONTEXT = re.compile(r"(?:none\|)?(?P<test>tests/.+?)(?:\|(?:run|setup|teardown)| \((?:call|setup|teardown)\))$")


class Ran:
    """What all tests ran, by a coverage file and pytest's JUnit reports, for a checkout at `root`."""

    def __init__(self, data: Path, reports: list[Path], root: Path) -> None:
        self._data, self._root = CoverageData(str(data)), root
        self._data.read()
        self._seconds = {test: seconds for report in reports for test, seconds in _durations(report)}
        self._measured = {self._below(path): path for path in self._data.measured_files()}

    def of(self, lines: list[tuple[str, int]]) -> list[str]:
        """The tests that ran any of some lines, (path, line): nearest in the tree first, by turns of their files."""
        tests = {test for path, line in lines for test in self._tests(path, line, inside=True)}
        tests = tests or {test for path, line in lines for test in self._tests(path, line, inside=False)}
        by_file: dict[str, list[str]] = defaultdict(list)
        for test in sorted(tests, key=lambda test: (self.seconds(test), test)):
            by_file[test.partition("::")[0]].append(test)
        turns = [
            (-max(_near(path, file) for path, _ in lines), number, self.seconds(test), test)
            for file, some in by_file.items()
            for number, test in enumerate(some)
        ]
        return [test for *_, test in sorted(turns)]

    def seconds(self, test: str) -> float:
        """How long a test took, with its fixtures."""
        return self._seconds.get(test, 1.0)

    def _tests(self, path: str, line: int, *, inside: bool) -> set[str]:
        """The tests of a line in a function, or of a line that runs when its module is read."""
        statement, in_function = _statement(ast.parse((self._root / path).read_text()), line)
        if statement is None or in_function is not inside:
            return set()
        if inside:
            return self._of_lines(path, range(statement.lineno, (statement.end_lineno or line) + 1))
        names = {node.id for node in ast.walk(statement) if isinstance(node, ast.Name)}
        users = [user for name in names for user in self._functions.get(name, ())]
        own = [user for some in self._functions.values() for user in some if user[0] == path]
        return {test for file, lines in {*users, *own} for test in self._of_lines(file, lines)}

    def _below(self, path: str) -> str:
        """A measured file's path in the checkout, wherever the measured one lay."""
        parts = Path(path).parts
        ends = (Path(*parts[i:]) for i, part in enumerate(parts) if part in PACKAGES)
        return str(next((end for end in ends if (self._root / end).is_file()), path))

    def _of_lines(self, path: str, lines: range) -> set[str]:
        contexts = self._contexts(path)
        return {test for line in lines for test in contexts.get(line, ())}

    @cache  # noqa: B019 - it lives as long as the program
    def _contexts(self, path: str) -> dict[int, set[str]]:
        if path not in self._measured:
            return {}
        by_line = self._data.contexts_by_lineno(self._measured[path])
        return {
            line: {match["test"] for each in some if (match := CONTEXT.match(each))} for line, some in by_line.items()
        }

    @cached_property
    def _functions(self) -> dict[str, set[tuple[str, range]]]:
        """The functions' lines that use a name, by name."""
        users: dict[str, set[tuple[str, range]]] = defaultdict(set)
        for package in PACKAGES:
            for file in (self._root / package).rglob("*.py"):
                for name, lines in _used(ast.parse(file.read_text())):
                    users[name].add((str(file.relative_to(self._root)), lines))
        return users


def _near(path: str, test: str) -> int:
    """How many of a path's parts a test's path begins with."""
    pairs = zip(Path(path).parts, Path(test).parts[1:], strict=False)
    return next((number for number, (one, other) in enumerate(pairs) if one != other), 0)


def _durations(report: Path) -> Iterator[tuple[str, float]]:
    for case in ElementTree.parse(report).iter("testcase"):  # noqa: S314 - pytest wrote it
        yield f"{case.get('file')}::{case.get('name')}", float(case.get("time", "1"))


def _statement(tree: ast.AST, line: int) -> tuple[ast.stmt | None, bool]:
    """The innermost statement at a line, and whether it stands in a function."""
    found, inside = None, False
    for node in ast.walk(tree):
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or node.lineno):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                inside = True
            found = node
    return found, inside


def _used(tree: ast.AST) -> Iterator[tuple[str, range]]:
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = range(function.body[0].lineno, (function.end_lineno or function.lineno) + 1)
            for node in ast.walk(function):
                if isinstance(node, ast.Name):
                    yield node.id, lines
                elif isinstance(node, ast.Attribute):
                    yield node.attr, lines
