"""A secured rig on this one host for intruders to try: certificates, rules, and every agent as a process of its own."""

import contextlib
import datetime
import shutil
import socket
import threading
from collections import defaultdict
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

from agents.cli.lab.deploy import layout_of
from agents.cli.live.up import write_config
from agents.configuration.hosts import OPERATOR, HostSection, SecuritySection
from agents.configuration.rig import (
    ArmSection,
    CameraSection,
    RigConfig,
    RouterSection,
    SimulatorSection,
    simulated_rig,
)
from agents.deployment.certificates import CERTIFICATES, issue
from agents.deployment.places import AUTHORITY_FOLDER
from agents.launch.supervisor import Role, Supervisor, supervised
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import AgentHealth
from schemas.topics import COMMANDS, CONFIGURATION, HEALTH, LOG, PLAN, TOOL, TOPICS, Delivery, Topic, key_root
from shared.clock import monotonic_s, now_ns
from shared.runtime.connection import Connection, connected
from shared.runtime.identity import identity_in
from shared.runtime.session import SessionSettings, free_local_endpoint, open_session
from shared.runtime.taps import Tapped
from tests.command_words import words

RIG, DESK, ARM, ROUTER = "lab", "desk", "psm1", "router"
BRIDGE = f"robot_bridge {ARM}"
RUNS = ("simulator", "camera", "perception", "reconstruction", "planner", BRIDGE, "recorder", OPERATOR)
COMMANDS_OF = {"recorder": "record", BRIDGE: "robot-bridge"}
NAMES = {"simulator": "simulator.main", "robot_bridge": f"robot_bridge.{ARM}", OPERATOR: f"{OPERATOR}.{DESK}"}
STARTS_S, LOOK_S = 60.0, 0.005
LATE_DAYS = 31


class CannotError(RuntimeError):
    """This machine cannot play it; the text says why."""


def own_address() -> str:
    """An address of this machine that is not loopback, over which nothing starts without certificates.

    Raises:
        CannotError: where it has none.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        # nothing is sent: this only asks by which address it would be
        probe.connect(("10.255.255.255", 1))
        if not (address := probe.getsockname()[0]).startswith("127."):
            return address
    raise CannotError("this machine has no address but its loopback one")


@dataclass
class Heard:
    """Everything that an operator heard: counts by key and run of its publisher, and the newest health."""

    counts: defaultdict[tuple[str, int | None], int] = field(default_factory=lambda: defaultdict(int))
    times_s: defaultdict[tuple[str, int | None], list[float]] = field(default_factory=lambda: defaultdict(list))
    newest: dict[tuple[str, int], int] = field(default_factory=dict[tuple[str, int], int])
    health: dict[str, AgentHealth] = field(default_factory=dict[str, AgentHealth])
    faults: defaultdict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    logged: list[tuple[str, str]] = field(default_factory=list[tuple[str, str]])
    plans: list[Any] = field(default_factory=list[Any])

    def take(self, tapped: Tapped) -> None:
        """Count a message; of what cannot be read, nothing more is known."""
        run = None if tapped.beside is None else tapped.beside.epoch
        self.counts[tapped.key, run] += 1
        self.times_s[tapped.key, run].append(monotonic_s())
        if tapped.beside is not None:
            self.newest[tapped.key, tapped.beside.epoch] = tapped.beside.sequence
        if tapped.topic in (HEALTH, LOG, PLAN):
            with contextlib.suppress(MessageError):
                self._read(tapped, decode(tapped.topic.message, tapped.payload))

    def _read(self, tapped: Tapped, message: Any) -> None:
        kind = tapped.key.split("/")[2]
        if tapped.topic is HEALTH and message.agent == kind:
            self.health[kind] = message
            if message.fault.startswith("a step failed"):
                self.faults[kind].add(message.fault)
        elif tapped.topic is LOG:
            self.logged.append((kind, message.text))
        elif tapped.topic is PLAN:
            self.plans.append(message)


@dataclass
class Rig:
    """What intruders act on, and what is heard beside it."""

    config: RigConfig
    folder: Path
    supervisor: Supervisor
    connection: Connection
    heard: Heard
    _stack: contextlib.ExitStack
    _sessions: dict[str, zenoh.Session] = field(default_factory=dict[str, zenoh.Session])

    @property
    def certificates(self) -> Path:
        """Where valid certificates lie."""
        return self.folder / "made" / DESK / CERTIFICATES

    def session(self, name: str) -> zenoh.Session:
        """A session that shows the certificate of that common name."""
        if name not in self._sessions:
            settings = SessionSettings(RIG, self.config.router_endpoint, identity_in(self.certificates, name))
            self._sessions[name] = self._stack.enter_context(open_session(settings))
        return self._sessions[name]

    def start(self, *names: str) -> None:
        """Start processes, as `runs` writes them."""
        for name in names:
            start(self.supervisor, self.folder, name)

    def until_ready(self, *kinds: str) -> None:
        """Wait for the health of these."""
        self.until(lambda: set(kinds) <= set(self.heard.health), f"the health of {', '.join(kinds)}", STARTS_S)

    def until(self, condition: Callable[[], Any], what: str, limit_s: float) -> Any:
        """Wait until something holds; its value.

        Raises:
            TimeoutError: where it does not in time; the text says what was waited for, and who has ended.
        """
        end_s, turn = monotonic_s() + limit_s, threading.Event()
        while not (value := condition()):
            if monotonic_s() > end_s:
                raise TimeoutError(f"waited {limit_s:.0f} s for {what}; {'; '.join(self.ended()) or 'all run'}")
            turn.wait(LOOK_S)
        return value

    def ended(self) -> list[str]:
        """Which processes have ended by themselves, and how."""
        return [f"{c.name}: {c.log.read_text()[-300:]}" for c in self.supervisor.children if not c.running]

    def root(self, kind: str) -> str:
        """What the keys of an agent begin with."""
        instance = ARM if kind == "robot_bridge" else DESK if kind in (OPERATOR, "recorder") else "main"
        return key_root(RIG, instance, kind)


def start(supervisor: Supervisor, folder: Path, name: str) -> None:
    """Start a process of the rig."""
    extra = ("--arm", ARM) if name == BRIDGE else ()
    extra = ("--output", str(folder / "session.mcap")) if name == "recorder" else extra
    roles = {ROUTER: Role.ROUTER, "recorder": Role.RECORDER}
    arguments = [*words(COMMANDS_OF.get(name, name)), *extra, "--config", str(folder / "rig.json")]
    supervisor.add(name, arguments, folder / f"{name}.log", roles.get(name, Role.AGENT))


@contextlib.contextmanager
def secured_rig(folder: Path, *names: str) -> Generator[Rig]:
    """A rig with certificates whose router and these processes run, and an operator who hears all of it.

    Raises:
        CannotError: where this machine has no address for it.
    """
    config = _described(folder)
    with contextlib.ExitStack() as stack:
        supervisor = stack.enter_context(supervised(restart=False))
        start(supervisor, folder, ROUTER)
        connection = stack.enter_context(connected(config.session, STARTS_S))
        heard = Heard()
        connection.listen(tuple(t for t in TOPICS if t.delivery is not Delivery.COMMAND), heard.take)
        rig = Rig(config, folder, supervisor, connection, heard, stack)
        rig.start("recorder", *names)
        yield rig


def _described(folder: Path) -> RigConfig:
    sections = {
        "rig": RIG,
        "router": RouterSection(host=DESK, port=int(free_local_endpoint().rsplit(":", 1)[1])),
        "hosts": {DESK: HostSection(address=own_address(), runs=RUNS)},
        "security": SecuritySection(certificates=folder / "made" / DESK / CERTIFICATES),
        "camera": CameraSection(rate_hz=3.0),
        "robot": {ARM: ArmSection()},
        "simulator": SimulatorSection(config="easy", background="plain"),
        "viewer": None,
    }
    rig = simulated_rig().model_copy(update=sections)
    layout, at = layout_of(rig), datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC)
    issue(layout, folder / "made", at)
    issue(layout, folder / "foreign", at)
    # of the lab's own authority, and out of date
    shutil.copytree(folder / "made" / AUTHORITY_FOLDER, folder / "expired" / AUTHORITY_FOLDER)
    issue(layout, folder / "expired", at - datetime.timedelta(days=LATE_DAYS))
    rig = rig.model_copy(update={"host": DESK})
    write_config(folder / "rig.json", rig)
    return rig


def owned_topics() -> list[tuple[Topic, str]]:
    """Every topic that is published, with each kind of agent that owns a key of it.

    Replays are not on this rig, and nobody looks for a tool, so that nobody has a certificate for it.
    """
    kinds = ("camera", "perception", "reconstruction", "planner", "robot_bridge", "simulator")
    found = [(t, t.agent) for t in TOPICS if t.delivery is not Delivery.COMMAND and t is not TOOL]
    found = [(t, kind) for t, kind in found if kind in (*kinds, OPERATOR)]
    return found + [(t, kind) for t in (HEALTH, LOG, COMMANDS, CONFIGURATION) for kind in kinds]
