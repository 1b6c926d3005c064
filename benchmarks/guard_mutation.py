"""Would the monitor's tests notice a change of its code? cosmic-ray changes it, piece by piece, in copies."""

import contextlib
import itertools
import json
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
TOOL = "cosmic-ray==8.7.0"
"""Installed by the command that needs it, into a folder of its own."""
PARTS = ("agents/guard", "shared", "schemas", "tests/agents/guard")
TRIED = {
    "monitor": "test_monitor.py",
    "description": "test_monitor.py",
    "cdr": "test_cdr.py",
    "links": "test_links.py",
}
"""Each file with what tries it; `__main__`, which starts and ends the process, is tried by real processes alone."""
SETTINGS = """[cosmic-ray]
module-path = "agents/guard/{module}.py"
timeout = 30.0
excluded-modules = []
test-command = "{python} -m pytest -q -x -p no:cacheprovider tests/agents/guard/{tests}"
[cosmic-ray.distributor]
name = "local"
"""
EQUIVALENT = (
    ("core/ReplaceBinaryOperator_BitOr", "annotations alone are joined by |"),
    ("core/RemoveDecorator", "a function that is called by its class needs not be static"),
    ("core/ReplaceComparisonOperator_Is_Eq", "a member of an enumeration, or None, equals itself alone"),
    ("core/ReplaceComparisonOperator_IsNot_NotEq", "as before"),
)
"""Changes that change nothing that anybody could notice, by the operator that makes them, with the reason."""
SHARES = 4
"""So many runs try a module's changes, beside each other."""


def mutation(goal: float, module: str, cores: int) -> list[dict[str, Any]]:
    """The share of changes that are noticed, by file and in all; those that are not are printed."""
    modules = list(TRIED) if module == "all" else [module]
    with tempfile.TemporaryDirectory() as folder:
        tool = Path(folder) / "tool"
        install = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--target"]
        subprocess.run([*install, str(tool), TOOL], check=True, stderr=subprocess.DEVNULL)
        shares = [(name, share) for name in modules for share in range(SHARES)]
        with ThreadPoolExecutor(cores) as at_once:
            found = list(at_once.map(lambda of: _tried(of[0], of[1], Path(folder) / f"{of[0]}-{of[1]}", tool), shares))
    results = {
        name: [each for of, some in zip(shares, found, strict=True) if of[0] == name for each in some]
        for name in modules
    }
    for where, status in itertools.chain(*results.values()):
        if status == "survived":
            print(f"  not noticed: {where}", flush=True)
    if len(modules) > 1:
        results["all"] = list(itertools.chain(*results.values()))
    return [_row(name, of, goal) for name, of in results.items()]


def _row(name: str, results: list[tuple[str, str]], goal: float) -> dict[str, Any]:
    survived = sum(status == "survived" for _, status in results)
    score = 100 * (1 - survived / len(results))
    return {"file": name, "changes": len(results), "not noticed": survived, "score %": score, "met": score >= goal}


def _tried(module: str, share: int, copy: Path, tool: Path) -> list[tuple[str, str]]:
    """Each change of a share of a module's: where, and whether it was noticed."""
    for part in PARTS:
        shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))
    for package in ("agents", "tests", "tests/agents"):
        (copy / package / "__init__.py").touch()
    (copy / "settings.toml").write_text(SETTINGS.format(module=module, tests=TRIED[module], python=sys.executable))
    environment = os.environ | {"PYTHONPATH": f"{copy}:{tool}", "PYTHONDONTWRITEBYTECODE": "1"}
    environment |= {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}

    def run(*arguments: str) -> str:
        command = [sys.executable, str(tool / "bin" / "cosmic-ray"), *arguments]
        return subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=True).stdout

    run("init", "settings.toml", "session.sqlite")
    with contextlib.closing(sqlite3.connect(copy / "session.sqlite")) as session, session:
        others = "SELECT job_id FROM work_items WHERE rowid % ? != ?"
        session.execute(f"DELETE FROM mutation_specs WHERE job_id IN ({others})", (SHARES, share))  # noqa: S608
        session.execute("DELETE FROM work_items WHERE rowid % ? != ?", (SHARES, share))
    run("exec", "settings.toml", "session.sqlite")
    results = list[tuple[str, str]]()
    for line in run("dump", "session.sqlite").splitlines():
        item, result = json.loads(line)
        change = item["mutations"][0]
        if result is None or any(change["operator_name"].startswith(operator) for operator, _ in EQUIVALENT):
            continue
        at = f"{module}.py:{change['start_pos'][0]} {change['operator_name']} {change['occurrence']}"
        results.append((at, str(result["test_outcome"])))
    return results
