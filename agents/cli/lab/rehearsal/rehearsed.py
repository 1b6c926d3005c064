"""What a rehearsal has in place of a lab's hardware, and what each of its hosts runs."""

import datetime
import json
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agents.configuration.hosts import BESIDE, HostSection
from agents.configuration.rig import ArmSection, CameraSection, RigConfig, SimulatorSection
from agents.configuration.this_host import CREDENTIALS
from agents.deployment.layout import Host, Layout, Process
from agents.deployment.places import CERTIFICATES, HOME, PROGRAM, RIG_FILE, SESSIONS
from agents.deployment.robot_zenoh import ROBOT_ZENOH, robot_zenoh_file
from agents.deployment.units import NOT_OURS, unit_name, units
from agents.launch.audit import STATE_DIRECTORY
from schemas.topics import MAIN
from shared.clock import now_ns
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.runtime.config import parse_config

PROGRAM_HERE = (sys.executable, "-m", "agents.cli")
CONFIG, BASES, CONSOLE = "rig.json", "bases.json", "robot-zenoh.json5"
FRAMES_HZ_PER_CORE = 2.5
"""What one core looks through beside the other agents, where all hosts share the cores of one machine."""
APART_M = 0.02
SIMULATED_CALIBRATION = "beca2fa23c61"
"""Of the simulated camera, the same in every field."""


@dataclass(frozen=True)
class Started:
    """A process of a host, as its unit starts it.

    Fields:
        name: as `runs` writes it, with the host where several run one.
    """

    name: str
    host: str
    command: tuple[str, ...]
    environment: dict[str, str]


def without_hardware(rig: RigConfig) -> tuple[RigConfig, list[str]]:
    """The rig with the simulated field in place of its camera and emulated consoles, and what became of what."""
    told: list[str] = []
    sections: dict[str, object] = {}
    camera = rig.camera
    if camera is not None:
        rate_hz = min(camera.rate_hz, FRAMES_HZ_PER_CORE * (os.cpu_count() or 1))
        if rate_hz < camera.rate_hz:
            told.append(f"{rate_hz:g} frames a second in place of {camera.rate_hz:g}, for all hosts share this machine")
        sections["camera"] = CameraSection(rate_hz=rate_hz, encoding=camera.encoding, jpeg_quality=camera.jpeg_quality)
        if camera.source != "scene":
            told.append(f"the simulated field in place of the camera's {camera.source}")
    if camera is not None and rig.simulator is None:
        sections["simulator"] = SimulatorSection()
        sections["hosts"] = {name: _with_simulator(host) for name, host in rig.hosts.items()}
    arms = {name: _standing(name, arm, number) for number, (name, arm) in enumerate(rig.robot.items())}
    sections["robot"] = arms
    told += [f"an emulated console in place of that of {name}" for name, arm in arms.items() if arm.dvrk is not None]
    text = rig.model_copy(update=sections).model_dump_json(exclude_none=True)
    return parse_config(text, RigConfig, "of the rehearsal.json"), told


def _with_simulator(host: HostSection) -> HostSection:
    return host.model_copy(update={"runs": (*host.runs, "simulator")}) if "camera" in host.runs else host


def _standing(name: str, arm: ArmSection, number: int) -> ArmSection:
    """An arm before the simulated camera: a real one's registration is of another, and so is what its jaw does."""
    if arm.dvrk is None and arm.T_camera_base_file is None and arm.jaw_file is None:
        return arm
    base = np.array(SIMULATED_BASES.get(name, SIMULATED_BASES["psm1"]))
    if name not in SIMULATED_BASES:
        # beside the others, no two in one place
        base[1, 3] += APART_M * (number + 1)
    today = datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC).date()
    stands = {
        "T_camera_base": base.tolist(),
        "T_camera_base_file": None,
        "jaw_file": None,
        "T_camera_base_calibration": SIMULATED_CALIBRATION,
        "T_camera_base_made": today.isoformat(),
    }
    if arm.dvrk is not None:
        stands["dvrk"] = arm.dvrk.model_dump() | {"emulated_at": arm.dvrk.endpoint}
    return ArmSection.model_validate(arm.model_dump() | stands)


def write_hosts(rig: RigConfig, layout: Layout, folder: Path) -> None:
    """Write each host's copy of the rig's configuration and, where consoles are emulated, what they need."""
    for host in layout.hosts:
        home = folder / host.name
        home.mkdir(parents=True, exist_ok=True)
        own = {
            "host": host.name,
            "security": rig.security and rig.security.model_copy(update={"certificates": Path("certificates")}),
        }
        text = rig.model_copy(update=own).model_dump_json(exclude_none=True)
        (home / CONFIG).write_text(text)
        if host.arms:
            zenoh = robot_zenoh_file(layout.rig, host.name, host.arms).replace(str(CERTIFICATES.parent), str(home))
            (home / CONSOLE).write_text(zenoh)
            bases = {arm.console: {"T_camera_base": rig.robot[arm.arm].T_camera_base} for arm in host.arms}
            (home / BASES).write_text(json.dumps(next(iter(bases.values())) if len(bases) == 1 else bases))


def started_on(layout: Layout, host: Host, folder: Path) -> list[Started]:
    """What runs on a host, each as its systemd unit has it: command, credentials, state."""
    files = units(layout.rig, host)
    ours = [process for process in host.processes if process.kind not in NOT_OURS]
    names = [name_in(layout, process, host) for process in ours]
    started = [
        _as_unit(name, process, files[unit_name(process)], host, folder / host.name)
        for name, process in zip(names, ours, strict=True)
    ]
    return [*_consoles(layout, host, folder / host.name), *started]


def name_in(layout: Layout, process: Process, host: Host) -> str:
    """What a process is called in a rig."""
    if process.kind not in BESIDE:
        return process.kind if process.instance == MAIN else f"{process.kind} {process.instance}"
    several = sum(any(process.kind == other.kind for other in one.processes) for one in layout.hosts) > 1
    return f"{process.kind} {host.name}" if several else process.kind


def _as_unit(name: str, process: Process, unit: str, host: Host, home: Path) -> Started:
    own = home / "units" / unit_name(process)
    credentials, state = own / "credentials", own / "state"
    for place in (credentials, state):
        place.mkdir(parents=True, exist_ok=True)
    for file in re.findall(r"^LoadCredential=([^:\n]+):", unit, re.MULTILINE):
        link = credentials / file
        link.unlink(missing_ok=True)
        link.symlink_to(home / "certificates" / file)
    command = re.findall(r"^ExecStart=(.*)$", unit, re.MULTILINE)[0].removeprefix(f"{PROGRAM} ").split()
    places = {str(HOME / RIG_FILE): str(home / CONFIG)}
    words = [
        places.get(word, str(state / Path(word).name) if word.startswith(f"{SESSIONS}/") else word) for word in command
    ]
    environment = {CREDENTIALS: str(credentials), STATE_DIRECTORY: str(state)}
    return Started(name, host.name, (*PROGRAM_HERE, *words), environment)


def _consoles(layout: Layout, host: Host, home: Path) -> list[Started]:
    """The emulated console of the arms at a host, which a person operates with a foot on its pedal."""
    if not host.arms:
        return []
    first = host.arms[0]
    names = ",".join(arm.console for arm in host.arms)
    told = (
        ("--zenoh", str(home / CONSOLE))
        if any(p.kind == ROBOT_ZENOH for p in host.processes)
        else ("--listen", first.endpoint)
    )
    wire = ("--codec", first.codec, "--domain", str(first.domain))
    command = ("emulate", "dvrk", "--arm", names, "--ready", "--foot", *wire, *told, "--camera", str(home / BASES))
    several = sum(bool(one.arms) for one in layout.hosts) > 1
    return [Started(f"console {host.name}" if several else "console", host.name, (*PROGRAM_HERE, *command), {})]
