"""docs/deployment.md, typed line by line on four machines with systemd; containers on a virtual switch stand for them.

Not typed is what needs the internet, and what names a machine: the machines share this one's files below their own.
"""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from agents.cli.lab.rehearsal.network import CannotError, connected_hosts
from shared.clock import monotonic_s

REPOSITORY = Path(__file__).parents[2]
PAGE = REPOSITORY / "docs" / "deployment.md"
HOSTS = ("video", "strong", "robot", "desk")
LINE = re.compile(r"^    (?P<who>desk\$|(?:each|video|strong|robot)#) (?P<line>.+)$", re.MULTILINE)
NOT_TYPED = ("apt-get ", "git ", "adduser ", "docker ")
TYPED_UNTIL = "## Certificates"
OWNER = "SUTUREGRASP_TESTED_BY"
"""Environment variable of a container's first process."""
BOOT_S, LINE_S, RUNNING_S = 60.0, 60.0, 120.0
SYSTEM_PYTHON = Path("/usr/bin/python3")
OF_THEIR_OWN = "/tmp", "/var/tmp", "/home", "/root", "/run"  # noqa: S108 - where nothing is written
"""Folders that containers and hardened units have for themselves: a checkout in one is not there for them."""
pytestmark = [pytest.mark.hosts, pytest.mark.timeout(400)]


class Machine:
    """A container that boots systemd over a copy of this machine's files that is written to memory."""

    def __init__(self, name, folder, namespace):
        self.name, self._folder = name, folder
        self.root = folder / "root"
        for part in ("memory", "root"):
            (folder / part).mkdir(parents=True)
        _must("mount", "-t", "tmpfs", "none", folder / "memory")
        for part in ("upper", "work"):
            (folder / "memory" / part).mkdir()
        layers = f"lowerdir=/,upperdir={folder / 'memory/upper'},workdir={folder / 'memory/work'}"
        _must("mount", "-t", "overlay", "overlay", "-o", layers, self.root)
        self._furnish()
        boots = [
            "systemd-nspawn", "--quiet", "--register=no", "--keep-unit", "--capability=all", f"--directory={self.root}",
            f"--machine={name}", f"--network-namespace-path=/run/netns/{namespace}", "--boot",
            f"--setenv={OWNER}={os.getpid()}", "systemd.unit=multi-user.target",
        ]  # fmt: skip
        self._log = (folder / "boot.log").open("wb")
        self._process = subprocess.Popen(boots, stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log)

    def _furnish(self):
        """What a machine of its own would have: a name, the checkout's place, and an interpreter outside of homes."""
        (self.root / "etc" / "hostname").write_text(f"{self.name}\n")
        (self.root / "opt" / "suturegrasp").symlink_to(REPOSITORY)
        inside = self.root / REPOSITORY.relative_to("/") / ".venv"
        for interpreter in ("python3.11", "python3", "python"):
            (inside / "bin" / interpreter).unlink(missing_ok=True)
            (inside / "bin" / interpreter).symlink_to(SYSTEM_PYTHON)
        (inside / "pyvenv.cfg").write_text(f"home = {SYSTEM_PYTHON.parent}\ninclude-system-site-packages = false\n")
        shutil.rmtree(self.root / "etc" / "suturegrasp", ignore_errors=True)

    def wait(self):
        """Until systemd takes orders."""
        deadline_s = monotonic_s() + BOOT_S
        while monotonic_s() < deadline_s:
            with contextlib.suppress(IndexError, AssertionError):
                if self.type("systemctl is-active multi-user.target") == "active\n":
                    return
            threading.Event().wait(0.2)
        pytest.skip(f"no systemd boots in a container here: {(self._folder / 'boot.log').read_text()[-300:]}")

    def type(self, line, accept=(0,)):
        """What a line says there, typed in root's home."""
        first = self._first()
        named = ["PATH=/usr/local/bin:/usr/bin:/bin:/usr/sbin", "HOME=/root"]
        inside = ["nsenter", "--target", str(first), "--all", "--wdns=/root", "env", "-i", *named, "bash", "-c", line]
        done = subprocess.run(inside, capture_output=True, text=True, timeout=LINE_S, check=False)
        assert done.returncode in accept, (self.name, line, done.returncode, done.stdout, done.stderr)
        return done.stdout

    def _first(self):
        """The first process of the container, with which all others end."""
        children = Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children").read_text().split()
        return int(children[0])

    def close(self):
        with contextlib.suppress(OSError, IndexError):
            os.kill(self._first(), signal.SIGKILL)
        self._process.kill()
        self._process.wait()
        self._log.close()
        for _ in range(50):
            # what the container ran ends a moment later
            if _run("umount", "--recursive", self.root)[0]:
                break
            threading.Event().wait(0.1)
        _run("umount", self._folder / "memory")


def kill_left_behind():
    """Containers outlive a test that was killed."""
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            told = dict(v.split("=", 1) for v in environment.read_text(errors="replace").split("\0") if "=" in v)
            owner = told.get(OWNER)
            if owner is not None and not Path(f"/proc/{owner}").exists():
                os.kill(int(environment.parent.name), signal.SIGKILL)


def _run(*command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=60.0, check=False)
    return done.returncode == 0, done.stderr


def _must(*command):
    succeeded, said = _run(*command)
    if not succeeded:
        pytest.skip(f"this system cannot play machines: {command[0]}: {said}")


@pytest.fixture
def machines(tmp_path):
    """Four machines, booted, by name, and their network."""
    if shutil.which("systemd-nspawn") is None:
        pytest.skip("there is no systemd-nspawn here (Debian: systemd-container)")
    if sys.version_info[:2] != _version_of(SYSTEM_PYTHON):
        pytest.skip(f"{SYSTEM_PYTHON} is another Python than {sys.executable}, and units may not look into homes")
    if any(REPOSITORY.is_relative_to(folder) for folder in OF_THEIR_OWN):
        pytest.skip(f"units do not see a checkout below {', '.join(OF_THEIR_OWN)}: clone it elsewhere, such as /opt")
    kill_left_behind()
    with contextlib.ExitStack() as stack:
        try:
            network = stack.enter_context(connected_hosts(HOSTS))
        except CannotError as error:
            pytest.skip(str(error))
        booted = {}
        for name in HOSTS:
            booted[name] = Machine(name, tmp_path / name, network.namespace(name))
            stack.callback(booted[name].close)
        for machine in booted.values():
            machine.wait()
        yield booted, network


def _version_of(interpreter):
    if not interpreter.exists():
        return None
    asked = [str(interpreter), "-c", "import sys; print(*sys.version_info[:2])"]
    return tuple(int(n) for n in subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split())


def lines():
    """Who types what, in the order of the page."""
    page = PAGE.read_text().split(TYPED_UNTIL)[0]
    return [(found["who"][:-1], found["line"]) for found in LINE.finditer(page)]


def test_the_page_leads_from_four_machines_to_a_rig_that_runs(machines):
    booted, network = machines
    address = {f"10.0.0.{11 + i}": network.address(host) for i, host in enumerate(HOSTS)}
    by_address = dict(zip(address, HOSTS, strict=True))
    said = {}
    exported = ""
    for who, line in lines():
        if line.startswith(NOT_TYPED):
            continue
        if line.startswith("scp "):
            _, _, source, target = line.split()
            host = by_address[target.removeprefix("root@").removesuffix(":")]
            shutil.copytree(booted["desk"].root / "root" / source, booted[host].root / "root" / Path(source).name)
            continue
        if line.startswith("export "):
            exported = f"{line}; "
            continue
        if line.startswith("suturegrasp doctor"):
            wait_until_all_is_there(booted["desk"], exported)
        for host in HOSTS if who == "each" else (who,):
            own = line.removeprefix("sudo ")
            if own.startswith("make "):
                # up to date already; with another interpreter it would install again
                continue
            # a machine that is busy, as this one with all four, is no fault of the page
            accept = (0, 1, 3) if "doctor" in own or "status" in own or "goal" in own else (0,)
            said[own] = booted[host].type(exported + own, accept)
        if line.startswith("cp "):
            # "give each host its address"
            lab = booted["desk"].root / "root" / "lab.toml"
            text = lab.read_text().replace("rate_hz = 30.0", "rate_hz = 3.0")
            for example, real in address.items():
                text = text.replace(example, real)
            lab.write_text(text)
    told = said["suturegrasp doctor"]
    assert "access rules for operator.desk: in force" in told
    assert all(f"agents on {host}" in told for host in ("video", "strong", "robot"))
    assert "camera" in said["suturegrasp status --once"]
    each_reads_its_own_key_only(booted)
    for host in HOSTS:
        failed = booted[host].type("systemctl list-units --failed --no-legend 'suturegrasp*'")
        assert failed == "", (host, failed)


def each_reads_its_own_key_only(booted):
    """Tried as the user of each service: every key file, and what systemd hands out to it and to the others."""
    tried = 0
    for machine in booted.values():
        listed = machine.type("ls /etc/systemd/system | grep '^suturegrasp-.*service$' || true").split()
        keys = machine.type("ls /etc/suturegrasp/certificates/*.key").split()
        assert all(key.endswith(".key") for key in keys)
        for unit in listed:
            user = unit.removesuffix(".service")
            as_user = f"setpriv --reuid={user} --regid=suturegrasp --init-groups"
            for key in keys:
                assert machine.type(f"{as_user} cat {key} > /dev/null 2>&1 && echo read || echo denied") == "denied\n"
            for other in listed:
                found = machine.type(
                    f"{as_user} sh -c 'cat /run/credentials/{other}/*.key > /dev/null 2>&1' && echo read || echo no"
                )
                assert found == ("read\n" if other == unit else "no\n"), (user, other)
                tried += 1
    assert tried >= 6
    # who is in the group of operators reads theirs, and nobody else's
    desk = booted["desk"]
    desk.type("useradd --system --no-create-home ann && usermod --append --groups suturegrasp-operators ann")
    as_ann = "setpriv --reuid=ann --regid=ann --init-groups"
    for key in desk.type("ls /etc/suturegrasp/certificates/*.key").split():
        found = desk.type(f"{as_ann} cat {key} > /dev/null 2>&1 && echo read || echo denied")
        assert found == ("read\n" if "/operator." in key else "denied\n"), key


def wait_until_all_is_there(desk, exported):
    """Until every unit of every host has found the router, which a reader's own slowness would wait for."""
    deadline_s, told = monotonic_s() + RUNNING_S, ""
    while monotonic_s() < deadline_s:
        told = desk.type(f"{exported}suturegrasp status --once --json", (0, 1, 2))
        if told.count('"alive": true') >= 6 or told.count("heartbeat") >= 6:
            return
        threading.Event().wait(1.0)
    pytest.fail(f"not all agents came: {told}")
