"""Two sites with a rig and a `suturegrasp router` each, linked: what goes over the link for what is read across it."""

import contextlib
import json
import subprocess
import sys
import threading
from collections.abc import Generator
from pathlib import Path
from typing import Any

from agents.cli.lab.rehearsal.network import Network, connected_hosts
from agents.cli.live.up import write_config
from agents.configuration.hosts import HostSection, SecuritySection
from agents.configuration.rig import ArmSection, RouterSection, simulated_rig
from benchmarks.scaling_load import WARM_UP_S, End
from benchmarks.scaling_rigs import SETTLE_S, account, end_command, is_event, result, started, tell

NORTH, SOUTH = "north", "south"
ARM, PORT = "psm1", 7447
RUNS = ("camera", "perception", "reconstruction", "planner", f"robot_bridge {ARM}", "viewer", "operator")
NOBODY = "nobody"
READERS = (NOBODY, "followed", "everything")
"""Who reads rig north at site south; see AUDIENCES."""
LIMIT_S = 60.0


def measure_sites(seconds: float, folder: Path, readers: tuple[str, ...] = READERS) -> list[dict[str, Any]]:
    """What crosses the link each way for each reader, while both rigs run with all their agents.

    Raises:
        CannotError: where this system makes no such network.
    """
    with connected_hosts((NORTH, SOUTH)) as network:
        describe(network, folder)
        with started_routers(network, folder):
            return [_read_across(network, folder, reader, seconds) for reader in readers]


def describe(network: Network, folder: Path) -> None:
    """Write the file of each site, and make the certificates of both with one authority."""
    northern = f"tls/{network.address(NORTH)}:{PORT}"
    routers = {
        NORTH: RouterSection(host=NORTH, port=PORT, read_by_others=True),
        SOUTH: RouterSection(host=SOUTH, port=PORT, connect=(northern,), reads=(NORTH,)),
    }
    for site, router in routers.items():
        host = HostSection(address=network.address(site), runs=RUNS)
        sections = {
            "rig": site,
            "robot": {ARM: ArmSection()},
            "router": router,
            "hosts": {site: host},
            "security": SecuritySection(certificates=folder / site / "certificates"),
            "simulator": None,
            "recorder": None,
        }
        write_config(folder / f"{site}.json", simulated_rig().model_copy(update=sections))
        command = [sys.executable, "-m", "agents.cli", "deploy", "certificates"]
        given = ["--config", str(folder / f"{site}.json"), "--folder", str(folder)]
        subprocess.run([*command, *given], check=True, capture_output=True, timeout=LIMIT_S)


@contextlib.contextmanager
def started_routers(network: Network, folder: Path) -> Generator[None]:
    """`suturegrasp router` at both sites."""
    with contextlib.ExitStack() as stack:
        for site in (NORTH, SOUTH):
            command = [sys.executable, "-m", "agents.cli", "router", "--config", str(folder / f"{site}.json")]
            router = stack.enter_context(
                subprocess.Popen([*network.inside(site), *command, "--host", site], stdout=subprocess.PIPE, text=True)
            )
            stack.callback(router.kill)
            assert router.stdout is not None
            said = router.stdout.readline()
            assert said.startswith("router on tls/"), said
        yield


def _read_across(network: Network, folder: Path, reader: str, seconds: float) -> dict[str, Any]:
    """One reader for so many seconds."""
    own = [_end(network, folder, role, site, site) for role in ("hear", "send") for site in (NORTH, SOUTH)]
    across = [] if reader == NOBODY else [_end(network, folder, "hear", NORTH, SOUTH, reader)]
    commands = [[*network.inside(site), *end_command(end)] for site, end in (*across, *own)]
    with started(commands) as processes:
        threading.Event().wait(SETTLE_S)
        for process in processes:
            tell(process, f"{seconds}\n")
        threading.Event().wait(WARM_UP_S)
        before = _carried(network)
        threading.Event().wait(seconds)
        after = _carried(network)
        told = [result(process) for process in processes]
    sent = told[len(across) + 2 :]
    topics = account(told[: len(across)], sent)
    return {
        "reader": reader,
        "north to south kB/s": round(1e-3 * (after[0] - before[0]) / seconds, 1),
        "south to north kB/s": round(1e-3 * (after[1] - before[1]) / seconds, 1),
        "events lost": sum(heard.missing for topic, heard in topics.items() if is_event(topic)),
        "topics": {topic: heard.row() for topic, heard in topics.items()},
        "at the sites": {topic: heard.row() for topic, heard in account(told[len(across) : -2], sent).items()},
    }


def _end(network: Network, folder: Path, role: str, rig: str, site: str, audience: str = "agents") -> tuple[str, End]:
    """An end at a site, which reaches that site's router and is about a rig."""
    certificates = str(folder / site / "certificates")
    endpoint = f"tls/{network.address(site)}:{PORT}"
    return site, End(role, endpoint, rig, operator=site, arm=ARM, audience=audience, certificates=certificates)


def _carried(network: Network) -> tuple[int, int]:
    """Bytes that have come to site south, and that have left it, headers included."""
    command = ["ip", "-n", network.namespace(SOUTH), "-json", "-statistics", "link", "show", "eth0"]
    listed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    counted = json.loads(listed)[0]["stats64"]
    return counted["rx"]["bytes"], counted["tx"]["bytes"]
