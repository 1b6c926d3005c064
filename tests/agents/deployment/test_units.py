"""What every unit and every container says, whatever runs in it: confined, watched, and started again after pauses."""

import configparser

import pytest
from ruamel.yaml import YAML

from agents.deployment.containers import IMAGE_USER, compose_file
from agents.deployment.layout import ROUTER, Host, Process
from agents.deployment.units import units, user_of
from agents.registry import NAMES
from shared.runtime.session import ROUTER_RUNTIME

PROCESSES = tuple(
    Process(*of)
    for of in (
        (ROUTER,), ("camera",), ("perception",), ("tool_tracker", "psm1"), ("reconstruction",), ("planner",),
        ("robot_bridge", "psm1"), ("guard", "psm1"), ("simulator",), ("recorder", "box"), ("viewer", "box"),
        ("operator", "box"),
    )
)  # fmt: skip
OURS = [process for process in PROCESSES if process.kind != "operator"]
HOST = Host("box", "10.0.0.1", PROCESSES, realtime=True)
UNITS = units("lab", HOST)
EACH_SAYS = {
    # confined
    "NoNewPrivileges": ["yes"],
    "PrivateTmp": ["yes"],
    "ProtectSystem": ["strict"],
    "ProtectHome": ["yes"],
    "CapabilityBoundingSet": [""],
    "SystemCallFilter": ["@system-service"],
    # started again after longer and longer pauses
    "Type": ["notify"],
    "Restart": ["on-failure"],
    "RestartSec": ["0.5"],
    "RestartSteps": ["5"],
    "RestartMaxDelaySec": ["10"],
    "RestartPreventExitStatus": ["2"],
    "TimeoutStartSec": ["infinity"],
    "Group": ["suturegrasp"],
}


def unit_of(process):
    """The name of its unit and what that says: keys of [Service], each with all that it is set to."""
    (name,) = [name for name, text in UNITS.items() if f"SutureGrasp {process.kind} {process.instance} of" in text]
    service: dict[str, list[str]] = {}
    for line in UNITS[name].split("[Service]\n")[1].splitlines():
        if line and line[0] not in "#[":
            key, _, value = line.partition("=")
            service.setdefault(key, []).append(value)
    return name, service


def own_files(process):
    return {"authority.pem", f"{process.common_name}.pem", f"{process.common_name}.key"}


def test_each_service_has_a_user_of_its_own_whose_name_is_short_enough():
    long = [Process("robot_bridge", f"an-arm-of-a-very-long-name-{k}") for k in range(3)]
    users = [user_of(process) for process in (*PROCESSES, *long)]
    assert len(set(users)) == len(users)
    assert max(map(len, users)) <= 31


@pytest.mark.parametrize("process", OURS, ids=lambda process: process.common_name)
def test_a_unit_is_confined_started_again_watched_and_reads_its_own_certificate(process):
    name, service = unit_of(process)
    assert {key: service.get(key) for key in EACH_SAYS} == EACH_SAYS
    assert service["User"] == [name.removesuffix(".service")]
    # for ever, however long it is away
    assert "StartLimitIntervalSec=0" in UNITS[name].split("[Service]")[0]
    assert {told.split(":")[0] for told in service["LoadCredential"]} == own_files(process)
    within = "60" if process.kind in ("perception", "tool_tracker", "reconstruction") else "10"
    assert service.get("WatchdogSec") == ([within] if process.kind in (*NAMES, "guard") else None)
    keeps_time = process.kind in ("camera", "simulator", "robot_bridge", "guard")
    assert (service.get("LimitRTPRIO"), "RestrictRealtime" in service) == (
        ["50"] if keeps_time else None,
        not keeps_time,
    )
    # a guard is there before its bridge
    assert ("Before=suturegrasp-robot-bridge-psm1.service" in UNITS[name]) == (process.kind == "guard")
    # a camera reaches video devices alone, and what needs no device none
    films = process.kind == "camera"
    assert service.get("DeviceAllow") == (["char-video4linux rw"] if films else None)
    assert (service.get("DevicePolicy"), service.get("PrivateDevices")) == (
        (["closed"], None) if films else (None, ["yes"])
    )


def test_no_service_is_in_a_group_that_reads_keys_of_people():
    groups = {name for p in OURS for key in ("Group", "SupplementaryGroups") for name in unit_of(p)[1].get(key, [])}
    assert groups == {"suturegrasp", "video"}


def test_a_target_has_all_but_people_and_begins_with_the_machine():
    target = configparser.ConfigParser(interpolation=None)
    target.read_string(UNITS["suturegrasp.target"])
    assert set(target["Unit"]["Wants"].split()) == {unit_of(process)[0] for process in OURS}
    assert target["Install"]["WantedBy"] == "multi-user.target"


def test_a_container_is_confined_and_reads_its_own_certificate():
    services = YAML(typ="safe").load(compose_file("lab", HOST))["services"]
    assert len(services) == len(OURS)
    for process in OURS:
        service = services[process.common_name.replace(".", "-")]
        assert service["read_only"] is True
        assert service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"]
        assert (service["network_mode"], service["ipc"]) == ("host", "host")
        assert service["restart"] == "unless-stopped"
        assert service["user"] == f"{IMAGE_USER}:{IMAGE_USER}"
        assert {secret["target"] for secret in service["secrets"]} == own_files(process)
    # where a link to a host that is gone holds up a thread, others go on
    assert services["router-main"]["environment"] == {"ZENOH_RUNTIME": ROUTER_RUNTIME}
