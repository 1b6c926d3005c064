"""The command's page is true: its example runs, and it names every option and every field."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

PAGE = (Path(__file__).parents[3] / "docs" / "reconstruct.md").read_text(encoding="utf-8")


@pytest.fixture
def result(suturegrasp, pair, small: Path) -> Path:
    (small / "out").mkdir()
    assert suturegrasp(*pair(small), "--output", small / "out" / "thread.json").status == 0
    return small / "out" / "thread.json"


def test_the_numpy_example_runs(result: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    monkeypatch.chdir(result.parents[1])
    names: dict[str, Any] = {}
    exec(code, names)  # noqa: S102
    steps = np.linalg.norm(np.diff(names["even"], axis=0), axis=1)
    np.testing.assert_allclose(steps, steps.mean(), rtol=0.02)
    assert steps.sum() == pytest.approx(json.loads(result.read_text())["length"], rel=0.01)
    assert ((names["u"] > 0) & (names["u"] < 320) & (names["v"] > 0) & (names["v"] < 180)).all()
    assert names["confidence"].shape == (50,)


def test_every_option_and_field_is_described(suturegrasp, result: Path) -> None:
    options = set(re.findall(r"--[a-z0-9-]+", suturegrasp("reconstruct", "--help").out)) - {"--help"}
    document = json.loads(result.read_text())
    nested = (field for part in ("confidence", "timings_ms", "camera") for field in document[part])
    assert len(options) >= 12
    for name in (*options, *document, *nested):
        assert f"`{name}`" in PAGE, name
