"""deploy/Dockerfile, its steps carried out in a container without an engine; what it then runs as Compose has it.

Below lies a copy of this machine's files, and this checkout's packages stand for the download of what the lock names.
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
from tests.hosts.conftest import copy_of_this_machine

REPOSITORY = Path(__file__).parents[2]
SYSTEM_PYTHON = Path("/usr/bin/python3")
STEP_S = 300.0
PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
DOWNLOAD = re.compile(r" && \S+/pip install [^&]*--require-hashes -r requirements/runtime\.lock$")
pytestmark = [pytest.mark.hosts, pytest.mark.timeout(900)]


class Image:
    """A container's files, and what the steps before have set."""

    def __init__(self, root):
        self.root, self.home, self.user, self.entrypoint = root, "/", "root", []
        # as the official image has it
        (root / "usr/local/bin/python").unlink(missing_ok=True)
        (root / "usr/local/bin/python").symlink_to(SYSTEM_PYTHON)
        (root / "etc/machine-id").unlink(missing_ok=True)

    def carry_out(self, instruction, rest):
        """One step of the file."""
        inside = self.root / self.home.lstrip("/")
        match instruction:
            case "FROM":
                assert rest.startswith("python:3.11-")
            case "WORKDIR":
                self.home = rest
                (self.root / rest.lstrip("/")).mkdir(parents=True)
            case "COPY":
                *sources, target = rest.split()
                for name in sources:
                    if (REPOSITORY / name).is_dir():
                        ignored = shutil.ignore_patterns("__pycache__")
                        shutil.copytree(REPOSITORY / name, inside / target, ignore=ignored)
                    else:
                        (inside / target).mkdir(parents=True, exist_ok=True)
                        shutil.copy(REPOSITORY / name, inside / target)
            case "RUN":
                self.run("sh", "-ec", DOWNLOAD.sub("", rest))
                if DOWNLOAD.search(rest) is not None:
                    packages = inside / ".venv/lib/python3.11/site-packages"
                    (packages / "downloaded.pth").write_text(f"{site.getsitepackages()[0]}\n")
            case "USER":
                self.user = rest
            case "ENTRYPOINT":
                self.entrypoint = json.loads(rest)
            case _:
                raise AssertionError(f"{instruction} is not carried out here; teach this test how")

    def run(self, *command, read_only=False):
        """What a command says in the container, by the user and in the folder of the steps so far."""
        folders = ["mount -t proc proc proc", "mount --rbind /dev dev"]
        if read_only:
            folders += ["mount -o remount,bind,ro .", "mount -t tmpfs -o mode=1777 none tmp"]
        enter = f"cd {self.root}; mount --bind . .; cd {self.root}; {'; '.join(folders)}"
        contained = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-ec", f'{enter}; exec chroot "$@"']
        home = "/root" if self.user == "root" else "/nowhere"
        inside = f"sh --userspec={self.user} {self.root} env -i PATH={PATH} HOME={home}".split()
        typed = [*contained, *inside, "sh", "-c", f'cd {self.home}; exec "$@"', "sh", *command]
        none = subprocess.DEVNULL
        done = subprocess.run(typed, capture_output=True, text=True, timeout=STEP_S, check=False, stdin=none)
        assert done.returncode == 0, (command, done.stdout, done.stderr)
        return done.stdout


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    """What the steps of the file make, once all of them were carried out."""
    if not SYSTEM_PYTHON.exists() or "Python 3.11" not in subprocess.check_output([SYSTEM_PYTHON, "-V"], text=True):
        pytest.skip(f"{SYSTEM_PYTHON} is no Python 3.11, which the image begins with")
    text = re.sub(r"\\\n\s*", "", (REPOSITORY / "deploy" / "Dockerfile").read_text())
    steps = [line.split(" ", 1) for line in text.splitlines() if line and not line.startswith("#")]
    assert sum(DOWNLOAD.search(rest) is not None for _, rest in steps) == 1, "what others stand for is one step"
    with copy_of_this_machine(tmp_path_factory.mktemp("image")) as root:
        made = Image(root)
        for instruction, rest in steps:
            made.carry_out(instruction, rest)
        yield made


def test_the_image_answers_as_compose_runs_it(image):
    """Its own user, on files that nobody may write."""
    assert image.run(*image.entrypoint, "--version", read_only=True) == f"suturegrasp {schemas.__version__}\n"
    interpreter = f"{image.home}/.venv/bin/python"
    where = image.run(interpreter, "-Ic", "import agents; print(agents.__file__)", read_only=True)
    assert where.startswith(f"{image.home}/.venv/"), "what was copied is what is installed"
    host = Host("strong", "10.0.0.12", (Process("planner"), Process("recorder", "strong")))
    services = YAML(typ="safe").load(compose_file("lab", host))["services"]
    for name in ("planner-main", "recorder-strong"):
        command, *_ = services[name]["command"]
        assert f"usage: suturegrasp {command}" in image.run(*image.entrypoint, command, "--help").replace("\n", " ")


def test_the_images_user_writes_recordings_and_nothing_else(image):
    image.run("sh", "-ec", f'test "$(id -u)" = {IMAGE_USER}; touch {SESSIONS}/session.mcap; ! touch {image.home}/x')
