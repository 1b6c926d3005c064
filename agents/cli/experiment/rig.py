"""The rig of an experiment: one that runs, with a recorder beside it, or one that is started for each thread."""

import contextlib
import threading
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path

from agents.cli.experiment.options import Experiment
from agents.cli.experiment.trial import ExperimentError
from agents.cli.live.up import FIRST_CONTACT_S, start_all, write_config
from agents.configuration.rig import (
    CameraSection,
    PlannerSection,
    RigConfig,
    RouterSection,
    SimulatorSection,
    simulated_rig,
)
from agents.experiment.journal import Protocol
from agents.launch.session_folder import SessionFolder, new_session_folder
from agents.launch.supervisor import Role, Supervisor, last_line, supervised
from shared.runtime.config import ConfigError, parse_config
from shared.runtime.connection import ROUTER_WAIT_S, Connection, connected
from shared.runtime.session import SessionSettings, free_local_endpoint
from shared.terminal import say

RECORDER = "recorder"
FRAMES_HZ = 5.0
"""Of a simulated thread, which lies still until a plan is carried out."""


@dataclass(frozen=True)
class Started:
    """A rig to try a thread on.

    Fields:
        session: what records it; None where nothing does, or a recorder of the rig's own.
        real_arm: whether its configuration has an arm that could be real.
        check: raises an ExperimentError where a process that was started here has ended.
    """

    reached: SessionSettings
    session: Path | None
    real_arm: bool
    check: Callable[[], None]


@contextlib.contextmanager
def on_rig(
    rig: RigConfig, options: Experiment, protocol: Protocol, thread: str, folder: Path, stopped: threading.Event
) -> Generator[Started]:
    """The rig for one thread.

    Raises:
        ConfigError: where the thread is none that can be simulated.
        NoRouterError: where no router answers.
    """
    session = new_session_folder(folder / thread.replace("/", "-"))
    with supervised(restart=False) as supervisor:
        if options.start:
            rig = simulated(thread, protocol, options.record)
            config = session.path / "rig.json"
            write_config(config, rig)
            start_all(supervisor, rig, config, session, "file")
        with connected(rig.session, FIRST_CONTACT_S if options.start else ROUTER_WAIT_S, stopped) as connection:
            recorded = options.start and options.record
            if not options.start and options.record:
                recorded = _recording(rig, connection, supervisor, session)
            real = rig.robot[protocol.arm].dvrk is not None
            yield Started(rig.session, session.recording if recorded else None, real, lambda: _check(supervisor))
    if recorded:
        say(last_line(session.log(RECORDER)))


def simulated(thread: str, protocol: Protocol, records: bool) -> RigConfig:
    """Everything on this machine with a field of that configuration and background, on a port of its own.

    Raises:
        ConfigError: where there is no such field.
    """
    configuration, background, *number = thread.split("/")
    seed = int(number[0]) if number else 1
    section = f'seed = {seed}\nconfig = "{configuration}"\nbackground = "{background}"\n'
    field = parse_config(section, SimulatorSection, f"of the simulated thread {thread}")
    sections = {
        "router": RouterSection(endpoint=free_local_endpoint()),
        "simulator": field,
        "camera": CameraSection(rate_hz=FRAMES_HZ),
        # the paper grasped wherever it was asked to
        "planner": PlannerSection(least_probability=0.0),
        "viewer": None,
        **({} if records else {"recorder": None}),
    }
    whole = simulated_rig()
    if protocol.arm not in whole.robot:
        raise ConfigError(f"the simulated rig has no arm {protocol.arm!r}; its arms: {', '.join(whole.robot)}")
    return whole.model_copy(update=sections)


def _recording(rig: RigConfig, connection: Connection, supervisor: Supervisor, session: SessionFolder) -> bool:
    """Record beside a rig that runs, unless it does so itself."""
    if any(name.startswith(f"{RECORDER}/") for name in connection.present()):
        say("a recorder of the rig's own keeps this session")
        return False
    identity = rig.identity_of(RECORDER)
    if identity is not None and not identity.certificate.exists():
        say("this session is not recorded, for this host has no certificate of a recorder: put one into its runs")
        return False
    config = session.path / "rig.json"
    write_config(config, rig)
    arguments = ["record", "--output", str(session.recording), "--config", str(config)]
    supervisor.add(RECORDER, arguments, session.log(RECORDER), Role.RECORDER)
    return True


def _check(supervisor: Supervisor) -> None:
    for change in supervisor.watch():
        raise ExperimentError(change.sentence)
