"""`suturegrasp guard`: starts the safety monitor of one arm on the robot's computer, and tells the rig how it fares.

The monitor (agents/guard) is a process of its own that loads nothing of this one. It is given one document: the robot's
limits, and all keys and settings as text. What it does comes back as lines, which are told and written down here; where
this process ends, the monitor holds the arm if it moves, and ends too, and then nothing passes to the console.
"""

import base64
import contextlib
import json
import logging
import subprocess
import sys
import threading
from typing import Any

from agents.configuration.hosts import kind_and_instance, run_name
from agents.configuration.rig import RigConfig
from agents.configuration.sections import CameraSection, DvrkSection
from agents.guard.__main__ import EXIT_LINK_BROKE
from agents.launch.audit import AuditError, AuditLog, audit_of
from agents.launch.host_facts import around
from agents.launch.process import EXIT_GAVE_UP, EXIT_OK, stopping
from agents.robot_bridge.limits import PSM_JOINT_SPEEDS, MotionLimits
from schemas.messages import Heartbeat
from schemas.topics import HEARTBEAT, key
from schemas.wire import PACKAGE, descriptors_of
from shared.clock import monotonic_s, now_ns
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.ros.guarded import ALIVE, CHALLENGE, SET_POINT, key_of
from shared.ros.naming import GUARD_NODE, NODE, Naming, RmwZenoh, Role, Ros2dds
from shared.ros.types import EMPTY, JOINT_STATE, JOY, STRING_STAMPED
from shared.runtime.attachment import encoding_of
from shared.runtime.config import ConfigError, config_hash
from shared.runtime.connection import Connection, NoRouterError, connected
from shared.runtime.facts import ask_for_realtime
from shared.runtime.process import ServiceManager
from shared.runtime.session import SessionSettings, client_settings
from shared.terminal import complain, say

KIND = "guard"
REALTIME_PRIORITY = 50
"""As a bridge has on the same computer."""
LOGGER = logging.getLogger(f"suturegrasp.{KIND}")
SERVOS = ("servo_jp", "jaw/servo_jp")
TWIN_S, SILENT_S, ENDS_S = 2.0, 2.0, 5.0


def naming_of(section: DvrkSection | CameraSection, node: str = NODE) -> Naming:
    """How the robot's computer carries ROS."""
    return Ros2dds() if section.codec == "ros2dds" else RmwZenoh(section.domain, section.type_hashes, node)


def run_guard(rig: RigConfig, arm: str) -> int:
    """Watch one arm until stopped.

    Raises:
        ConfigError: where the configuration has no such arm of a dVRK.
    """
    section = rig.robot[arm].dvrk if arm in rig.robot else None
    if section is None:
        raise ConfigError(f"the configuration has no section [robot.{arm}.dvrk]: there is nothing to guard")
    stopped = stopping()
    own = run_name(KIND, arm)
    document = document_of(rig, arm, section)
    refused = ask_for_realtime(REALTIME_PRIORITY) if rig.realtime_here else ""
    keeper = _Keeper(section.arm, document, audit_of(rig, own), stopped)
    telling = threading.Thread(target=_tell_rig, args=(rig, own, keeper, refused, stopped), name="rig")
    telling.start()
    say(f"guards {section.arm} at {section.endpoint}; stop with Ctrl-C")
    keeper.run()
    telling.join()
    return complain(keeper.gave_up, EXIT_GAVE_UP) if keeper.gave_up else EXIT_OK


def document_of(rig: RigConfig, arm: str, section: DvrkSection) -> dict[str, Any]:
    """All that the monitor of an arm is told.

    Raises:
        IdentityError: where a certificate cannot be used.
    """
    naming, console, own = naming_of(section, GUARD_NODE), section.arm, run_name(KIND, arm)
    robot = SessionSettings(rig.rig, section.endpoint, rig.identity_of(own))
    says = {
        **{servo: (f"{console}/{servo}", JOINT_STATE) for servo in SERVOS},
        "hold": (f"{console}/hold", EMPTY),
        "state_command": (f"{console}/state_command", STRING_STAMPED),
    }
    hears = {
        **{name: (f"{console}/{name}", JOINT_STATE) for name in (*SERVOS, "measured_js", "jaw/measured_js")},
        "hold": (f"{console}/hold", EMPTY),
        **({"pedal": (section.pedal, JOY)} if section.pedal else {}),
    }
    roles = [(Role.NODE, ("", "")), *((Role.SUBSCRIBER, topic) for topic in hears.values())]
    roles += [(Role.PUBLISHER, topic) for topic in says.values()]
    tokens = (naming.token("{session}", entity, role, *of, latched=False) for entity, (role, of) in enumerate(roles))
    heartbeat = key(rig.rig, HEARTBEAT, arm)
    return {
        "description": description_of(arm, section),
        "robot": {
            "settings": client_settings(robot),
            "attachments": naming.attachment(0, 0, bytes(16)) is not None,
            "tokens": [token for token in tokens if token is not None],
            "says": {name: naming.key(*topic) for name, topic in says.items()}
            | {CHALLENGE: key_of(console, CHALLENGE)},
            "hears": {name: naming.selector(*topic) for name, topic in hears.items()}
            | {name: key_of(console, name) for name in (SET_POINT, ALIVE)},
        },
        "rig": {
            "settings": client_settings(rig.session_of(own)),
            "heartbeat": heartbeat,
            "encoding": encoding_of(Heartbeat, heartbeat),
            "message": f"{PACKAGE}.{Heartbeat.__name__}",
            "descriptors": base64.b64encode(descriptors_of(Heartbeat.__name__).SerializeToString()).decode(),
        },
    }


def description_of(arm: str, section: DvrkSection) -> dict[str, Any]:
    """The robot's limits, and speeds that no motion of ours needs more of: joints in their order, then the jaw."""
    psm, ours = LARGE_NEEDLE_DRIVER, MotionLimits()
    axes = [[*limits, speed] for limits, speed in zip(psm.limits.tolist(), PSM_JOINT_SPEEDS, strict=True)]
    axes.append([*map(float, psm.jaw_limit), ours.jaw_speed / ours.joint_share])
    rate = {"rate_hz": section.set_point_hz, "pedal": section.pedal is not None}
    return {"arm": arm, "console": section.arm, "axes": axes} | rate


class _Keeper:
    """Runs the monitor, and another one where the robot's Zenoh was lost; reads what it does.

    Fields:
        fault: what is wrong now; empty where nothing is.
        gave_up: why this guard does not go on; empty where it was stopped.
    """

    def __init__(self, console: str, document: dict[str, Any], audit: AuditLog, stopped: threading.Event) -> None:
        self._console, self._document, self._audit, self._stopped = console, document, audit, stopped
        self._manager, self._heard_s = ServiceManager(), 0.0
        self.fault, self.gave_up = "the robot's Zenoh is not reached yet: nothing passes to the console", ""

    def run(self) -> None:
        """Until stopped."""
        # it guards whatever comes, whether rig and robot are there yet or not
        self._manager.ready()
        while not self._stopped.is_set() and not self.gave_up:
            status = self._monitored()
            if not self._stopped.is_set() and status != EXIT_LINK_BROKE:
                self.gave_up = self.gave_up or f"the monitor has ended with status {status}; see its log above"
            elif not self._stopped.is_set():
                self.fault = "the robot's Zenoh was lost: nothing passes to the console; see that it runs"
                LOGGER.warning("%s: %s", self._console, self.fault)
        self._stopped.set()
        self._manager.stopping()

    def _monitored(self) -> int:
        command = [sys.executable, "-m", "agents.guard"]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as monitor:
            assert monitor.stdin is not None  # noqa: S101 - it is a pipe
            assert monitor.stdout is not None  # noqa: S101
            monitor.stdin.write(json.dumps(self._document).encode() + b"\n")
            monitor.stdin.flush()
            threading.Thread(target=self._read, args=(monitor.stdout,), name="monitor", daemon=True).start()
            begun_s = monotonic_s()
            while monitor.poll() is None and not self._stopped.wait(0.1):
                # before it has reached the robot's Zenoh there is nothing to be heard of
                if not self._heard_s or monotonic_s() - max(self._heard_s, begun_s) < SILENT_S:
                    self._manager.alive()
                else:
                    self.fault = f"its monitor has said nothing for {SILENT_S:g} s: nothing passes to the console"
            with contextlib.suppress(OSError):
                monitor.stdin.close()
            try:
                return monitor.wait(ENDS_S)
            except subprocess.TimeoutExpired:
                # it waits inside Zenoh for a robot that is not there
                monitor.kill()
                return monitor.wait()

    def _read(self, lines: Any) -> None:
        for line in lines:
            self._heard_s = monotonic_s()
            try:
                told = json.loads(line)
            except ValueError:
                continue
            if told["what"] in ("hold", "pause"):
                self._note(told["what"], told["why"])
            elif told["what"] == "failed":
                self.gave_up = told["why"]
            else:
                self.fault = ""

    def _note(self, what: str, why: str) -> None:
        say(f"{self._console}: {what}, for {why}")
        LOGGER.warning("%s: %s, for %s", self._console, what, why)
        try:
            self._audit.add(what, now_ns(), reason=why)
        except AuditError as error:
            # an arm is held all the same
            LOGGER.warning("%s", error)


def _tell_rig(rig: RigConfig, own: str, keeper: _Keeper, refused: str, stopped: threading.Event) -> None:
    """Tell the rig how the guard fares for as long as the rig is there."""
    kind, arm = kind_and_instance(own)
    asked = REALTIME_PRIORITY if rig.realtime_here else None
    known = around(rig, own, realtime_asked=asked, realtime_refused=refused)
    with contextlib.suppress(NoRouterError), connected(rig.session_of(own), None, stopped) as connection:
        if _another(connection, f"{kind}/{arm}", stopped):
            keeper.gave_up = f"another guard of {arm} runs already, which goes on; stop that one first"
            stopped.set()
            return
        with connection.reporting(kind, arm, LOGGER, lambda: keeper.fault, config_hash(rig), known):
            stopped.wait()


def _another(connection: Connection, name: str, stopped: threading.Event) -> bool:
    """Whether another guard of the arm is there, and stays: one that was killed is seen for a moment longer."""
    return name in connection.present() and not stopped.wait(TWIN_S) and name in connection.present()
