"""The command run within this process, a small rendered pair, the file of a rig, and the shared data."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from agents.cli.main import main
from schemas.messages import RectifiedStereo
from shared.rendering.files import write_pair
from shared.rendering.render import make_scene, render

REPOSITORY = Path(__file__).parents[3]
DATA = REPOSITORY / "../shared/data"
SCRIPT = str(Path(sys.executable).with_name("suturegrasp"))
SMALL = RectifiedStereo(320, 180, 330.0, 330.0, 159.5, 89.5, 5.5, 1e-3)


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


def refused(ended: Ended, *told: object, status: int = 2) -> None:
    """One line on standard error that tells this, nothing on standard output, and this status."""
    assert (ended.status, ended.out, len(ended.err.splitlines())) == (status, "", 1), ended
    assert ended.err.startswith("suturegrasp: ")
    assert ended.err.endswith("\n")
    for each in told:
        assert str(each) in ended.err


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

    def run(*arguments: object, **environment: str) -> Ended:
        command = [SCRIPT, *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, env=os.environ | environment, check=False)
        return Ended(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def rig_file(settings, tmp_path: Path) -> Callable[..., Path]:
    """Writes the file of a rig with some sections on the test's router, and says where it lies."""

    def write(sections: str = "", name: str = "rig.toml") -> Path:
        path = tmp_path / name
        router = f'[router]\nendpoint = "{settings.endpoint}"\nstart = false\n'
        path.write_text(f'rig = "{settings.rig}"\n{router}{sections}\n')
        return path

    return write


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


def of_pair(folder: Path) -> tuple[object, ...]:
    """The command on the pair and the calibration in a folder, as its writer names them."""
    images = ("reconstruct", "--left", folder / "left.png", "--right", folder / "right.png")
    return *images, "--calibration", folder / "calibration.json"
