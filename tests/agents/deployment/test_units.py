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
HOST = Host("box", "10.0.0.1", PROCESSES, realtime=True)
CONFINED = {
    "NoNewPrivileges": "yes",
    "PrivateTmp": "yes",
    "ProtectSystem": "strict",
    "ProtectHome": "yes",
    "CapabilityBoundingSet": "",
    "SystemCallFilter": "@system-service",
}
STARTED_AGAIN = {
    "Type": "notify",
    "Restart": "on-failure",
    "RestartSec": "0.5",
    "RestartSteps": "5",
    "RestartMaxDelaySec": "10",
    "RestartPreventExitStatus": "2",
    "TimeoutStartSec": "infinity",
}
SERVICES = {name: text for name, text in units("lab", HOST).items() if name.endswith(".service")}


def told(text):
    """Keys of [Service], and what each is set to; a key that is there more than once is a list."""
    service: dict[str, list[str]] = {}
    for line in text.split("[Service]\n")[1].splitlines():
        if line and line[0] not in "#[":
            key, _, value = line.partition("=")
            service.setdefault(key, []).append(value)
    return service


def test_each_service_has_a_user_of_its_own_whose_name_is_short_enough():
    long = [Process("robot_bridge", f"an-arm-of-a-very-long-name-{k}") for k in range(3)]
    users = [user_of(process) for process in (*PROCESSES, *long)]
    assert len(set(users)) == len(users)
    assert max(map(len, users)) <= 31


@pytest.mark.parametrize("name", SERVICES)
def test_a_unit_is_confined_and_started_again_after_longer_and_longer_pauses(name):
    service = told(SERVICES[name])
    expected = CONFINED | STARTED_AGAIN
    assert {key: service.get(key) for key in expected} == {key: [value] for key, value in expected.items()}
    assert (service["User"], service["Group"]) == ([name.removesuffix(".service")], ["suturegrasp"])
    # for ever, however long it is away
    assert "StartLimitIntervalSec=0" in SERVICES[name].split("[Service]")[0]


def test_no_service_is_in_a_group_that_reads_keys_of_people():
    groups = [told(text).get(key, []) for text in SERVICES.values() for key in ("Group", "SupplementaryGroups")]
    assert {name for each in groups for name in each} == {"suturegrasp", "video"}


@pytest.mark.parametrize("process", [p for p in PROCESSES if p.kind != "operator"], ids=lambda p: p.common_name)
def test_a_unit_reads_its_own_certificate_and_is_watched_where_it_has_a_loop(process):
    (text,) = (
        text for text in SERVICES.values() if f"Description=SutureGrasp {process.kind} {process.instance} " in text
    )
    service = told(text)
    own = {"authority.pem", f"{process.common_name}.pem", f"{process.common_name}.key"}
    assert {told.split(":")[0] for told in service["LoadCredential"]} == own
    within = "60" if process.kind in ("perception", "tool_tracker", "reconstruction") else "10"
    assert service.get("WatchdogSec") == ([within] if process.kind in (*NAMES, "guard") else None)


def test_a_target_has_them_all_and_begins_with_the_machine():
    assert len(SERVICES) == len(PROCESSES) - 1, "all but people have a unit"
    target = configparser.ConfigParser(interpolation=None)
    target.read_string(units("lab", HOST)["suturegrasp.target"])
    assert set(target["Unit"]["Wants"].split()) == set(SERVICES)
    assert target["Install"]["WantedBy"] == "multi-user.target"


def test_a_container_is_confined_and_reads_its_own_certificate():
    document = YAML(typ="safe").load(compose_file("lab", HOST))
    assert len(document["services"]) == len(PROCESSES) - 1
    for process in (p for p in PROCESSES if p.kind != "operator"):
        service = document["services"][process.common_name.replace(".", "-")]
        assert service["read_only"] is True
        assert service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"]
        assert (service["network_mode"], service["ipc"]) == ("host", "host")
        assert service["restart"] == "unless-stopped"
        assert service["user"] == f"{IMAGE_USER}:{IMAGE_USER}"
        own = {"authority.pem", f"{process.common_name}.pem", f"{process.common_name}.key"}
        assert {secret["target"] for secret in service["secrets"]} == own
    # where a link to a host that is gone holds up a thread, others go on
    assert document["services"]["router-main"]["environment"] == {"ZENOH_RUNTIME": ROUTER_RUNTIME}


def test_a_camera_reaches_video_devices_alone_and_what_needs_no_device_none():
    camera = told(SERVICES["suturegrasp-camera.service"])
    assert (camera["DevicePolicy"], camera["DeviceAllow"]) == (["closed"], ["char-video4linux rw"])
    others = [name for name in SERVICES if name != "suturegrasp-camera.service"]
    assert {tuple(told(SERVICES[name])["PrivateDevices"]) for name in others} == {("yes",)}
