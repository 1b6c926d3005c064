"""Would the monitor's tests notice a change of its code? mutmut changes it, piece by piece, in a copy."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
TOOL = "mutmut==3.8.1"
"""Installed by the command that needs it, into a folder of its own."""
PARTS = ("agents/guard", "shared", "schemas", "tests/agents/guard")
TRIED = ("monitor.py", "description.py", "cdr.py")
"""What decides and reads; the two files that are wires alone are tried by real processes."""
SETTINGS = """[mutmut]
paths_to_mutate=agents/guard
tests_dir=tests/agents/guard
also_copy=
    shared
    schemas
do_not_mutate=
    *__main__.py
    *links.py
    *__init__.py
"""
RESULT = re.compile(r"(?P<name>\S+): (?P<status>killed|survived|timeout|suspicious|no tests|skipped|not checked.*)")
EQUIVALENT: dict[str, str] = {}
"""Changes that change nothing that anybody could notice, by their names, with the reason."""


def mutation(goal: float) -> dict[str, Any]:
    """The share of changes that are noticed, and the names of those that are not."""
    with tempfile.TemporaryDirectory() as folder:
        tool, copy = Path(folder) / "tool", Path(folder) / "copy"
        install = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--target"]
        subprocess.run([*install, str(tool), TOOL], check=True, stderr=subprocess.DEVNULL)
        for part in PARTS:
            shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))
        for package in ("agents", "tests", "tests/agents"):
            (copy / package / "__init__.py").touch()
        (copy / "setup.cfg").write_text(SETTINGS)
        environment = os.environ | {"PYTHONPATH": f"{tool}", "OPENBLAS_NUM_THREADS": "1"}
        run = [sys.executable, "-m", "mutmut", "run"]
        done = subprocess.run(run, cwd=copy, env=environment, capture_output=True, text=True, check=False)
        results = [sys.executable, "-m", "mutmut", "results", "--all", "true"]
        told = subprocess.run(results, cwd=copy, env=environment, capture_output=True, text=True, check=False).stdout
    found = {each["name"]: each["status"] for each in RESULT.finditer(told)}
    if not found:
        raise SystemExit(f"mutmut has tried nothing: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    counted = {name: status for name, status in found.items() if name not in EQUIVALENT}
    survived = sorted(name for name, status in counted.items() if status not in ("killed", "timeout"))
    score = 100 * (1 - len(survived) / len(counted))
    for name in survived:
        print(f"  not noticed: {name}", flush=True)
    return {
        "changes": len(counted),
        "that change nothing": len(found) - len(counted),
        "not noticed": len(survived),
        "score %": score,
        "met": score >= goal,
    }
