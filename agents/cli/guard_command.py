"""The guard as a process on the robot's computer."""

import contextlib
import dataclasses
import threading

from agents.cli.live_options import Guard
from agents.cli.process import EXIT_OK, on_stop
from agents.cli.rig import RigConfig
from agents.cli.rig_hosts import run_name
from agents.cli.rig_sections import DvrkSection
from agents.cli.status_session import reading_session
from agents.cli.terminal import say
from agents.guard.watch import Action, Heard, Watch
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import RobotMode, RobotState
from schemas.topics import HEARTBEAT, ROBOT_STATE
from shared.clock import now_ns
from shared.ros import crtk
from shared.ros import link as ros
from shared.ros.naming import Naming, RmwZenoh, Ros2dds
from shared.ros.types import EMPTY, JOINT_STATE, STRING_STAMPED
from shared.runtime.config import ConfigError
from shared.runtime.connection import NoRouterError, connected
from shared.runtime.session import SessionSettings
from shared.runtime.taps import Tapped

TURNS_HZ = 100.0
SERVOS = ("servo_jp", "jaw/servo_jp")


def naming_of(section: DvrkSection) -> Naming:
    """How the console's computer carries ROS."""
    return Ros2dds() if section.codec == "ros2dds" else RmwZenoh(section.domain, section.type_hashes)


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
    ears = _Ears(options.arm)
    reached = SessionSettings(rig.rig, section.endpoint, rig.identity_of(run_name("robot_bridge", options.arm)))
    heard = tuple(ros.Heard(f"{section.arm}/{servo}", JOINT_STATE, ears.hear_set_point) for servo in SERVOS)
    said = (
        ros.Said(f"{section.arm}/{Action.HOLD.value}", EMPTY),
        ros.Said(f"{section.arm}/state_command", STRING_STAMPED),
    )
    listening = threading.Thread(target=_listen, args=(rig, ears, stopped), name="listen", daemon=True)
    with contextlib.closing(ros.RosLink(reached, naming_of(section), heard, said)) as link:
        link.open()
        listening.start()
        say(f"guards {section.arm} at {section.endpoint}; stop with Ctrl-C")
        _watch(section.arm, ears, link, stopped)
    listening.join()
    return EXIT_OK


def _watch(arm: str, ears: "_Ears", link: ros.RosLink, stopped: threading.Event) -> None:
    watch = Watch()
    while not stopped.wait(1 / TURNS_HZ):
        following = watch.turn(ears.heard(), now_ns())
        if following is None:
            continue
        action, why = following
        if action is Action.HOLD:
            link.say(f"{arm}/hold", crtk.empty())
        else:
            link.say(f"{arm}/state_command", crtk.state_command(action.value, now_ns()))
        say(f"{arm}: {action.value}, for {why}")


def _listen(rig: RigConfig, ears: "_Ears", stopped: threading.Event) -> None:
    """Hear the rig for as long as it is there; without it nobody stands by."""
    with contextlib.suppress(NoRouterError), connected(reading_session(rig), None, stopped) as connection:
        connection.listen((HEARTBEAT, ROBOT_STATE), ears.hear_rig)
        stopped.wait()


class _Ears:
    """When what was heard last; filled from other threads."""

    def __init__(self, arm: str) -> None:
        self._arm, self._heard, self._state = arm, Heard(), b""
        self._lock = threading.Lock()

    def hear_set_point(self, _data: bytes, at_ns: int) -> None:
        with self._lock:
            self._heard = dataclasses.replace(self._heard, set_point_ns=at_ns)

    def hear_rig(self, tapped: Tapped) -> None:
        if f"/{self._arm}/" not in tapped.key:
            return
        at_ns = now_ns()
        with self._lock:
            if tapped.topic is HEARTBEAT:
                self._heard = dataclasses.replace(self._heard, heartbeat_ns=at_ns)
            else:
                self._heard, self._state = dataclasses.replace(self._heard, state_ns=at_ns), tapped.payload

    def heard(self) -> Heard:
        with self._lock:
            heard, state = self._heard, self._state
        if now_ns() - heard.set_point_ns > 10**9:
            return heard
        with contextlib.suppress(MessageError):
            return dataclasses.replace(heard, moving=decode(RobotState, state).mode is RobotMode.MOVING)
        return heard
