"""What a console that speaks CRTK must do that the robot bridge relies on, and whether this one does.

`CONFORMANCE` is the table: each row is a duty, and the function that judges it by what was heard for some seconds.
Nothing is ever said to the console. What only a motion shows is judged while the arm moves, whoever moves it.
"""

import threading
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from agents.configuration.hosts import run_name
from agents.configuration.reading_session import reading_session
from agents.configuration.rig import RigConfig
from agents.configuration.sections import DvrkSection
from agents.diagnostics.doctor.finding import UNKNOWN, Finding
from agents.diagnostics.doctor.time_offset import WHAT, finding, watching
from agents.launch.guard_process import naming_of
from agents.robot_bridge.dvrk.psm import MOTIONS, SERVOS
from agents.robot_bridge.dvrk.readings import (
    CLOCK_SET_NS,
    ERROR_NS,
    KINDS,
    LEADS_TO,
    POSE_AGE_NS,
    SAME_M,
    SAME_RAD,
    SAME_TIME_NS,
    STANDS,
    TELEOPERATION,
)
from agents.robot_bridge.dvrk.set_points import SAME, WINDOW_NS
from agents.robot_bridge.measuring import MEASUREMENT_AGE_S
from shared.clock import now_ns
from shared.kinematics.arm import ArmKinematics
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.rigid_transforms import angle_between, inverse
from shared.ros import crtk
from shared.ros.link import Heard, RosLink
from shared.ros.naming import GUARD_NODE
from shared.ros.types import BOOL, JOINT_STATE, OPERATING_STATE, POSE_STAMPED, STRING, RosMessageError
from shared.runtime.connection import NoRouterError, connected
from shared.runtime.identity import IdentityError
from shared.runtime.session import SessionSettings
from shared.terminal import UsageError

ROUTER_WAIT_S = 1.0
STANDS_OVER = 1e-2
"""Beyond its limits (rad, m) an arm may stand by as much, as one that was pushed does."""
STATES = {"DISABLED", "FAULT", *LEADS_TO.values()}
POSE, BASE_POSE, ENDOSCOPE = "measured_cp", "local/measured_cp", "ECM/local/measured_cp"
SET_POINTS = {"setpoint_js": "servo_jp", "jaw/setpoint_js": "jaw/servo_jp"}
SAID: dict[str, tuple[str, Callable[[bytes], Any]]] = {
    **dict.fromkeys(("measured_js", "jaw/measured_js", *SET_POINTS, *SERVOS), (JOINT_STATE, crtk.joints)),
    **dict.fromkeys((BASE_POSE, POSE), (POSE_STAMPED, crtk.pose)),
    "operating_state": (OPERATING_STATE, crtk.operating_state),
    "tool_type": (STRING, crtk.text),
    "error": (STRING, crtk.text),
    TELEOPERATION: (BOOL, crtk.flag),
    ENDOSCOPE: (POSE_STAMPED, crtk.pose),
}
"""What is listened to: below the arm's name, or where that is not the arm's, by its whole name."""
LATCHED = ("operating_state", "tool_type", "error", TELEOPERATION)
NODE = "suturegrasp_doctor"
OF_CONSOLE = (TELEOPERATION, ENDOSCOPE)
FIT = "arm, tool and endpoint in the rig's file must be this console's"


@dataclass(frozen=True)
class Came:
    """A message as read, and when it came; a text instead of a value says why it cannot be read."""

    arrived_ns: int
    value: Any


@dataclass
class Told:
    """What a console said for a while.

    Fields:
        came: by topic, in the order of arrival.
        owners: who announced that they publish motions of this arm, the guard left out.
        ended_ns: when listening ended; 0 for with the last message.
        broken: how often the link to it was lost meanwhile.
    """

    section: DvrkSection
    kinematics: ArmKinematics = LARGE_NEEDLE_DRIVER
    came: dict[str, list[Came]] = field(default_factory=lambda: defaultdict(list))
    owners: set[str] = field(default_factory=set)
    ended_ns: int = 0
    broken: int = 0

    def hear(self, topic: str, data: bytes, arrived_ns: int) -> None:
        """Take a message."""
        try:
            value = SAID[topic][1](data)
        except RosMessageError as error:
            value = str(error)
        self.came[topic].append(Came(arrived_ns, value))

    def values(self, topic: str) -> list[Any]:
        """What was read of a topic."""
        return [one.value for one in self.came[topic] if not _unread(topic, one)]

    def unread(self, topic: str) -> str:
        """Why something of a topic cannot be read; empty where all was."""
        return next((one.value for one in self.came[topic] if _unread(topic, one)), "")

    def joints(self, topic: str) -> list[Came]:
        """Messages with as many finite positions as the topic is to have."""
        return [one for one in self.came[topic] if not _unread(topic, one) and _whole(topic, one.value.position)]

    def odd(self, topic: str) -> str:
        """What is wrong with messages of joints; empty where all are whole."""
        if why := self.unread(topic):
            return f"{topic} cannot be read: {why}"
        return (
            ""
            if len(self.joints(topic)) == len(self.came[topic])
            else f"{topic} has not {_count(topic)} finite positions"
        )

    @property
    def span_ns(self) -> tuple[int, int]:
        """From the first message of any topic until listening ended."""
        arrived = [one.arrived_ns for came in self.came.values() for one in came]
        return min(arrived, default=0), self.ended_ns or max(arrived, default=0)

    @property
    def moved(self) -> bool:
        """Whether the arm has moved meanwhile."""
        joints = np.array([one.value.position for one in self.joints("measured_js")])
        return bool(len(joints)) and bool((np.ptp(joints, axis=0) > STANDS).any())


def _count(topic: str) -> int:
    return 1 if topic.startswith("jaw/") else 6


def _whole(topic: str, position: np.ndarray) -> bool:
    return position.shape == (_count(topic),) and bool(np.isfinite(position).all())


def _unread(topic: str, one: Came) -> bool:
    return isinstance(one.value, str) and SAID[topic][0] != STRING


Judge = Callable[[Told], tuple[str, str]]
"""What was found of a duty by what was heard, and the remedy, empty where the console does it."""


def _comes(kind: str, within_s: float) -> Judge:
    def judge(told: Told) -> tuple[str, str]:
        arrived = [one.arrived_ns for one in told.came[kind]]
        if why := told.unread(kind):
            return f"cannot be read: {why}", "have it publish the type that docs/dvrk.md names"
        if len(arrived) < 2 or arrived[-1] == arrived[0]:
            return "does not come", f"let {told.section.arm}/{kind} through where ROS meets Zenoh (docs/dvrk.md)"
        begun_ns, ended_ns = told.span_ns
        longest_s = max(np.diff((begun_ns, *arrived, ended_ns))) * 1e-9
        rate_hz = (len(arrived) - 1) / ((arrived[-1] - arrived[0]) * 1e-9)
        found = f"{rate_hz:.0f} a second, the longest silence {1e3 * longest_s:.0f} ms"
        late = f"more than {1e3 * within_s:.0f} ms ends motions (stale_state): see to network and console"
        return found, late if longest_s > within_s else ""

    return judge


def _units(told: Told) -> tuple[str, str]:
    if odd := told.odd("measured_js") or told.odd("jaw/measured_js"):
        return odd, "a PSM has six joints, and a jaw in jaw/measured_js"
    joints, jaws = told.joints("measured_js"), told.joints("jaw/measured_js")
    if not joints or not jaws:
        return f"{UNKNOWN}: no joints came", ""
    lower, upper = told.kinematics.limits.T
    found = joints[-1].value.position
    if not ((found >= lower - STANDS_OVER) & (found <= upper + STANDS_OVER)).all():
        return f"joints at {np.round(found, 3).tolist()}, beyond a PSM's limits", "radians and metres are expected"
    jaw_deg = np.degrees(jaws[-1].value.position[0])
    return f"radians and metres, insertion {1e3 * found[2]:.0f} mm, jaw {jaw_deg:.0f} degrees", ""


def _one_clock(told: Told) -> tuple[str, str]:
    if any(len(told.values(kind)) < 2 for kind in KINDS):
        return f"{UNKNOWN}: not all of {', '.join(KINDS)} came", ""
    stamps = [np.array([one.stamp_ns for one in told.values(kind)]) for kind in KINDS]
    if any((one == 0).any() for one in stamps):
        return "some have no stamp", "have the console stamp what it measures"
    if any((np.diff(one) < -CLOCK_SET_NS).any() for one in stamps):
        return "stamps go back", "have one clock stamp what the console measures, and set it before it starts"
    apart = [_apart(told, kind) for kind in KINDS[1:]]
    if not all(len(one) for one in apart):
        return f"{UNKNOWN}: joints, jaw and pose do not come together", ""
    apart_ms = 1e-6 * max(float(np.median(one)) for one in apart)
    found = f"joints, jaw and pose are stamped within {apart_ms:.1f} ms of each other"
    wrong = f"above {1e-6 * SAME_TIME_NS:.0f} ms an arm that moves is stale_state: have it publish them together"
    return found, wrong if apart_ms > 1e-6 * SAME_TIME_NS else ""


def _apart(told: Told, kind: str) -> np.ndarray:
    """How far the stamps of joints are from the nearest of those that came with them, ns."""
    joints, others = (
        np.array([(c.arrived_ns, c.value.stamp_ns) for c in told.came[topic] if not _unread(topic, c)])
        for topic in (KINDS[0], kind)
    )
    first, last = (np.searchsorted(others[:, 0], joints[:, 0] + by) for by in (-SAME_TIME_NS, SAME_TIME_NS))
    return np.array(
        [np.abs(others[a:b, 1] - at).min() for a, b, at in zip(first, last, joints[:, 1], strict=True) if b > a]
    )


def _on_time(told: Told) -> tuple[str, str]:
    late = [
        one.arrived_ns - one.value.stamp_ns
        for one in told.came["measured_js"]
        if not _unread("measured_js", one) and one.value.stamp_ns
    ]
    if not late:
        return f"{UNKNOWN}: no stamped joints came", ""
    held_ms = 1e-6 * (max(late) - min(late))
    clocks = f"the clocks are {1e-9 * min(late):.3f} s apart"
    found = f"joints come at most {held_ms:.0f} ms later than the quickest ({clocks})"
    return found, "a network or console that holds them back ends motions" if held_ms > 1e3 * MEASUREMENT_AGE_S else ""


def _frame(told: Told) -> tuple[str, str]:
    """Which pose is that of our kinematics, told in the base's frame: found out, whatever its topic is called."""
    base, other_fits = _off(told, BASE_POSE), _fits(_off(told, POSE))
    if base is None:
        other = f"; {POSE} is the one in the base's frame" if other_fits else ""
        return f"{UNKNOWN}: {BASE_POSE} did not come with joints of its time{other}", ""
    found = f"{1e3 * base[0]:.1f} mm and {base[1]:.2f} rad from our kinematics"
    if _fits(base):
        return f"{BASE_POSE} is in the base's frame, {found}", ""
    if other_fits:
        return (
            f"{BASE_POSE} is {found}, and {POSE} fits",
            "its two poses are exchanged: the base's must be the local one",
        )
    return f"{BASE_POSE} is {found}", FIT


def _fits(off: tuple[float, float] | None) -> bool:
    return off is not None and off[0] <= SAME_M and off[1] <= SAME_RAD


def _off(told: Told, topic: str) -> tuple[float, float] | None:
    """How far a pose is from that of the joints of its time, at worst; None where none came with joints."""
    pairs = list(_with_joints(told, topic))
    if not pairs:
        return None
    ours = told.kinematics.forward(np.array([joints for joints, _ in pairs]))
    theirs = np.array([T for _, T in pairs])
    turned = [float(angle_between(a[:3, :3], b[:3, :3])) for a, b in zip(ours, theirs, strict=True)]
    return float(np.linalg.norm(ours[:, :3, 3] - theirs[:, :3, 3], axis=1).max()), max(turned)


def _with_joints(told: Told, topic: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Poses with the joints of their time."""
    joints = sorted(told.joints("measured_js"), key=lambda one: one.value.stamp_ns)
    stamps = np.array([one.value.stamp_ns for one in joints])
    for pose in told.values(topic):
        if not len(stamps) or not pose.stamp_ns:
            continue
        nearest = int(np.abs(stamps - pose.stamp_ns).argmin())
        if abs(stamps[nearest] - pose.stamp_ns) <= SAME_TIME_NS:
            yield joints[nearest].value.position, pose.T


def _camera_frame(told: Told) -> tuple[str, str]:
    """What `measured_cp` is told from: the base, or something that the base has stood before ever since."""
    base = {one.stamp_ns: one.T for one in told.values(BASE_POSE)}
    both = [(one, base[one.stamp_ns]) for one in told.values(POSE) if one.stamp_ns in base]
    if not both:
        return f"{UNKNOWN}: {POSE} does not come with {BASE_POSE}, so set-up joints that move are not seen", ""
    between = [one.T @ inverse(T) for one, T in both]
    moved_m = max(float(np.linalg.norm(one[:3, 3] - between[0][:3, 3])) for one in between)
    away_m, turned = float(np.linalg.norm(between[-1][:3, 3])), float(angle_between(between[-1][:3, :3], np.eye(3)))
    if away_m < 1e-4 and turned < 1e-3:
        return f"{POSE} is in the base's frame, as {BASE_POSE} is: set-up joints that move are not seen", ""
    found = f"{POSE} is in frame {both[-1][0].frame!r}, {1e3 * away_m:.0f} mm and {np.degrees(turned):.0f} degrees away"
    return f"{found}, {'which has moved meanwhile' if moved_m > 1e-3 else 'which stands'}", ""


def _state(told: Told) -> tuple[str, str]:
    states = told.values("operating_state")
    if why := told.unread("operating_state"):
        return f"cannot be read: {why}", "crtk_msgs/OperatingState is expected"
    if not states:
        return "was not told to who came late", "it must be latched, or come again and again"
    newest = states[-1]
    if newest.state not in STATES:
        return f"its state is {newest.state!r}", f"one of {', '.join(sorted(STATES))} is expected"
    homed = "homed" if newest.is_homed else "not homed"
    return f"{newest.state}, {homed}{', busy' if newest.is_busy else ''}", ""


def _busy(told: Told) -> tuple[str, str]:
    """Whether it says that it is busy while it is sent set points, which no phase of ours would outlast."""
    sent = [one.arrived_ns for one in told.came["servo_jp"]]
    if not sent:
        return f"{UNKNOWN}: no set points came; look again while a plan is carried out", ""
    states = [one for one in told.came["operating_state"] if not _unread("operating_state", one)]
    before = [one for one in states if one.arrived_ns < sent[0]][-1:]
    meanwhile = [*before, *(one for one in states if sent[0] <= one.arrived_ns <= sent[-1])]
    if not meanwhile:
        return f"{UNKNOWN}: its state was not told by then", ""
    if any(one.value.is_busy for one in meanwhile):
        return "busy while set points come", "no phase would end (not_following): see the console's version"
    return "not busy while set points come", ""


def _set_points(told: Told) -> tuple[str, str]:
    """Whether it heads for what it is sent, and otherwise stays."""
    for kind, servo in SET_POINTS.items():
        if odd := told.odd(kind) or told.odd(servo):
            return odd, "set points are positions of six joints, and of a jaw"
        if not told.came[kind]:
            return f"{UNKNOWN}: {kind} is not told, so what it clips is not seen", ""
    if not any(told.came[servo] for servo in SET_POINTS.values()):
        heads = {kind: np.array([one.value.position for one in told.joints(kind)]) for kind in SET_POINTS}
        elsewhere = any((np.ptp(values, axis=0) > SAME[kind]).any() for kind, values in heads.items())
        though = ", though it heads elsewhere" if elsewhere else ""
        return f"{UNKNOWN}: no set points came{though}; look again in a motion", ""
    off = {kind: _off_sent(told.joints(kind), told.joints(servo), SAME[kind]) for kind, servo in SET_POINTS.items()}
    if not all(len(one) for one in off.values()):
        return f"{UNKNOWN}: too few set points came to tell; look again in a longer motion", ""
    kind = max(off, key=lambda kind: off[kind].max())
    if off[kind].max() > 1:
        found = f"{kind} is {off[kind].max():.1f} times as far from what was sent as is allowed"
        return found, "it clips or filters set points (other_set_point)"
    return f"it heads for what was sent within the last {1e-6 * WINDOW_NS:.0f} ms", ""


def _off_sent(heads: list[Came], sent: list[Came], same: np.ndarray) -> np.ndarray:
    """How far each is from the nearest of what was sent lately, in what is allowed, while something is sent."""
    if not sent:
        return np.zeros(0)
    at_ns, values = np.array([one.arrived_ns for one in sent]), np.array([one.value.position for one in sent])
    off = list[float]()
    for one in heads:
        first, last = np.searchsorted(at_ns, (one.arrived_ns - WINDOW_NS, one.arrived_ns + 1))
        if at_ns[0] + WINDOW_NS < one.arrived_ns <= at_ns[-1] and last > first:
            off.append(float((np.abs(values[first:last] - one.value.position) / same).max(axis=1).min()))
    return np.array(off)


def _tool(told: Told) -> tuple[str, str]:
    tools, wanted = told.values("tool_type"), told.section.tool
    if not tools:
        return "was not told to who came late", "it must be latched; a bridge with a tool in its file waits for it"
    if not wanted:
        return f"{tools[-1]}; the rig's file names none, so it is not compared", ""
    differs = tools[-1] != wanted
    return tools[-1], f"the rig's file says {wanted}, whose kinematics are used (wrong_tool)" if differs else ""


def _teleoperation(told: Told) -> tuple[str, str]:
    said = told.values(TELEOPERATION)
    if not said:
        if "teleoperation" in told.section.has_no:
            return "not told, and has_no says that there is none", ""
        once = "switch it on and off while this listens, and once the rig runs; or say has_no = ['teleoperation']"
        return "was not told to who came late", once
    return ("on", "switch it off: have one owner only") if said[-1] else ("off", "")


def _endoscope(told: Told) -> tuple[str, str]:
    if told.values(ENDOSCOPE):
        return "its place comes", ""
    if "endoscope_arm" in told.section.has_no:
        return "not told, and has_no says that there is none", ""
    return f"{ENDOSCOPE} does not come", "let it through, or say has_no = ['endoscope_arm']"


def _owners(told: Told) -> tuple[str, str]:
    if told.owners:
        return f"{min(told.owners)} could command it", "have one owner only"
    return "nobody but the guard has announced motions", ""


def _errors(told: Told) -> tuple[str, str]:
    """What it says meanwhile; what it had said before is latched, and may be over."""
    begun_ns, _ = told.span_ns
    new = [one.value for one in told.came["error"] if one.arrived_ns - begun_ns > ERROR_NS]
    if new:
        return f"it says: {new[-1]}", "see the console"
    before = told.values("error")
    return (f"none now; it had said: {before[-1]}" if before else "none"), ""


CONFORMANCE: dict[str, Judge] = {
    "joints come": _comes("measured_js", MEASUREMENT_AGE_S),
    "the jaw comes": _comes("jaw/measured_js", MEASUREMENT_AGE_S),
    "the base's pose comes": _comes(BASE_POSE, 1e-9 * POSE_AGE_NS),
    "units": _units,
    "one clock": _one_clock,
    "nothing is held back": _on_time,
    "frame of the pose": _frame,
    "frame of the other pose": _camera_frame,
    "operating state": _state,
    "busy": _busy,
    "set points": _set_points,
    "tool": _tool,
    "teleoperation": _teleoperation,
    "endoscope": _endoscope,
    "other owners": _owners,
    "errors": _errors,
}


def judged(told: Told) -> Iterator[Finding]:
    """Each row of the table, of what was heard; one alone where nothing was."""
    arm = told.section.arm
    if not any(told.came.values()):
        where = f"nothing was heard of {arm} at {told.section.endpoint}"
        yield Finding(
            arm, where, "see that its console and its Zenoh run there, and that what docs/dvrk.md allows crosses"
        )
        return
    broken = f"the link to it broke {told.broken} times meanwhile" if told.broken else ""
    how = "moves" if told.moved else "stands, so what only a motion shows is not judged"
    yield Finding(arm, broken or how, "see to the network, or to Zenoh beside the console" if broken else "")
    for duty, judge in CONFORMANCE.items():
        yield Finding(f"{arm}: {duty}", *judge(told))


def listening(told: Told) -> tuple[Heard, ...]:
    """What is heard of a console, for a link."""

    def heard(topic: str) -> Heard:
        name = topic if topic in OF_CONSOLE else f"{told.section.arm}/{topic}"
        take = partial(told.hear, topic)
        return Heard(name, SAID[topic][0], take, latched=topic in LATCHED)

    return tuple(heard(topic) for topic in SAID)


def examine_console(rig: RigConfig, arm: str, watch_s: float) -> Iterator[Finding]:
    """Listen to an arm's console for so long, and judge it.

    Raises:
        UsageError: where the rig has no such arm of a dVRK.
    """
    section = rig.robot[arm].dvrk if arm in rig.robot else None
    if section is None:
        have = ", ".join(name for name, one in rig.robot.items() if one.dvrk is not None) or "none"
        raise UsageError(f"the rig's file has no dVRK arm {arm!r}; it has {have}")
    told = Told(section)

    def owner(token: str, comes: bool) -> None:
        if f"/{GUARD_NODE}/" not in token:
            (told.owners.add if comes else told.owners.discard)(token)

    try:
        reached = SessionSettings(rig.rig, section.endpoint, rig.identity_of(run_name("robot_bridge", arm)))
        watched = tuple(f"{section.arm}/{topic}" for topic in MOTIONS)
        link = RosLink(reached, naming_of(section, NODE), listening(told), watched=watched, owner_changed=owner)
    except IdentityError as error:
        yield Finding(section.arm, f"its Zenoh at {section.endpoint} is not reached", str(error))
        return
    with closing(link):
        link.open()
        beside = _camera_beside(rig, arm, watch_s)
        told.ended_ns, told.broken, failed = now_ns(), link.broken, link.failed
    if failed:
        yield Finding(section.arm, f"its Zenoh at {section.endpoint} is not reached", failed)
        return
    yield from judged(told)
    yield beside


def _camera_beside(rig: RigConfig, arm: str, watch_s: float) -> Finding:
    """Let the time pass, and watch the rig's camera meanwhile where the rig runs."""
    waited = threading.Event()
    try:
        with connected(reading_session(rig), ROUTER_WAIT_S) as connection:
            with watching(connection, arm) as watch:
                waited.wait(watch_s)
            return finding(watch, rig.camera.latency_ms if rig.camera else 0.0)
    except (NoRouterError, IdentityError):
        waited.wait(watch_s)
        return Finding(WHAT, f"{UNKNOWN}: the rig's router does not answer; start the rig, and move the arm meanwhile")
