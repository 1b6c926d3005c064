"""The guard as a process on the robot's computer."""

import contextlib
import dataclasses
import logging
import threading
from collections.abc import Callable

from agents.cli.live.options import Guard
from agents.cli.rig.config import RigConfig
from agents.cli.rig.hosts import kind_and_instance, run_name
from agents.cli.rig.sections import CameraSection, DvrkSection
from agents.cli.running.around import around
from agents.cli.running.audit import AuditError, AuditLog, audit_of
from agents.cli.running.process import EXIT_GAVE_UP, EXIT_OK, on_stop
from agents.cli.terminal import complain, say
from agents.guard.gate import Gate
from agents.guard.watch import NOBODY_NS, Action, Heard, Watch
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import RobotMode, RobotState
from schemas.topics import HEARTBEAT, ROBOT_STATE
from shared.clock import now_ns
from shared.ros import crtk
from shared.ros import link as ros
from shared.ros.naming import ALIVE, GUARD_NODE, GUARDED, NODE, Naming, RmwZenoh, Ros2dds
from shared.ros.types import EMPTY, JOINT_STATE, STRING_STAMPED, RosMessageError
from shared.runtime.config import ConfigError, config_hash
from shared.runtime.connection import Connection, NoRouterError, connected
from shared.runtime.facts import ask_for_realtime
from shared.runtime.service_manager import ServiceManager
from shared.runtime.session import SessionSettings, check_security
from shared.runtime.taps import Tapped

KIND = "guard"
TURNS_HZ = 100.0
REALTIME_PRIORITY = 50
"""As a bridge has on the same computer."""
LOGGER = logging.getLogger(f"suturegrasp.{KIND}")
SERVOS = ("servo_jp", "jaw/servo_jp")
TWIN_S = 2.0


def naming_of(section: DvrkSection | CameraSection, node: str = NODE) -> Naming:
    """How the robot's computer carries ROS."""
    return Ros2dds() if section.codec == "ros2dds" else RmwZenoh(section.domain, section.type_hashes, node)


def guard(rig: RigConfig, options: Guard) -> int:
    """Watch one arm until stopped.

    Raises:
        ConfigError: where the configuration has no such arm of a dVRK.
    """
    section = rig.robot[options.arm].dvrk if options.arm in rig.robot else None
    if section is None:
        raise ConfigError(f"the configuration has no section [robot.{options.arm}.dvrk]: there is nothing to guard")
    stopped = threading.Event()
    on_stop(stopped.set)
    ears = _Ears(options.arm, section.arm)
    own = run_name(KIND, options.arm)
    reached = SessionSettings(rig.rig, section.endpoint, rig.identity_of(own))
    check_security(section.endpoint, reached.identity)
    refused = ask_for_realtime(REALTIME_PRIORITY) if rig.realtime_here else ""
    with contextlib.closing(_link(section, reached, ears)) as link:
        ears.pass_on = link.say if section.through_guard else None
        link.open()
        listening = threading.Thread(target=_listen, args=(rig, own, ears, link, refused, stopped), name="listen")
        listening.start()
        say(f"guards {section.arm} at {section.endpoint}; stop with Ctrl-C")
        _watch(section.arm, ears, link, audit_of(rig, own), stopped)
    listening.join()
    return complain(ears.second, EXIT_GAVE_UP) if ears.second else EXIT_OK


def _link(section: DvrkSection, reached: SessionSettings, ears: "_Ears") -> ros.RosLink:
    arm, through = section.arm, f"{GUARDED}/{section.arm}"
    heard = [ros.Heard(f"{arm}/{servo}", JOINT_STATE, ears.hear_set_point, others_only=True) for servo in SERVOS]
    heard.append(ros.Heard(f"{arm}/{Action.HOLD.value}", EMPTY, ears.hear_hold, others_only=True))
    said = [ros.Said(f"{arm}/{Action.HOLD.value}", EMPTY), ros.Said(f"{arm}/state_command", STRING_STAMPED)]
    if section.through_guard:
        heard += [ros.Heard(f"{through}/{servo}", JOINT_STATE, ears.gating(servo)) for servo in SERVOS]
        heard.append(ros.Heard(f"{through}/{ALIVE}", JOINT_STATE, ears.hear_alive))
        said += [ros.Said(f"{arm}/{servo}", JOINT_STATE) for servo in SERVOS]
    return ros.RosLink(reached, naming_of(section, GUARD_NODE), tuple(heard), tuple(said))


def _watch(arm: str, ears: "_Ears", link: ros.RosLink, audit: AuditLog, stopped: threading.Event) -> None:
    watch, manager = Watch(), ServiceManager()
    # it guards whatever comes, whether rig and robot are there yet or not
    manager.ready()
    while not stopped.wait(1 / TURNS_HZ):
        manager.alive()
        following = watch.turn(ears.heard(), now_ns())
        if following is None:
            continue
        action, why = following
        if action is Action.HOLD:
            ears.shut_gate()
            link.say(f"{arm}/hold", crtk.empty())
        else:
            link.say(f"{arm}/state_command", crtk.state_command(action.value, now_ns()))
        say(f"{arm}: {action.value}, for {why}")
        LOGGER.warning("%s: %s, for %s", arm, action.value, why)
        try:
            audit.add(action.value, now_ns(), reason=why)
        except AuditError as error:
            # an arm is held all the same
            LOGGER.warning("%s", error)
    manager.stopping()


def _listen(rig: RigConfig, own: str, ears: "_Ears", link: ros.RosLink, refused: str, stopped: threading.Event) -> None:
    """Hear the rig for as long as it is there, and tell it how the guard fares; without it nobody stands by."""
    kind, arm = kind_and_instance(own)
    settings = rig.session_of(own)
    asked = REALTIME_PRIORITY if rig.realtime_here else None
    known = around(rig, own, realtime_asked=asked, realtime_refused=refused)
    with contextlib.suppress(NoRouterError), connected(settings, None, stopped) as connection:
        connection.listen((HEARTBEAT, ROBOT_STATE), ears.hear_rig)
        if _another(connection, f"{kind}/{arm}", stopped):
            ears.second = f"another guard of {arm} runs already, which goes on; stop that one first"
            stopped.set()
            return
        with connection.reporting(kind, arm, LOGGER, lambda: _fault(link), config_hash(rig), known):
            stopped.wait()


def _another(connection: Connection, name: str, stopped: threading.Event) -> bool:
    """Whether another guard of the arm is there, and stays: one that was killed is seen for a moment longer."""
    return name in connection.present() and not stopped.wait(TWIN_S) and name in connection.present()


def _fault(link: ros.RosLink) -> str:
    if link.reaches():
        return ""
    return link.failed or "the robot's Zenoh is not reached: nothing is guarded; see that it runs on this computer"


class _Ears:
    """When what was heard last, and what of it is passed on; filled from other threads.

    Fields:
        pass_on: says a set point to the console; None where the bridge does that itself.
        second: why this guard must not go on; empty where it may.
    """

    def __init__(self, arm: str, console: str) -> None:
        self._arm, self._console, self._heard, self._state = arm, console, Heard(), (b"", 0)
        self._gate, self._lock = Gate(), threading.Lock()
        self.pass_on: Callable[[str, bytes], None] | None = None
        self.second = ""

    def hear_set_point(self, _data: bytes, at_ns: int) -> None:
        with self._lock:
            name = "stranger_ns" if self.pass_on is not None else "set_point_ns"
            self._heard = dataclasses.replace(self._heard, **{name: at_ns})

    def hear_hold(self, _data: bytes, at_ns: int) -> None:
        with self._lock:
            self._heard = dataclasses.replace(self._heard, over_ns=at_ns)

    def hear_alive(self, data: bytes, at_ns: int) -> None:
        with contextlib.suppress(RosMessageError):
            stamp_ns = crtk.joints(data).stamp_ns
            with self._lock:
                self._gate.alive(stamp_ns, at_ns)

    def shut_gate(self) -> None:
        with self._lock:
            self._gate.shut()

    def gating(self, servo: str) -> Callable[[bytes, int], None]:
        """Passes on what is fresh while somebody stands by."""

        def hear(data: bytes, at_ns: int) -> None:
            with contextlib.suppress(RosMessageError):
                stamp_ns = crtk.joints(data).stamp_ns
                with self._lock:
                    fresh, nobody = self._gate.passes(stamp_ns, at_ns), at_ns - self._heard.heartbeat_ns > NOBODY_NS
                    if not fresh or nobody or self.pass_on is None:
                        return
                    self._heard = dataclasses.replace(self._heard, set_point_ns=at_ns)
                self.pass_on(f"{self._console}/{servo}", data)

        return hear

    def hear_rig(self, tapped: Tapped) -> None:
        if f"/{self._arm}/" not in tapped.key:
            return
        at_ns = now_ns()
        with self._lock:
            if tapped.topic is HEARTBEAT:
                self._heard = dataclasses.replace(self._heard, heartbeat_ns=at_ns)
            else:
                self._state = tapped.payload, at_ns

    def heard(self) -> Heard:
        with self._lock:
            heard, (state, at_ns) = self._heard, self._state
        if at_ns > heard.set_point_ns and now_ns() - heard.set_point_ns < 10**9:
            with contextlib.suppress(MessageError):
                if decode(RobotState, state).mode is RobotMode.IDLE:
                    return dataclasses.replace(heard, over_ns=at_ns)
        return heard
