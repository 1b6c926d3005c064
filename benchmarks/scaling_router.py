"""The router of a scaling run, as a process of its own, and what it takes.

    python -m benchmarks.scaling_router '{"endpoint": "tls/127.0.0.1:7447", "certificates": "FOLDER", ...}'

is told what `suturegrasp router` tells Zenoh, but for shared memory, which can be left out so that everything goes the
way it goes between hosts.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil
import zenoh

from shared.runtime.access import ROUTER, access_control
from shared.runtime.identity import identity_in
from shared.runtime.session import ROUTER_RUNTIME, RUNTIME_VARIABLE, router_settings

SENT, RECEIVED = re.compile(r"bytes_sent:(\d+)"), re.compile(r"bytes_received:(\d+)")


@dataclass(frozen=True)
class RouterRun:
    """How a router is to run.

    Fields:
        certificates: folder; empty for a plain router.
        names: common names that may do what is theirs.
        shared_memory: whether large payloads may go through it.
    """

    endpoint: str
    rig: str
    certificates: str
    names: tuple[str, ...]
    shared_memory: bool

    def command(self) -> list[str]:
        """What starts it."""
        return [sys.executable, "-m", "benchmarks.scaling_router", json.dumps(asdict(self))]


@dataclass(frozen=True)
class Reading:
    """What a router has taken so far: seconds of the processors, bytes received and sent on its links."""

    cpu_s: float
    received: int
    sent: int


def reading(process: subprocess.Popen[str], endpoint: str, inside: tuple[str, ...] = ()) -> Reading:
    """Of a router of this machine; links that have ended are not counted. `inside` goes before a command there."""
    port = endpoint.rsplit(":", 1)[1]
    # iproute2's, which counts what each connection has carried
    command = (*inside, shutil.which("ss") or "ss", "-tinH", f"sport = :{port}")
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return Reading(cpu_s(process), _sum(RECEIVED, listed), _sum(SENT, listed))


def cpu_s(process: subprocess.Popen[str]) -> float:
    """Seconds of the processors that a process took, in user and system mode."""
    times = psutil.Process(process.pid).cpu_times()
    return times.user + times.system


def _sum(counter: re.Pattern[str], text: str) -> int:
    return sum(int(found) for found in counter.findall(text))


def main() -> None:
    """Route until standard input ends."""
    run = RouterRun(**json.loads(sys.argv[1]))
    identity = identity_in(Path(run.certificates), ROUTER) if run.certificates else None
    access = access_control(run.rig, run.names) if run.certificates else None
    settings = router_settings(run.endpoint, identity, access)
    settings["transport/shared_memory/enabled"] = run.shared_memory
    config = zenoh.Config()
    for name, value in settings.items():
        config.insert_json5(name, json.dumps(value))
    with zenoh.open(config):
        print("ready", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    os.environ.setdefault(RUNTIME_VARIABLE, ROUTER_RUNTIME)
    main()
