"""A Compose file of a host: our image for the agents, Eclipse Zenoh's for the router.

Containers share the host's network, so that addresses are those of the rig, and its shared memory, through which
Zenoh passes images. Each is given its own certificate alone, as secrets.
"""

import io
from typing import Any

from ruamel.yaml import YAML

from agents.deployment.layout import ROUTER, Host, Process
from agents.deployment.places import HOME, RIG_FILE, SECRETS, SESSIONS
from agents.deployment.units import NOT_OURS, REALTIME_PRIORITY, command_line, keeps_time, row_of
from shared.runtime.identity import AUTHORITY_FILE
from shared.runtime.session import ROUTER_RUNTIME, RUNTIME_VARIABLE

ZENOH_IMAGE = "eclipse/zenoh:1.10.2"
IMAGE = "suturegrasp"
ROUTER_FILE = "router.json5"
IMAGE_USER = 7447
"""Of all containers. A secret that is a file keeps its owner and mode on the host, so that has to be this one."""


def compose_file(rig: str, host: Host, calibration: str = "") -> str:
    """The Compose file of a host, in YAML; `calibration` is where the camera's lies beside the rig's file."""
    ours = [process for process in host.processes if process.kind not in NOT_OURS]
    services = {p.common_name.replace(".", "-"): _service(host, p, calibration) for p in ours}
    secrets = {
        file: {"file": f"./certificates/{file}"}
        for p in ours
        for file in (AUTHORITY_FILE, f"{p.common_name}.pem", f"{p.common_name}.key")
    }
    document = {
        "services": services,
        "secrets": {_secret(file): where for file, where in secrets.items()},
        "volumes": {"sessions": {}},
    }
    text = io.StringIO()
    yaml = YAML()
    yaml.default_flow_style = False
    yaml.dump(document, text)
    return f"# rig {rig}, host {host.name}: docker compose up --detach\n{text.getvalue()}"


def _service(host: Host, process: Process, calibration: str) -> dict[str, Any]:
    name = process.common_name
    service: dict[str, Any] = {
        "image": IMAGE,
        "user": f"{IMAGE_USER}:{IMAGE_USER}",
        "restart": "unless-stopped",
        "network_mode": "host",
        # images go through the host's shared memory
        "ipc": "host",
        "read_only": True,
        "cap_drop": ["ALL"],
        "security_opt": ["no-new-privileges:true"],
        "tmpfs": ["/tmp"],  # noqa: S108
        "secrets": [
            {"source": _secret(file), "target": file} for file in (AUTHORITY_FILE, f"{name}.pem", f"{name}.key")
        ],
        "volumes": [f"./{RIG_FILE}:{HOME / RIG_FILE}:ro"],
        "environment": {"CREDENTIALS_DIRECTORY": str(SECRETS)},
    }
    if process.kind == ROUTER:
        service["image"] = ZENOH_IMAGE
        service["command"] = ["--config", f"/etc/zenoh/{ROUTER_FILE}"]
        service["volumes"] = [f"./{ROUTER_FILE}:/etc/zenoh/{ROUTER_FILE}:ro"]
        service["environment"] = {RUNTIME_VARIABLE: ROUTER_RUNTIME}
        return service
    service["working_dir"] = str(HOME)
    command = command_line(process, SESSIONS).split()
    service["command"] = [*command, "--config", str(HOME / RIG_FILE), "--host", host.name]
    kind = row_of(process)
    if kind is not None and kind.writes:
        service["volumes"].append(f"sessions:{SESSIONS}")
        service["working_dir"] = str(SESSIONS)
    if kind is not None and kind.audited:
        service["volumes"].append(f"sessions:{SESSIONS}")
        service["environment"]["STATE_DIRECTORY"] = str(SESSIONS)
    if kind is not None and kind.films:
        service["device_cgroup_rules"] = ["c 81:* rmw"]
        service["volumes"].append("/dev:/dev")
        if calibration:
            service["volumes"].append(f"./{calibration}:{HOME / calibration}:ro")
    if keeps_time(host, process):
        service["cap_add"] = ["SYS_NICE"]
        service["ulimits"] = {"rtprio": REALTIME_PRIORITY}
    return service


def _secret(file: str) -> str:
    return file.replace(".", "-")
