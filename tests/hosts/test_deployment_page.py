"""docs/deployment.md, typed line by line on four machines with systemd, for which containers stand."""

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
from tests.hosts.conftest import copy_of_this_machine

REPOSITORY = Path(__file__).parents[2]
PAGE = REPOSITORY / "docs" / "deployment.md"
HOSTS = ("video", "strong", "robot", "desk")
LINE = re.compile(r"^    (?P<who>desk\$|(?:each|video|strong|robot)#) (?P<line>.+)$", re.MULTILINE)
# what needs the internet, or names a machine: the machines share this one's files below their own
NOT_TYPED = ("apt-get ", "git ", "adduser ", "docker ")
TYPED_UNTIL = "## Certificates"
OWNER = "SUTUREGRASP_TESTED_BY"
"""Environment variable of a container's first process."""
BOOT_S, LINE_S, RUNNING_S = 60.0, 60.0, 120.0
SYSTEM_PYTHON, OUR_PYTHON = Path("/usr/bin/python3"), [str(n) for n in sys.version_info[:2]]
OF_THEIR_OWN = "/tmp", "/var/tmp", "/home", "/root", "/run"  # noqa: S108 - where nothing is written
"""Folders that containers and hardened units have for themselves: a checkout in one is not there for them."""
pytestmark = [pytest.mark.hosts, pytest.mark.timeout(400)]


class Machine:
    """A container that boots systemd over a copy of this machine's files."""

    def __init__(self, name, root, namespace, log):
        self.name, self.root, self._log = name, root, log
        # what a machine of its own would have: a name, the checkout's place, and an interpreter outside of homes
        (root / "etc" / "hostname").write_text(f"{name}\n")
        (root / "opt" / "suturegrasp").symlink_to(REPOSITORY)
        inside = root / REPOSITORY.relative_to("/") / ".venv"
        for interpreter in ("python3.11", "python3", "python"):
            (inside / "bin" / interpreter).unlink(missing_ok=True)
            (inside / "bin" / interpreter).symlink_to(SYSTEM_PYTHON)
        (inside / "pyvenv.cfg").write_text(f"home = {SYSTEM_PYTHON.parent}\ninclude-system-site-packages = false\n")
        shutil.rmtree(root / "etc" / "suturegrasp", ignore_errors=True)
        boots = [
            "systemd-nspawn", "--quiet", "--register=no", "--keep-unit", "--capability=all", f"--directory={root}",
            f"--machine={name}", f"--network-namespace-path=/run/netns/{namespace}", "--boot",
            f"--setenv={OWNER}={os.getpid()}", "systemd.unit=multi-user.target",
        ]  # fmt: skip
        with log.open("wb") as said:
            self._process = subprocess.Popen(boots, stdin=subprocess.DEVNULL, stdout=said, stderr=said)

    def wait(self):
        """Until systemd takes orders."""
        deadline_s = monotonic_s() + BOOT_S
        while monotonic_s() < deadline_s:
            with contextlib.suppress(IndexError, AssertionError):
                if self.type("systemctl is-active multi-user.target") == "active\n":
                    return
            threading.Event().wait(0.2)
        pytest.skip(f"no systemd boots in a container here: {self._log.read_text()[-300:]}")

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


def kill_left_behind():
    """Containers outlive a test that was killed."""
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            told = dict(v.split("=", 1) for v in environment.read_text(errors="replace").split("\0") if "=" in v)
            owner = told.get(OWNER)
            if owner is not None and not Path(f"/proc/{owner}").exists():
                os.kill(int(environment.parent.name), signal.SIGKILL)


@pytest.fixture
def machines(tmp_path):
    """Four machines, booted, by name, and their network."""
    if shutil.which("systemd-nspawn") is None:
        pytest.skip("there is no systemd-nspawn here (Debian: systemd-container)")
    version = [str(SYSTEM_PYTHON), "-c", "import sys; print(*sys.version_info[:2])"]
    if not SYSTEM_PYTHON.exists() or subprocess.check_output(version, text=True).split() != OUR_PYTHON:
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
            root = stack.enter_context(copy_of_this_machine(tmp_path / name))
            machine = Machine(name, root, network.namespace(name), tmp_path / f"{name}.log")
            booted[name] = stack.enter_context(contextlib.closing(machine))
        for machine in booted.values():
            machine.wait()
        yield booted, network


def test_the_page_leads_from_four_machines_to_a_rig_that_runs(machines):
    booted, network = machines
    address = {f"10.0.0.{11 + i}": network.address(host) for i, host in enumerate(HOSTS)}
    by_address = dict(zip(address, HOSTS, strict=True))
    said, exported = {}, ""
    for found in LINE.finditer(PAGE.read_text().split(TYPED_UNTIL)[0]):
        who, line = found["who"][:-1], found["line"]
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
        for unit in listed:
            as_user = f"setpriv --reuid={unit.removesuffix('.service')} --regid=suturegrasp --init-groups"
            assert not [key for key in keys if reads(machine, as_user, key)], unit
            handed_out = [other for other in listed if reads(machine, as_user, f"/run/credentials/{other}/*.key")]
            assert handed_out == [unit]
            tried += len(listed)
    assert tried >= 6
    # who is in the group of operators reads theirs, and nobody else's
    desk = booted["desk"]
    desk.type("useradd --system --no-create-home ann && usermod --append --groups suturegrasp-operators ann")
    as_ann = "setpriv --reuid=ann --regid=ann --init-groups"
    for key in desk.type("ls /etc/suturegrasp/certificates/*.key").split():
        assert reads(desk, as_ann, key) == ("/operator." in key), key


def reads(machine, as_user, files):
    return machine.type(f"{as_user} sh -c 'cat {files} > /dev/null 2>&1' && echo read || echo denied") == "read\n"


def wait_until_all_is_there(desk, exported):
    """Until every unit of every host has found the router, which a reader's own slowness would wait for."""
    deadline_s, told = monotonic_s() + RUNNING_S, ""
    while monotonic_s() < deadline_s:
        told = desk.type(f"{exported}suturegrasp status --once --json", (0, 1, 2))
        if told.count('"alive": true') >= 6 or told.count("heartbeat") >= 6:
            return
        threading.Event().wait(1.0)
    pytest.fail(f"not all agents came: {told}")
