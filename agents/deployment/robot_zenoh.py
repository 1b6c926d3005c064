"""What the Zenoh of a robot's computer is told: where it listens, whom it lets in, and what each of them may say.

The robot's Zenoh is zenoh-bridge-ros2dds, or the router of rmw_zenoh. Where it is reached over the network, both sides
show certificates of the lab, and only the bridge and the guard of the arm get in. A bridge that must speak through the
guard may not name the console's own set points at all, so that what a link kept back can go no further than the guard.
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.deployment.places import CERTIFICATES
from shared.ros.guarded import ALIVE, CHALLENGE, SET_POINT, key_of
from shared.runtime.access import HEARING, READING, common_name
from shared.runtime.identity import Identity, identity_in
from shared.runtime.session import on_loopback, router_settings

ROBOT_ZENOH = "robot_zenoh"
FILE = "robot-zenoh.json5"
MEASURED = ("measured_js", "jaw/measured_js", "measured_cp", "local/measured_cp")
SET_POINTS = "(jaw/)?setpoint_js"
HEARD = (*MEASURED, SET_POINTS, "operating_state", "error", "goal_reached", "tool_type")
MOVED = (
    "/ECM/local/measured_cp",
    "/(footpedals|console)/(camera|clutch|operator_present)",
    "/ECM/io/(manip|suj)_clutch",
)
"""What tells beside the arm's own that it stands on something that has moved."""
TELEOPERATION = "/console/teleop/enabled"
BUTTONS = "io/(manip|suj)_clutch"
SERVOS = ("servo_jp", "jaw/servo_jp")
MOTIONS = "(jaw/)?(servo|move)_(jp|jr|jf|cp)"
"""Of which another's are to be seen, with hold, free and state_command: somebody else then owns the arm."""
STOPS = ("hold", "free", "state_command")
BRIDGES = ("hold", "state_command", "trajectory_j/set_ratio")
"""What a bridge says of its own beside set points: stops, a person's change of the arm's state, slow trajectories."""
TOKENS = ("@ros2_lv/**", "@/*/@ros2_lv/**")


@dataclass(frozen=True)
class ReachedArm:
    """An arm as its console and ours call it, and how it is reached.

    Fields:
        arm, console: `psm1` in the rig's file, `PSM1` on the console.
        domain: ROS_DOMAIN_ID.
    """

    arm: str
    console: str
    endpoint: str
    codec: str
    domain: int


def robot_zenoh_file(rig: str, host: str, arms: tuple[ReachedArm, ...]) -> str:
    """The configuration of the robot's Zenoh, for arms that are reached at one endpoint by one codec."""
    first = arms[0]
    identity = None if on_loopback(first.endpoint) else identity_in(Path(CERTIFICATES), common_name(ROBOT_ZENOH, host))
    program = (
        "zenoh-bridge-ros2dds --config" if first.codec == "ros2dds" else "ZENOH_ROUTER_CONFIG_URI= rmw_zenohd with"
    )
    text = json.dumps(robot_zenoh(arms, identity), indent=2)
    return f"// rig {rig}, the Zenoh of the robot's computer {host}: {program} this file\n{text}\n"


def robot_zenoh(arms: tuple[ReachedArm, ...], identity: Identity | None) -> dict[str, Any]:
    """The same as a tree; without a certificate it listens on this computer alone, and lets in whoever is there."""
    first = arms[0]
    access = None if identity is None else _access(arms)
    tree = nested(router_settings(first.endpoint, identity, access))
    if first.codec == "ros2dds":
        tree["plugins"] = {"ros2dds": {"domain": first.domain, "allow": _allowed(arms)}}
    return tree


def nested(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings whose names have `/` between their parts, as a tree."""
    tree: dict[str, Any] = {}
    for name, value in settings.items():
        *path, last = name.split("/")
        branch = tree
        for part in path:
            branch = branch.setdefault(part, {})
        branch[last] = {**branch[last], **value} if isinstance(branch.get(last), dict) else value
    return tree


def _allowed(arms: tuple[ReachedArm, ...]) -> dict[str, list[str]]:
    """Which topics cross between ROS and Zenoh, as regular expressions; all else stays where it is."""
    names = [re.escape(reached.console) for reached in arms]
    return {
        "subscribers": [f"/{name}/{topic}" for name in names for topic in (*SERVOS, *BRIDGES)],
        "publishers": [
            *(f"/{name}/{topic}" for name in names for topic in (*HEARD, MOTIONS, *STOPS, BUTTONS)),
            *MOVED,
            TELEOPERATION,
        ],
    }


def _access(arms: tuple[ReachedArm, ...]) -> dict[str, Any]:
    """Everybody who is let in hears everything; the bridge and the guard of an arm say what is theirs."""
    everything = ["**", "**/@adv/**", *TOKENS]
    told = {name: keys for reached in arms for name, keys in _said(reached).items()}
    rules = [
        _rule("read", "ingress", (*READING, "query"), everything),
        # what recovers the last state announces itself beside the key that it hears
        _rule("announce", "ingress", ("liveliness_token",), ["**/@adv/sub/**", *TOKENS]),
        _rule("hear", "egress", HEARING, everything),
        *(_rule(f"speak as {name}", "ingress", ("put",), keys) for name, keys in told.items()),
    ]
    shared = ["read", "announce", "hear"]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in told],
        "policies": [{"rules": [*shared, f"speak as {name}"], "subjects": [name]} for name in told],
    }


def _said(reached: ReachedArm) -> dict[str, list[str]]:
    """Which keys the bridge and the guard of an arm may put."""
    head, tail = ("", "") if reached.codec == "ros2dds" else (f"{reached.domain}/", "/**")

    def keys(root: str, topics: tuple[str, ...]) -> list[str]:
        return [f"{head}{root}/{topic}{tail}" for topic in topics]

    bridge, guard = common_name("robot_bridge", reached.arm), common_name("guard", reached.arm)
    passed = [key_of(reached.console, topic) for topic in (SET_POINT, ALIVE)]
    guards = keys(reached.console, (*SERVOS, "hold", "state_command"))
    return {
        bridge: [*passed, *keys(reached.console, BRIDGES)],
        guard: [key_of(reached.console, CHALLENGE), *guards],
    }


def _rule(name: str, flow: str, messages: tuple[str, ...], keys: list[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": list(messages), "key_exprs": keys}
