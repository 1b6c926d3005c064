"""What an emulated dVRK says, topic by topic: nothing that nobody wants to hear, and nothing while it is muted."""

from collections.abc import Callable
from typing import Any

import numpy as np

from agents.dvrk_emulator import poses
from agents.dvrk_emulator.geometry import tool
from agents.dvrk_emulator.messages import JointState, Point, Pose, PoseStamped, Quaternion, header
from agents.dvrk_emulator.wire import Outlet, Wire

JOINTS = ["outer_yaw", "outer_pitch", "outer_insertion", "outer_roll", "outer_wrist_pitch", "outer_wrist_yaw"]
TOOL_TYPE = "LARGE_NEEDLE_DRIVER:400006"
SENSOR, STD, CRTK, GEOMETRY = (f"{name}_msgs::msg::dds_::" for name in ("sensor", "std", "crtk", "geometry"))
CLUTCH, TIP, TELEOPERATION = "footpedals/clutch", "ECM/local/measured_cp", "console/teleop/enabled"
PEDALS = ("footpedals/operator_present", "console/operator_present")
"""Of which consoles have one or the other: somebody's foot, or head, is where the operator's should be."""
OF_ARM = {
    "measured_js": (f"{SENSOR}JointState_", False),
    "setpoint_js": (f"{SENSOR}JointState_", False),
    "jaw/measured_js": (f"{SENSOR}JointState_", False),
    "jaw/setpoint_js": (f"{SENSOR}JointState_", False),
    "local/measured_cp": (f"{GEOMETRY}PoseStamped_", False),
    "measured_cp": (f"{GEOMETRY}PoseStamped_", False),
    "setpoint_cp": (f"{GEOMETRY}PoseStamped_", False),
    "operating_state": (f"{CRTK}OperatingState_", True),
    "error": (f"{STD}String_", True),
    "warning": (f"{STD}String_", True),
    "tool_type": (f"{STD}String_", True),
    "goal_reached": (f"{STD}Bool_", False),
}
"""The type of each topic below the arm's name, and whether who comes later hears the last of it."""


class Outlets:
    """Of one arm.

    Fields:
        muted: nothing is said.
    """

    def __init__(self, wire: Wire, name: str, now_ns: Callable[[], int]) -> None:
        self._name, self._now_ns, self.muted = name, now_ns, False
        self._outlets: dict[str, Outlet] = {
            TIP: wire.publish(TIP, f"{GEOMETRY}PoseStamped_", False),
            **{pedal: wire.publish(pedal, f"{SENSOR}Joy_", False) for pedal in PEDALS},
            CLUTCH: wire.publish(CLUTCH, f"{SENSOR}Joy_", False),
            TELEOPERATION: wire.publish(TELEOPERATION, f"{STD}Bool_", True),
        }
        for topic, (kind, latched) in OF_ARM.items():
            self._outlets[topic] = wire.publish(f"{name}/{topic}", kind, latched)

    def say(self, topic: str, message: Any) -> None:
        """A message, where somebody wants it."""
        outlet = self._outlets[topic]
        if not self.muted and outlet.wanted():
            outlet.put(message.serialize(), self._now_ns())

    def tell_where(
        self, at_ns: int, position: np.ndarray, goal: np.ndarray, jaw_effort: float, moved_m: dict[str, float]
    ) -> None:
        """Where the arm was at a time, and where it heads for; with the `camera` and `setup` moved so far aside."""
        at = header(at_ns)
        none = [0.0] * len(JOINTS)
        for topic, values, names, effort in (
            ("measured_js", position[:6], JOINTS, none),
            ("setpoint_js", goal[:6], JOINTS, none),
            ("jaw/measured_js", position[6:], ["jaw"], [jaw_effort]),
            ("jaw/setpoint_js", goal[6:], ["jaw"], [0.0]),
        ):
            if self._outlets[topic].wanted():
                self.say(topic, JointState(at, names, values.tolist(), none[: len(names)], effort))
        for topic, joints, aside_m in (
            ("local/measured_cp", position, 0.0),
            ("measured_cp", position, moved_m["setup"]),
            ("setpoint_cp", goal, moved_m["setup"]),
        ):
            if self._outlets[topic].wanted():
                self.say(topic, PoseStamped(header(at_ns, f"{self._name}_base"), _pose(joints[:6], aside_m)))
        if self._outlets[TIP].wanted():
            # the endoscope, its tip 100 mm beyond its remote centre, moves to its side
            tip = Pose(Point(moved_m["camera"], 0.0, -0.1), Quaternion(1.0, 0.0, 0.0, 0.0))
            self.say(TIP, PoseStamped(header(at_ns, "ECM_base"), tip))


def _pose(joints: np.ndarray, aside_m: float) -> Pose:
    R, pin = tool(joints)
    return poses.told(R, pin + np.array((aside_m, 0.0, 0.0)))
