"""Which host runs what, and how everybody reaches the router: the one place where endpoint and identity are chosen."""

import subprocess
import sys
from pathlib import Path

from agents.cli.lab.rehearsal.network import OWN, CannotError, Network
from agents.cli.lab.rehearsal.rehearsed import SIMULATED_CALIBRATION
from agents.configuration.hosts import OPERATOR, HostSection, SecuritySection
from agents.configuration.rig import (
    ArmSection,
    CameraSection,
    RigConfig,
    RouterSection,
    SimulatorSection,
    simulated_rig,
)
from agents.configuration.sections import DvrkSection, PlannerSection
from agents.configuration.this_host import at_host, certificates_of
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.runtime.config import load_config
from shared.runtime.session import SessionSettings
from tests.rigs.robot.lab import today

ARM = "psm1"
EMULATED = "psm2"
CONSOLE_PORT = 7448
ROUTER, BRIDGE = "router", "robot-bridge"
PLANS_WAIT_S = 60.0
"""How old a plan may be when it is armed: on two cores, a command takes a second to load."""
RUNS = {
    ROUTER: (ROUTER,),
    "video": ("simulator", "camera"),
    "strong": ("perception", "reconstruction", "planner"),
    "robot": (BRIDGE,),
    "desk": ("record",),
}
"""Commands by host; the operator's own are at the desk too."""
HOSTS = tuple(RUNS)
OF_EMULATED = {"robot": (f"guard {EMULATED}",), "strong": (f"robot_bridge {EMULATED}",)}
KINDS = {BRIDGE: "robot_bridge", "record": "recorder"}
"""Names of agents in keys, where they are not the command's."""
MODULE = (sys.executable, "-m", "agents.cli")
CONFIG = "rig.json"
LIMIT_S = 60.0


def describe(network: Network, rate_hz: float, folder: Path, emulated: bool = False) -> None:
    """Write the rig on these hosts, and make its certificates: a folder for each host, and one for us at the switch.

    Everything is simulated, with few enough frames for two cores, and an easy thread; `emulated`: but for a second arm,
    whose console is at the host of the robot, and its bridge is not. Nothing of that arm is started with the others.

    Raises:
        CannotError: where no certificates can be made.
    """
    more = OF_EMULATED if emulated else {}
    hosts = {
        name: HostSection(address=network.address(name), realtime=True, runs=(*_runs(name), *more.get(name, ())))
        for name in (*HOSTS, OWN)
    }
    arms = {ARM: ArmSection(maximum_plan_age_s=PLANS_WAIT_S)}
    if emulated:
        arms[EMULATED] = _emulated_arm(network)
    sections = {
        "router": RouterSection(host=ROUTER),
        "hosts": hosts,
        "security": SecuritySection(),
        "camera": CameraSection(rate_hz=rate_hz),
        "robot": arms,
        # easy thread is known so well that nothing need slide; of this one, the middle runs along the rows
        "simulator": SimulatorSection(config="singularity" if emulated else "easy", background="plain"),
        "planner": PlannerSection(policy_model="paper"),
        "viewer": None,
    }
    rig = simulated_rig().model_copy(update=sections).model_dump_json(exclude_none=True)
    for name in hosts:
        (folder / name).mkdir(parents=True)
        (folder / name / CONFIG).write_text(rig)
    made = [*MODULE, "deploy", "certificates", "--config", str(folder / OWN / CONFIG), "--folder", str(folder)]
    done = subprocess.run(made, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    if done.returncode != 0:
        raise CannotError(f"no certificates can be made: {done.stderr.strip()}")


def settings_at(config: Path) -> SessionSettings:
    """How an operator reaches the dataflow from the host whose copy of the configuration this is."""
    rig = load_config(config, RigConfig)
    return certificates_of(at_host(rig, config.parent.name), config).session


def _emulated_arm(network: Network) -> ArmSection:
    console = f"tls/{network.address('robot')}:{CONSOLE_PORT}"
    dvrk = DvrkSection(
        endpoint=console,
        emulated_at=console,
        has_no=("teleoperation", "clutch", "tissue"),
        pedal="footpedals/operator_present",
        dry_run=False,
    )
    told = {"T_camera_base": SIMULATED_BASES[EMULATED].tolist(), "maximum_plan_age_s": PLANS_WAIT_S}
    known = {"T_camera_base_calibration": SIMULATED_CALIBRATION, "T_camera_base_made": today()}
    return ArmSection.model_validate({"backend": "dvrk", "dvrk": dvrk, **told, **known})


def _runs(host: str) -> tuple[str, ...]:
    """As a rig's file names what runs on a host; whoever probes is an operator to the others."""
    named = {"robot-bridge": f"robot_bridge {ARM}", "record": "recorder"}
    return (*(named.get(name, name) for name in RUNS.get(host, ()) if name != ROUTER), OPERATOR)
