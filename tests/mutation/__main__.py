"""How many small defects the tests find: `make coverage`, then `python -m tests.mutation`.

The defects are the mutants of mutants.json (`python -m tests.mutation draw --seed N --count 150` draws others) and the
past ones of defects/, each a patch that takes a fix out again. For each of them the tests that ran its lines, as
out/coverage knows, run in a copy of what is committed, nearest in the tree first, until one fails or `--limit` is
spent. A test that also fails without the defect says nothing, and is named.
"""

import argparse
import dataclasses
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

from tests.mutation.draw import Mutant, applied, draw
from tests.mutation.ran import Ran

ROOT = Path(__file__).parents[2]
HERE = Path(__file__).parent
MUTANTS, DEFECTS = HERE / "mutants.json", HERE / "defects"
OUT = ROOT / "out" / "coverage"
COVERAGE, DURATIONS = OUT / "data", [OUT / "computing.xml", OUT / "processes.xml"]
# a first handful finds most defects; starting pytest anew for each test would take longer than the tests
BATCHES = (12, 60, 240)


@dataclass(frozen=True)
class Found:
    """What became of a defect: how many tests ran its lines, how many of them were run, and which one failed."""

    defect: str
    tests: int
    tried: int
    killed_by: str | None


def main() -> int:
    """Draw the mutants, or try them and the past defects."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("try", "draw"), default="try")
    parser.add_argument("--seed", type=int, default=20261128)
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--limit", type=float, default=240.0, metavar="S", help="seconds of tests for each defect")
    parser.add_argument("--copies", type=int, default=2, help="defects that are tried at a time")
    parser.add_argument("--coverage", type=Path, default=COVERAGE)
    parser.add_argument("--durations", type=Path, nargs="+", default=DURATIONS, help="JUnit reports of the same run")
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "mutation.json")
    options = parser.parse_args()
    if options.what == "draw":
        drawn = [dataclasses.asdict(each) for each in draw(ROOT, options.count, options.seed)]
        MUTANTS.write_text(json.dumps({"seed": options.seed, "mutants": drawn}, indent=1) + "\n")
        return 0
    ran = Ran(options.coverage, options.durations, ROOT)
    defects = [*_past(), *(Mutant(**each) for each in json.loads(MUTANTS.read_text())["mutants"])]
    broken: set[str] = set()
    with _copies(options.copies) as copies, ThreadPoolExecutor(options.copies) as threads:
        found = list(threads.map(lambda defect: _tried(defect, ran, copies, options.limit, broken), defects))
    options.output.parent.mkdir(exist_ok=True)
    options.output.write_text(json.dumps([dataclasses.asdict(each) for each in found], indent=1) + "\n")
    _told(found, broken)
    return 0


def _past() -> list[Path]:
    return sorted(DEFECTS.glob("*.patch"))


@contextmanager
def _copies(count: int) -> Generator["SimpleQueue[Path]"]:
    """Copies of what is committed, to be changed one at a time each; they share this checkout's virtual environment."""
    free: SimpleQueue[Path] = SimpleQueue()
    with tempfile.TemporaryDirectory(prefix="mutation", ignore_cleanup_errors=True) as folder:
        for number in range(count):
            copy = Path(folder) / f"copy{number}"
            _git("clone", "--quiet", str(ROOT), str(copy))
            (copy / ".venv").symlink_to(ROOT / ".venv")
            free.put(copy)
        if (beside := ROOT.parent / "shared").is_dir():
            (Path(folder) / "shared").symlink_to(beside)
        yield free


def _git(*arguments: str) -> None:
    subprocess.run([shutil.which("git") or "git", *arguments], check=True)


def _tried(defect: Mutant | Path, ran: Ran, copies: "SimpleQueue[Path]", limit_s: float, broken: set[str]) -> Found:
    copy = copies.get()
    try:
        name, lines = _put_in(defect, copy)
        tests = [test for test in ran.of(lines) if test not in broken]
        killer, tried = _first_failing(copy, tests, ran, limit_s)
        while killer is not None:
            _git("-C", str(copy), "checkout", "--quiet", ".")
            if not _failing(copy, [killer], 300.0):
                break
            broken.add(killer)
            _put_in(defect, copy)
            tests = [test for test in tests if test not in broken]
            killer, tried = _first_failing(copy, tests, ran, limit_s)
    finally:
        _git("-C", str(copy), "checkout", "--quiet", ".")
        copies.put(copy)
    sys.stderr.write(f"{name}: {killer or f'lives, {tried} of {len(tests)} tests ran'}\n")
    return Found(name, len(tests), tried, killer)


def _put_in(defect: Mutant | Path, copy: Path) -> tuple[str, list[tuple[str, int]]]:
    """Change a copy; the defect's name, and the lines of the checkout that it touches."""
    if isinstance(defect, Mutant):
        path = copy / defect.path
        path.write_bytes(applied(defect, path.read_bytes()))
        name = f"{defect.path}:{defect.line} {defect.was} -> {defect.becomes}"
        return " ".join(name.split()), [(defect.path, line) for line in range(defect.line, defect.end_line + 1)]
    _git("-C", str(copy), "apply", str(defect))
    return defect.stem, list(_touched(defect.read_text()))


def _touched(patch: str) -> Iterator[tuple[str, int]]:
    path, line = "", 0
    for text in patch.splitlines():
        if text.startswith("--- a/"):
            path = text[6:]
        elif text.startswith("@@"):
            line = int(text.split()[1].split(",")[0][1:])
        elif path and not text.startswith(("+", "diff", "index")):
            if text.startswith("-"):
                yield path, line
            line += 1
        elif path and text.startswith("+") and not text.startswith("+++"):
            yield path, line - 1


def _first_failing(copy: Path, tests: list[str], ran: Ran, limit_s: float) -> tuple[str | None, int]:
    start, left_s = 0, limit_s
    for size in (*BATCHES, len(tests)):
        batch: list[str] = []
        for test in tests[start : start + size]:
            if (left_s := left_s - ran.seconds(test)) < 0.0 and (batch or start):
                break
            batch.append(test)
        if not batch:
            break
        failing = _failing(copy, batch, 120.0 + 4.0 * sum(map(ran.seconds, batch)), first=True)
        start += len(batch)
        if failing:
            return failing[0], start
    return None, start


def _failing(copy: Path, tests: list[str], within_s: float, *, first: bool = False) -> list[str]:
    """Those of some tests that fail in a copy; all that had not passed where it hangs."""
    if not tests:
        return []
    listed = copy / "out" / "tests.txt"
    listed.parent.mkdir(exist_ok=True)
    listed.write_text("\n".join(tests))
    report = listed.with_name("report.txt")
    report.unlink(missing_ok=True)
    command = [str(copy / ".venv" / "bin" / "python"), "-m", "pytest", "-q", "-p", "no:cacheprovider", "-rN"]
    command += ["-p", "tests.mutation.reported", "--timeout=120", *(["-x"] if first else []), f"@{listed}"]
    # compiled code of before would pass for that of a file changed within the same second
    own = {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1", "MUTATION_REPORT": str(report)}
    try:
        ended = subprocess.run(
            command, cwd=copy, env={**os.environ, **own}, capture_output=True, timeout=within_s, check=False
        )
        code = ended.returncode
    except subprocess.TimeoutExpired:
        code = -1
    outcomes = dict(line.rsplit(" ", 1) for line in report.read_text().splitlines()) if report.exists() else {}
    failed = [test for test, outcome in outcomes.items() if outcome == "failed"]
    if not failed and code not in (0, 5):
        # the defect broke the reading of a test's file, or hung: the first test without an outcome is the one
        failed = [test for test in tests if test not in outcomes][:1]
    return failed


def _told(found: list[Found], broken: set[str]) -> None:
    past = len(_past())
    for kind, some in (("past defects", found[:past]), ("mutants", found[past:])):
        killed = sum(each.killed_by is not None for each in some)
        sys.stdout.write(f"{kind}: {killed} of {len(some)} found ({100 * killed / max(len(some), 1):.1f} %)\n")
    for each in found:
        if each.killed_by is None:
            sys.stdout.write(f"  lives: {each.defect} ({each.tried} of {each.tests} tests ran)\n")
    for test in sorted(broken):
        sys.stdout.write(f"  fails without a defect: {test}\n")


if __name__ == "__main__":
    sys.exit(main())
