"""Verifies the safety case: `python -m tests.safety_case` fails where docs/safety.md names what is not there.

Each row of the hazards must name a file and a test; `test_file.py::*` is a file of which all tests count.
"""

import ast
import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "safety.md"
ROW = re.compile(r"^\| (?P<number>\d+) \|")
CODE = re.compile(r"`([^`]+)`")


def missing(text: str, root: Path = ROOT) -> list[str]:
    """What the page names and the checkout has not, one sentence each."""
    rows = [line for line in text.splitlines() if ROW.match(line)]
    found = [] if rows else ["it has no row of hazards"]
    for row in rows:
        number, cells = int(row.split("|")[1]), row.split("|")
        files, tests = (CODE.findall(cell) for cell in cells[6:8])
        if not files or not tests:
            found.append(f"hazard {number} names no file, or no test")
        found += [f"hazard {number}: there is no {name}" for name in files if not (root / name).exists()]
        found += [f"hazard {number}: there is no test {name}" for name in tests if not _is_test(name, root)]
    return found


def _is_test(name: str, root: Path) -> bool:
    path, _, function = name.partition("::")
    file = root / path
    if not file.is_file() or not function:
        return False
    tests = {node.name for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.FunctionDef)}
    tests = {each for each in tests if each.startswith("test_")}
    return function in tests or (function == "*" and bool(tests))


if __name__ == "__main__":
    complaints = missing(PAGE.read_text())
    sys.exit("\n".join(["docs/safety.md names what is not there:", *complaints]) if complaints else 0)
