"""The files that each host of a rig needs, from the rig's one file; nothing is written here."""

import json
from pathlib import Path, PurePosixPath

from agents.deployment.containers import ROUTER_FILE, compose_file
from agents.deployment.layout import ROUTER, ROUTER_NAME, Host, Layout
from agents.deployment.places import RIG_FILE, SECRETS
from agents.deployment.robot_zenoh import FILE as ROBOT_ZENOH_FILE
from agents.deployment.robot_zenoh import nested, robot_zenoh_file
from agents.deployment.units import names_its_arm, units
from shared.runtime.access import access_control
from shared.runtime.identity import AUTHORITY_FILE, Identity
from shared.runtime.session import router_settings

UNITS_FOLDER = "systemd"
COMPOSE_FILE = "compose.yaml"


def plan(layout: Layout, rig_text: str) -> dict[PurePosixPath, str]:
    """Text of every file but the certificates, by its place below the folder of the plan: `{host}/...`.

    `rig_text` is the rig's file, which each host gets with one line more, its own name.
    """
    files: dict[PurePosixPath, str] = {}
    for host in layout.hosts:
        home = PurePosixPath(host.name)
        files[home / RIG_FILE] = f'host = "{host.name}"\n{rig_text}'
        files[home / COMPOSE_FILE] = compose_file(layout.rig, host, layout.calibration)
        files |= {home / UNITS_FOLDER / name: text for name, text in units(layout.rig, host).items()}
        if any(process.kind == ROUTER for process in host.processes):
            files[home / ROUTER_FILE] = router_file(layout)
        if host.arms:
            files[home / ROBOT_ZENOH_FILE] = robot_zenoh_file(layout.rig, host.name, host.arms)
    return files


def router_file(layout: Layout) -> str:
    """What zenohd is told in its container: the same that our own router is."""
    paths = [Path(SECRETS / file) for file in (AUTHORITY_FILE, f"{ROUTER_NAME}.pem", f"{ROUTER_NAME}.key")]
    access = access_control(layout.rig, layout.common_names(), layout.sites)
    settings = router_settings(layout.endpoint, Identity(*paths), access, layout.sites.connect)
    return f"// rig {layout.rig}: for zenohd\n{json.dumps(nested(settings), indent=2)}\n"


def hosts_in_words(layout: Layout) -> list[str]:
    """One line for each host."""
    return [f"{host.name} ({host.address}): {_processes_of(host)}" for host in layout.hosts]


def _processes_of(host: Host) -> str:
    named = [f"{p.kind} {p.instance}" if names_its_arm(p) else p.kind for p in host.processes]
    return ", ".join(named) or "nothing"
