"""The demo's rig as processes, its page's server beside it, and what its arms and agents tell."""

import contextlib
import re
import threading
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agents.cli.live.up import write_config
from agents.configuration.rig import PlannerSection, RigConfig, RouterSection, SimulatorSection, simulated_rig
from agents.configuration.sections import CameraSection
from agents.launch.supervisor import Child, Role, Supervisor, supervised
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import AgentHealth, RobotMode, RobotState
from schemas.topics import COMMANDS, FRAMES, HEALTH, ROBOT_STATE, THREAD
from shared.clock import monotonic_s, now_ns
from shared.runtime.connection import Connection, connected
from shared.runtime.session import free_local_endpoint
from shared.runtime.taps import Tapped

STARTS_S = 60.0
SETTLES_S = 3.0
"""Health comes once a second."""
AGENTS = ("simulator", "perception", "reconstruction", "planner", "robot-bridge")
LINK = re.compile(r"http://\S+")


@dataclass
class Heard:
    """What the rig tells.

    Fields:
        states: when each state of the arm was measured, and its mode.
        thread_ms: how old each thread was when it came, with the time.
        health: newest of each agent.
        commands: how many were received by agents.
        published: frames, by their numbers.
    """

    states: list[tuple[int, RobotMode]] = field(default_factory=list[tuple[int, RobotMode]])
    thread_ms: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    health: dict[str, AgentHealth] = field(default_factory=dict[str, AgentHealth])
    commands: int = 0
    published: int = 0

    def take(self, tapped: Tapped) -> None:
        """Put a message away."""
        if tapped.topic is FRAMES:
            self.published = max(self.published, 0 if tapped.beside is None else tapped.beside.sequence + 1)
            return
        with contextlib.suppress(MessageError):
            message: Any = decode(tapped.topic.message, tapped.payload)
            match message:
                case RobotState():
                    self.states.append((message.measured_ns, message.mode))
                case AgentHealth():
                    self.health[message.agent] = message
                case _ if tapped.topic is THREAD:
                    self.thread_ms.append((monotonic_s(), (now_ns() - message.stamp.capture_left_ns) * 1e-6))
                case _:
                    self.commands += tapped.topic is COMMANDS


@dataclass
class Rig:
    """What runs."""

    folder: Path
    supervisor: Supervisor
    connection: Connection
    heard: Heard
    server: Child
    camera: Child

    def link(self) -> str:
        """The newest link to the page."""
        return LINK.findall(self.server.log.read_text())[-1]

    def mode(self) -> RobotMode | None:
        """What the arm does now."""
        return self.heard.states[-1][1] if self.heard.states else None


def until(condition: Callable[[], Any], what: str, limit_s: float = STARTS_S) -> Any:
    """Wait for a condition.

    Raises:
        RuntimeError: where it does not come true.
    """
    deadline_s, turn = monotonic_s() + limit_s, threading.Event()
    while not (value := condition()):
        if monotonic_s() > deadline_s:
            raise RuntimeError(f"waited {limit_s:.0f} s for {what}")
        turn.wait(0.02)
    return value


def paged_rig(rate_hz: float) -> RigConfig:
    """The demo's rig with that camera, on a port of its own."""
    return simulated_rig().model_copy(
        update={
            "rig": "paged",
            "router": RouterSection(endpoint=free_local_endpoint()),
            "camera": CameraSection(rate_hz=rate_hz),
            "planner": PlannerSection(least_probability=0.0),
            "simulator": SimulatorSection(seed=3, config="hard", distance_mm=85.0),
            "recorder": None,
            "viewer": None,
        }
    )


@contextlib.contextmanager
def running(folder: Path, rate_hz: float) -> Generator[Rig]:
    """The rig, the camera last, so that whoever hears it hears its first frame, and the page's server."""
    rig, config, heard = paged_rig(rate_hz), folder / "rig.json", Heard()
    write_config(config, rig)
    with supervised(restart=False) as supervisor:

        def start(name: str, *arguments: str, role: Role = Role.AGENT) -> Child:
            return supervisor.add(name, [*arguments, "--config", str(config)], folder / f"{name}.log", role)

        start("router", "router", role=Role.ROUTER)
        for name in AGENTS:
            start(name, "run", name)
        with connected(rig.session, STARTS_S) as connection:
            connection.listen((FRAMES, ROBOT_STATE, HEALTH, THREAD, COMMANDS), heard.take)
            until(lambda: {n.replace("-", "_") for n in AGENTS} <= heard.health.keys(), "all agents")
            camera = start("camera", "run", "camera")
            server = start("page", "page", "--no-open", "--port", "0", role=Role.VIEWER)
            until(lambda: server.log.exists() and LINK.search(server.log.read_text()), "the page's link")
            until(lambda: heard.thread_ms, "a thread")
            yield Rig(folder, supervisor, connection, heard, server, camera)


def frames_unaccounted(rig: Rig) -> tuple[int, dict[str, int]]:
    """End the camera, and say which of its frames perception's own account lacks, with that account."""
    assert rig.camera.process is not None
    rig.camera.process.terminate()
    rig.camera.process.wait()

    def account() -> dict[str, int]:
        inputs = [i for i in rig.heard.health["perception"].inputs if i.topic.endswith("frames")]
        return {n: sum(getattr(i, n) for i in inputs) for n in ("received", "dropped", "missed", "refused")}

    settled, at_s, turn = account(), monotonic_s(), threading.Event()
    while monotonic_s() - at_s < SETTLES_S:
        turn.wait(0.1)
        if (now := account()) != settled:
            settled, at_s = now, monotonic_s()
    published = rig.heard.published
    return published - sum(settled.values()), settled | {"published": published}
