"""Several rigs on one router: what arrives, how late, and what the router takes for it."""

import contextlib
import datetime
import json
import os
import subprocess
import sys
import threading
from collections import defaultdict
from collections.abc import Generator, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from agents.deployment.certificates import issue
from agents.deployment.layout import ROUTER, Host, Layout, Process
from benchmarks.scaling_load import AGENTS, OPERATOR, WARM_UP_S, End
from benchmarks.scaling_router import RouterRun, cpu_s, reading
from schemas.topics import Delivery, topic_of
from shared.clock import now_ns
from shared.runtime.session import free_local_endpoint

RIG, HOST = "lab", "desk"
SETTLE_S, LIMIT_S = 1.0, 120.0
NETWORK, TLS, SHARED_MEMORY = "network", "network, TLS", "shared memory"
WAYS = (NETWORK, TLS, SHARED_MEMORY)


@dataclass(frozen=True)
class Place:
    """Where a router is reached, and what goes before commands that are to run beside it, and where the rigs are."""

    address: str = "127.0.0.1"
    router: tuple[str, ...] = ()
    ends: tuple[str, ...] = ()


HERE = Place()


@dataclass
class Heard:
    """What became of one topic's messages, over all rigs.

    Fields:
        missing: sent and not heard.
        told: what consumers count as lost.
        ms: on the way, of each message heard.
    """

    sent: int = 0
    missing: int = 0
    told: int = 0
    ms: list[float] = field(default_factory=list[float])

    def row(self) -> dict[str, Any]:
        """As it is printed."""
        p50, p99 = np.percentile(self.ms, (50, 99)) if self.ms else (np.nan, np.nan)
        delivered = 100.0 * (1.0 - self.missing / max(1, self.sent))
        return {
            "sent": self.sent,
            "delivered %": round(delivered, 2),
            "told lost": self.told,
            "p50 ms": round(float(p50), 2),
            "p99 ms": round(float(p99), 1),
        }


def certificates(folder: Path, rigs: int, address: str = HERE.address) -> tuple[str, ...]:
    """Certificates of all agents of these rigs and of their router, in one folder; the names of the agents."""
    kinds = [(kind, instance) for instance in map(instance_of, range(rigs)) for kind in (*AGENTS, OPERATOR)]
    processes = tuple(Process(kind, instance) for kind, instance in kinds)
    layout = Layout(RIG, "", (Host(HOST, address, (Process(ROUTER), *processes)),), 30, 3650)
    issue(layout, folder, datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC))
    return tuple(layout.common_names())


def instance_of(rig: int) -> str:
    """What all agents of a simulated rig have as their instance."""
    return f"r{rig}"


@contextlib.contextmanager
def started(commands: Iterable[list[str]]) -> Generator[list["subprocess.Popen[str]"]]:
    """Processes that have said `ready`, one after another; killed in the end."""
    with contextlib.ExitStack() as stack:
        begun = [
            stack.enter_context(
                subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ)
            )
            for command in commands
        ]
        for process in begun:
            stack.callback(process.kill)
        for process in begun:
            assert process.stdout is not None
            said = process.stdout.readline()
            assert said == "ready\n", f"{process.args} said {said!r}"
        yield begun


def end_command(end: End) -> list[str]:
    """What starts an end of the load."""
    return [sys.executable, "-m", "benchmarks.scaling_load", end.to_json()]


def measure(way: str, rigs: int, seconds: float, folder: Path, place: Place = HERE) -> dict[str, Any]:
    """So many rigs on one router, for so many seconds."""
    secured = way == TLS
    port = free_local_endpoint().rsplit(":", 1)[1]
    endpoint = f"{'tls' if secured else 'tcp'}/{place.address}:{port}"
    names = certificates(folder, rigs, place.address) if secured else ()
    home = str(folder / HOST / "certificates") if secured else ""
    router_run = RouterRun(endpoint, RIG, home, names, way == SHARED_MEMORY)
    ends = [
        End(role, endpoint, RIG, i, i, i, certificates=home, phase=number / rigs)
        for role in ("hear", "send")
        for number, i in enumerate(map(instance_of, range(rigs)))
    ]
    load_before = os.getloadavg()[0]
    commands = [[*place.ends, *end_command(end)] for end in ends]
    with started([[*place.router, *router_run.command()]]) as (router,), started(commands) as processes:
        threading.Event().wait(SETTLE_S)
        for process in processes:
            tell(process, f"{seconds}\n")
        threading.Event().wait(WARM_UP_S)
        before, cpu_before = reading(router, endpoint, place.router), sum(map(cpu_s, processes))
        psutil.cpu_percent()
        threading.Event().wait(seconds)
        after, cpu_after = reading(router, endpoint, place.router), sum(map(cpu_s, processes))
        busy = psutil.cpu_percent()
        told = [result(process) for process in processes]
        threads = psutil.Process(router.pid).num_threads()
        memory_mb = psutil.Process(router.pid).memory_info().rss / 1e6
    topics = account(told[:rigs], told[rigs:])
    messages = sum(heard.sent - heard.missing for heard in topics.values())
    router_s = after.cpu_s - before.cpu_s
    return {
        "way": way,
        "rigs": rigs,
        "seconds": seconds,
        "load before": round(load_before, 1),
        "machine %": round(busy, 0),
        "router cores": round(router_s / seconds, 3),
        "router us per message": round(1e6 * router_s / max(1, messages), 1),
        "ends cores": round((cpu_after - cpu_before) / seconds, 2),
        "router in MB/s": round(1e-6 * (after.received - before.received) / seconds, 2),
        "router out MB/s": round(1e-6 * (after.sent - before.sent) / seconds, 2),
        "router MB": round(memory_mb),
        "router threads": threads,
        "messages/s": round(messages / seconds),
        "events lost": sum(heard.missing for key, heard in topics.items() if is_event(key)),
        "topics": {name: heard.row() for name, heard in topics.items()},
    }


def account(heard: list[dict[str, Any]], sent: list[dict[str, list[int]]]) -> dict[str, Heard]:
    """By topic: what was sent while it counted, and what of that was heard."""
    topics: defaultdict[str, Heard] = defaultdict(Heard)
    ranges = {key: numbers for one in sent for key, numbers in one.items()}
    for one in heard:
        for key, rows in one["heard"].items():
            first, end = ranges[key]
            counted = {number: ms for number, ms in rows if first <= number < end}
            topic = topics[str(topic_of(key))]
            topic.sent += end - first
            topic.missing += end - first - len(counted)
            topic.told += one["lost"][key]
            topic.ms += counted.values()
    return dict(topics)


def is_event(topic: str) -> bool:
    """Whether nothing of a topic, as the table writes it, may be lost."""
    agent, name = topic.split("/")
    return topic_of(f"suturegrasp/lab/{agent}/main/{name}").delivery is Delivery.EVENT


def tell(process: "subprocess.Popen[str]", line: str) -> None:
    """Write a line to its standard input."""
    assert process.stdin is not None
    process.stdin.write(line)
    process.stdin.flush()


def result(process: "subprocess.Popen[str]") -> Any:
    """The one line of JSON that a process prints in the end."""
    said, _ = process.communicate(timeout=LIMIT_S)
    return json.loads(said)
