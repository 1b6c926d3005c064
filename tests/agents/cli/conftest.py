"""The command run within this process, a small rendered pair, and the shared data."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

from agents.cli.main import main
from schemas.messages import RectifiedStereo
from shared.scene.__main__ import make_scene
from shared.scene.files import write_pair
from shared.scene.render import render

REPOSITORY = Path(__file__).parents[3]
DATA = REPOSITORY / "../shared/data"
SMALL = RectifiedStereo(
    image_width=320,
    image_height=180,
    fx_px=330.0,
    fy_px=330.0,
    cx_px=159.5,
    cy_px=89.5,
    baseline=5.5,
    metres_per_unit=1e-3,
)


@dataclass(frozen=True)
class Ended:
    """How a command ended, and what it said."""

    status: int
    out: str
    err: str

    @property
    def complaints(self) -> list[str]:
        return [line for line in self.err.splitlines() if not line.startswith("warning: ")]


Command = Callable[..., Ended]


@pytest.fixture
def suturegrasp(capfd: pytest.CaptureFixture[str]) -> Command:
    """Runs the command within this process; what C libraries print counts too."""

    def run(*arguments: object) -> Ended:
        capfd.readouterr()
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            with pytest.raises(SystemExit) as end:
                main([str(argument) for argument in arguments])
        finally:
            # a command that waits to be stopped would leave the tests deaf to it
            for number, handler in handlers.items():
                signal.signal(number, handler)
        said = capfd.readouterr()
        assert isinstance(end.value.code, int)
        return Ended(end.value.code, said.out, said.err)

    return run


@pytest.fixture(scope="session")
def console_script() -> Command:
    """Runs the installed command as a process of its own."""
    script = Path(sys.executable).with_name("suturegrasp")

    def run(*arguments: object, cwd: Path = REPOSITORY, **environment: str) -> Ended:
        done = subprocess.run(
            [str(script), *map(str, arguments)],
            capture_output=True,
            text=True,
            cwd=cwd,
            env={**os.environ, **environment},
            check=False,
        )
        return Ended(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def example() -> Path:
    """The pair that is shipped with its truth."""
    return REPOSITORY / "docs" / "example"


@pytest.fixture(scope="session")
def data() -> Path:
    if not DATA.is_dir() and "CI" not in os.environ:
        pytest.skip("the folder shared/data does not stand beside the checkout")
    return DATA


@pytest.fixture(scope="session")
def _rendered_small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("small")
    scene = make_scene("easy", "plain", 4, distance_mm=70.0, camera=SMALL)
    write_pair(folder, scene, render(scene))
    return folder


@pytest.fixture
def small(_rendered_small: Path, tmp_path: Path) -> Path:
    """A folder of its own with a small pair: images, masks, calibration.json and truth.json."""
    return Path(shutil.copytree(_rendered_small, tmp_path / "small"))


@pytest.fixture
def pair() -> Callable[[Path], tuple[object, ...]]:
    """The options that name the pair and the calibration in a folder, as its writer names them."""
    return options_of


def options_of(folder: Path) -> tuple[object, ...]:
    return (
        *("reconstruct", "--left", folder / "left.png", "--right", folder / "right.png"),
        *("--calibration", folder / "calibration.json"),
    )


@pytest.fixture
def mean_error() -> Callable[[Path, np.ndarray], float]:
    """The mean distance between the curve in a result and true points, over both directions."""

    def error(result: Path, true_points: np.ndarray) -> float:
        document: dict[str, Any] = json.loads(result.read_text())
        curve = BSpline(document["knots"], np.array(document["control_points"]), document["degree"])
        points = curve(np.linspace(0.0, 1.0, 1000))
        there, back = cKDTree(true_points).query(points)[0], cKDTree(points).query(true_points)[0]
        return 0.5 * float(np.mean(there) + np.mean(back))

    return error


@pytest.fixture
def true_points() -> Callable[[Path], np.ndarray]:
    """Points along the true thread of a rendered pair."""

    def points(folder: Path) -> np.ndarray:
        truth = json.loads((folder / "truth.json").read_text())
        return BSpline(truth["knots"], np.array(truth["control_points"]), truth["degree"])(np.linspace(0, 1, 1000))

    return points
