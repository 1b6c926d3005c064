"""deploy/Dockerfile, its steps carried out in a container without an engine; what it then runs as Compose has it.

Below lies a copy of this machine's files in place of the image that it begins from. Not carried out is the download of
what the lock names: this checkout's packages stand for it.
"""

import json
import re
import shutil
import site
import subprocess
from pathlib import Path

import pytest
from ruamel.yaml import YAML

import schemas
from agents.deployment.containers import IMAGE_USER, compose_file
from agents.deployment.layout import Host, Process
from agents.deployment.places import SESSIONS

REPOSITORY = Path(__file__).parents[2]
DOCKERFILE = REPOSITORY / "deploy" / "Dockerfile"
SYSTEM_PYTHON = Path("/usr/bin/python3")
STEP_S = 300.0
PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
DOWNLOAD = re.compile(r" && \S+/pip install [^&]*--require-hashes -r requirements/runtime\.lock$")
pytestmark = [pytest.mark.hosts, pytest.mark.timeout(900)]


def steps():
    """The instructions of the file in their order, each a word and the rest of its line."""
    text = re.sub(r"\\\n\s*", "", DOCKERFILE.read_text())
    return [tuple(line.split(" ", 1)) for line in text.splitlines() if line and not line.startswith("#")]


class Image:
    """A container's files over those of this machine, and what the steps before have set."""

    def __init__(self, folder):
        self.root, self._memory = folder / "root", folder / "memory"
        self.home, self.user, self.entrypoint = "/", "root", []
        for part in (self.root, self._memory):
            part.mkdir()
        _must("mount", "-t", "tmpfs", "none", self._memory)
        for part in ("upper", "work"):
            (self._memory / part).mkdir()
        layers = f"lowerdir=/,upperdir={self._memory / 'upper'},workdir={self._memory / 'work'}"
        _must("mount", "-t", "overlay", "overlay", "-o", layers, self.root)
        # as the official image has it
        (self.root / "usr/local/bin/python").unlink(missing_ok=True)
        (self.root / "usr/local/bin/python").symlink_to(SYSTEM_PYTHON)
        (self.root / "etc/machine-id").unlink(missing_ok=True)

    def copy(self, *names):
        *sources, target = names
        for name in sources:
            source, at = REPOSITORY / name, self.root / self.home.lstrip("/") / target
            if source.is_dir():
                shutil.copytree(source, at, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                at.mkdir(parents=True, exist_ok=True)
                shutil.copy(source, at)

    def run(self, *command, read_only=False):
        """What a command says in the container, by the user and in the folder of the steps so far."""
        folders = ["mount -t proc proc proc", "mount --rbind /dev dev"]
        if read_only:
            folders += ["mount -o remount,bind,ro .", "mount -t tmpfs -o mode=1777 none tmp"]
        enter = f"cd {self.root}; mount --bind . .; cd {self.root}; {'; '.join(folders)}"
        contained = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-ec", f'{enter}; exec chroot "$@"']
        home = "/root" if self.user == "root" else "/nowhere"
        inside = f"sh --userspec={self.user} {self.root} env -i PATH={PATH} HOME={home}".split()
        done = subprocess.run(
            [*contained, *inside, "sh", "-c", f'cd {self.home}; exec "$@"', "sh", *command],
            capture_output=True,
            text=True,
            timeout=STEP_S,
            check=False,
            stdin=subprocess.DEVNULL,
        )
        assert done.returncode == 0, (command, done.stdout, done.stderr)
        return done.stdout

    def close(self):
        _run("umount", "--recursive", self.root)
        _run("umount", self._memory)


def _run(*command):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)


def _must(*command):
    done = _run(*command)
    if done.returncode != 0:
        pytest.skip(f"this system cannot play containers: {command[0]}: {done.stderr}")


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    """What the steps make, once all of them were carried out."""
    if not SYSTEM_PYTHON.exists() or "Python 3.11" not in subprocess.check_output([SYSTEM_PYTHON, "-V"], text=True):
        pytest.skip(f"{SYSTEM_PYTHON} is no Python 3.11, which the image begins with")
    made = Image(tmp_path_factory.mktemp("image"))
    try:
        for instruction, rest in steps():
            match instruction:
                case "FROM":
                    assert rest.startswith("python:3.11-")
                case "WORKDIR":
                    made.home = rest
                    (made.root / rest.lstrip("/")).mkdir(parents=True)
                case "COPY":
                    made.copy(*rest.split())
                case "RUN":
                    made.run("sh", "-ec", DOWNLOAD.sub("", rest))
                    if DOWNLOAD.search(rest) is not None:
                        packages = made.root / made.home.lstrip("/") / ".venv/lib/python3.11/site-packages"
                        (packages / "downloaded.pth").write_text(f"{site.getsitepackages()[0]}\n")
                case "USER":
                    made.user = rest
                case "ENTRYPOINT":
                    made.entrypoint = json.loads(rest)
                case _:
                    raise AssertionError(f"{instruction} is not carried out here; teach this test how")
        yield made
    finally:
        made.close()


def services():
    host = Host("strong", "10.0.0.12", (Process("planner"), Process("recorder", "strong")))
    return YAML(typ="safe").load(compose_file("lab", host))["services"]


def test_the_download_is_the_one_step_that_others_stand_for():
    assert len([rest for word, rest in steps() if word == "RUN" and DOWNLOAD.search(rest) is not None]) == 1


def test_the_image_answers_as_compose_runs_it(image):
    """Its own user, on files that nobody may write."""
    assert image.run(*image.entrypoint, "--version", read_only=True) == f"suturegrasp {schemas.__version__}\n"
    interpreter = f"{image.home}/.venv/bin/python"
    where = image.run(interpreter, "-Ic", "import agents; print(agents.__file__)", read_only=True)
    assert where.startswith(f"{image.home}/.venv/"), "what was copied is what is installed"


@pytest.mark.parametrize("name", ["planner-main", "recorder-strong"])
def test_what_compose_asks_of_the_image_is_a_command_that_it_has(image, name):
    command, *_ = services()[name]["command"]
    assert f"usage: suturegrasp {command}" in image.run(*image.entrypoint, command, "--help").replace("\n", " ")


def test_the_images_user_writes_recordings_and_nothing_else(image):
    image.run("sh", "-ec", f'test "$(id -u)" = {IMAGE_USER}; touch {SESSIONS}/session.mcap; ! touch {image.home}/x')
