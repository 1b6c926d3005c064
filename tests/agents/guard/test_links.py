"""The monitor's links from end to end, with nothing made up but Zenoh's session."""

import base64
import json
import struct
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from agents.guard import cdr
from agents.guard.description import Axis, Description
from agents.guard.links import Links
from agents.guard.monitor import Monitor
from schemas.wire import descriptors_of, wire_type_named
from shared.ros.guarded import Alive, Gate, SetPoint, alive_bytes, challenge_from, key_of, set_point_bytes

MS = 1_000_000
ROBOT = Description("psm1", (Axis(-1.5, 1.5, 1.0), Axis(0.0, 0.24, 0.2), Axis(-0.7, 1.4, 3.0)), 200.0, pedal=True)
HERE = (0.1, 0.1, 0.2)
OURS = {topic: key_of("PSM1", topic) for topic in ("set_point", "alive", "challenge")}
SAYS = {name: f"PSM1/{name}" for name in ("servo_jp", "jaw/servo_jp", "hold", "state_command")}
HEARS = {name: f"PSM1/{name}" for name in ("servo_jp", "jaw/servo_jp", "measured_js", "jaw/measured_js", "hold")}
MEASURED = ("PSM1/measured_js", "PSM1/jaw/measured_js")
PEDAL, BEAT, BEAT_TYPE = "footpedals/operator_present", "lab/heartbeat/psm1", "application/protobuf;lab/heartbeat/psm1"
DOCUMENT: dict[str, Any] = {
    "robot": {
        "settings": {"mode": "client", "connect/endpoints": ["tcp/127.0.0.1:1"]},
        "attachments": False,
        "tokens": ["@/{session}/of/{session}"],
        "says": SAYS | {"challenge": OURS["challenge"]},
        "hears": HEARS | {"pedal": PEDAL} | {name: OURS[name] for name in ("set_point", "alive")},
    },
    "rig": {
        "settings": {"mode": "client"},
        "heartbeat": BEAT,
        "encoding": BEAT_TYPE,
        "message": "suturegrasp.v1.Heartbeat",
        "descriptors": base64.b64encode(descriptors_of("Heartbeat").SerializeToString()).decode(),
    },
}
Heartbeat = wire_type_named("Heartbeat")


class Session:
    """What Zenoh does, as far as the links use it.

    Fields:
        put: what was published: key, payload, attachment.
    """

    def __init__(self, config):
        self.config, self.put, self.subscribers, self.tokens = config, [], {}, []
        self.changed, self.broken = [], set()
        self.info = SimpleNamespace(declare_transport_events_listener=self.changed.append)
        self.zid = lambda: "c0ffee"
        self.liveliness = lambda: SimpleNamespace(declare_token=self.tokens.append)

    def declare_publisher(self, key, **_quality):
        def put(payload, attachment=None):
            if key in self.broken:
                raise zenoh.ZError("closed")
            self.put.append((key, payload, attachment))

        return SimpleNamespace(key_expr=key, put=put)

    def declare_subscriber(self, key, handler, **_how):
        newest = []
        self.subscribers[key] = handler, newest
        return SimpleNamespace(try_recv=lambda: newest.pop() if newest else None)


def sample(key, data, encoding="zenoh/bytes") -> Any:
    return SimpleNamespace(key_expr=key, payload=SimpleNamespace(to_bytes=lambda: data), encoding=encoding)


class Robot:
    """Links to a robot and a rig that are there at once, in virtual time."""

    def __init__(self, monkeypatch, **robot):
        self.now_ns, self.told, self.sequence, self.sessions = 10**12, [], 0, []
        monkeypatch.setattr("agents.guard.links.monotonic_ns", lambda: self.now_ns)
        monkeypatch.setattr("agents.guard.links.now_ns", lambda: 2 * self.now_ns)
        monkeypatch.setattr("zenoh.open", self._open)
        self.monitor = Monitor(ROBOT)
        document = DOCUMENT | {"robot": DOCUMENT["robot"] | robot}
        self.links = Links(self.monitor, document, lambda what, why: self.told.append((what, why)))
        self.links.open_robot()
        self.links.open_rig()
        self.robot, self.rig = self.sessions

    def _open(self, config):
        self.sessions.append(Session(config))
        return self.sessions[-1]

    def hear(self, key, data=b"", under=None):
        """A message comes from the robot's Zenoh."""
        self.robot.subscribers[under or key][0](sample(key, data))

    def beat(self, arming="a", key=BEAT, encoding=BEAT_TYPE, beside=b"", **fields):
        """A heartbeat comes."""
        of = {"arm": "psm1", "arming_id": arming, "guard_challenge": self.asked.challenge, "pressed": True} | fields
        self.rig.subscribers[BEAT][0](sample(key, Heartbeat(**of).SerializeToString() + beside, encoding))

    def measured(self, place=HERE):
        """The console says where the arm is."""
        for key, part in zip(MEASURED, (place[:-1], place[-1:]), strict=True):
            self.robot.subscribers[key][1][:] = [sample("", cdr.joint_state(part, 5))]

    def said(self, name):
        """What was published on a key."""
        return [payload for key, payload, _ in self.robot.put if key == f"PSM1/{name}"]

    @property
    def asked(self):
        """The newest challenge."""
        told = [payload for key, payload, _ in self.robot.put if key == OURS["challenge"]]
        return challenge_from(OURS["challenge"], told[-1])

    def turns(self, count=1):
        for _ in range(count):
            self.now_ns += 10 * MS
            self.measured()
            self.links.turn()
            self.links.challenge()
        return self

    def move(self, arming="a", positions=HERE):
        """A set point comes."""
        self.sequence += 1
        said = SetPoint(self.sequence, self.asked.challenge, arming, positions)
        self.hear(OURS["set_point"], set_point_bytes(OURS["set_point"], said))

    def moves(self, arming="a"):
        """Somebody stands by a set point."""
        self.turns()
        self.beat(arming)
        self.move(arming)
        return self


@pytest.fixture
def robot(monkeypatch):
    """Links that have settled."""
    return Robot(monkeypatch).turns(40)


@pytest.fixture
def moving(robot):
    """Links of a motion."""
    assert robot.moves().monitor.gate is Gate.OPEN
    return robot


def test_a_set_point_is_passed_on_to_joints_and_jaw_and_one_that_is_none_has_the_arm_held(moving):
    assert moving.said("servo_jp") == [cdr.joint_state(HERE[:-1], 2 * moving.now_ns)]
    assert moving.said("jaw/servo_jp") == [cdr.joint_state(HERE[-1:], 2 * moving.now_ns)]
    assert (moving.told, moving.links.refused) == ([], 0)
    moving.move(positions=(9.0, 0.1, 0.2))
    assert moving.said("hold") == [cdr.EMPTY]
    assert moving.told == [("hold", "a set point has axis 1 at 9, outside -1.5 to 1.5")]
    assert len(moving.said("servo_jp")) == 1


def ended(robot):
    said = Alive(9, robot.asked.challenge, "a", ended=True)
    robot.hear(OURS["alive"], alive_bytes(OURS["alive"], said))


@pytest.mark.parametrize(
    ("hears", "gate", "says"),
    [
        (ended, Gate.SHUT, []),
        (lambda robot: robot.hear("PSM1/hold", cdr.EMPTY), Gate.HELD, []),
        (lambda robot: robot.hear("PSM1/servo_jp", b"of a stranger"), Gate.HELD, ["hold", "pause"]),
        (lambda robot: robot.hear("PSM1/jaw/servo_jp", b"of a stranger"), Gate.HELD, ["hold", "pause"]),
    ],
)
def test_the_end_of_a_motion_somebody_elses_hold_and_a_strangers_set_points_have_their_effect(
    moving, hears, gate, says
):
    hears(moving)
    assert moving.monitor.gate is gate
    moving.now_ns += 101 * MS
    hears(moving)
    assert [what for what, _ in moving.told] == says
    assert moving.said("hold") == [cdr.EMPTY] * ("hold" in says)
    assert moving.said("state_command") == [cdr.string_stamped("pause", 2 * moving.now_ns)] * ("pause" in says)
    assert moving.links.refused == 0


def test_the_pedal_is_heard(robot):
    for button, told in ((1, False), (0, False), (1, True)):
        # a std_msgs/Header of no frame, no axes, one button
        robot.hear(PEDAL, cdr.LITTLE_ENDIAN + struct.pack("<iII4xIIi", 0, 0, 1, 0, 1, button))
        assert robot.turns().asked.pedal == told


def test_what_is_said_to_rmw_zenoh_has_a_number_a_time_and_its_publishers_id_beside_it(moving, monkeypatch):
    assert {beside for *_, beside in moving.robot.put} == {None}
    robot = Robot(monkeypatch, attachments=True).turns(40).moves()
    beside = {key: found for key, _, found in robot.robot.put}
    assert beside[OURS["challenge"]] is None, "it is of no ROS topic"
    joints, jaw = (struct.unpack("<qqB16s", beside[SAYS[name]]) for name in ("servo_jp", "jaw/servo_jp"))
    assert (joints[:3], jaw[:3]) == ((1, 2 * robot.now_ns, 16), (2, 2 * robot.now_ns, 16))
    assert joints[3] == jaw[3] != moving.links._gid


def test_the_robots_zenoh_is_opened_with_its_settings_and_tokens(robot):
    assert json.loads(robot.robot.config.get_json("connect/endpoints")) == ["tcp/127.0.0.1:1"]
    assert robot.robot.tokens == ["@/c0ffee/of/c0ffee"]


@pytest.mark.parametrize("topic", ["set_point", "alive"])
@pytest.mark.parametrize("named", ["sent", "said"])
def test_a_message_of_the_bridge_that_names_another_key_is_none(robot, topic, named):
    robot.moves()
    own, other = OURS[topic], key_of("PSM2", topic)
    sent, said = (other, own) if named == "sent" else (own, other)
    point, ended = SetPoint(7, robot.asked.challenge, "a", HERE), Alive(7, robot.asked.challenge, "a", ended=True)
    data = set_point_bytes(said, point) if topic == "set_point" else alive_bytes(said, ended)
    robot.hear(sent, data, under=own)
    robot.hear(own)
    robot.hear(PEDAL, b"garbage")
    robot.robot.subscribers[MEASURED[0]][1][:] = [sample("", b"garbage")]
    robot.links.turn()
    assert robot.links.refused == 4
    assert (len(robot.said("servo_jp")), robot.monitor.gate, robot.told) == (1, Gate.OPEN, [])


@pytest.mark.parametrize(
    ("refused", "wrong"),
    [
        (1, {"key": "lab/heartbeat/psm2"}),
        (1, {"encoding": "application/protobuf;lab/heartbeat/psm2"}),
        (1, {"beside": b"\xff\xff"}),
        # a field that no heartbeat has yet
        (1, {"beside": b"\xfa\x07\x01x"}),
        (0, {"arm": "psm2"}),
        (0, {"arming_id": "b"}),
        (0, {"guard_challenge": 5}),
        (0, {"pressed": False}),
    ],
)
def test_a_heartbeat_of_another_key_type_version_arm_arming_or_time_lets_nothing_pass(robot, refused, wrong):
    robot.turns()
    robot.beat(**wrong)
    robot.move()
    assert (robot.said("servo_jp"), robot.links.refused) == ([], refused)


@pytest.mark.parametrize("set_s", [-10, 10])
def test_a_clock_that_is_set_in_mid_motion_neither_blinds_a_guard_nor_ends_the_motion(monkeypatch, set_s):
    robot, ahead_ns = Robot(monkeypatch), [0]
    # the guard's own clocks again, over those of a machine
    monkeypatch.undo()
    machine = SimpleNamespace(monotonic_ns=lambda: robot.now_ns, time_ns=lambda: 2**60 + robot.now_ns + ahead_ns[0])
    monkeypatch.setattr("shared.clock.time", machine)
    robot.turns(40).moves()
    ahead_ns[0] = set_s * 1000 * MS
    assert robot.moves().monitor.gate is Gate.OPEN
    for _ in range(23):
        robot.turns()
        robot.move()
    assert (robot.monitor.gate, robot.told) == (Gate.HELD, [("hold", "nobody stands by any more")])


@pytest.mark.parametrize("stirs", [Robot.beat, Robot.move])
def test_turns_are_quick_for_a_second_after_what_stirs(robot, stirs):
    assert robot.links.turn() is False
    stirs(robot)
    robot.now_ns += 1000 * MS - 1
    assert robot.links.turn() is True
    robot.now_ns += 1
    assert robot.links.turn() is False


def test_a_measurement_counts_as_old_as_the_look_before_it_for_it_may_have_lain_there(robot):
    robot.now_ns += 10 * MS
    robot.links.turn()
    robot.measured()
    robot.now_ns += 90 * MS
    robot.links.turn()
    robot.now_ns += 11 * MS
    robot.links.challenge()
    robot.beat()
    robot.move()
    assert robot.told == [("hold", "the arm's joints or jaw are not measured")], "it was looked at 101 ms ago"


def test_a_set_point_is_judged_by_the_newest_measurement(moving):
    moving.now_ns += 10 * MS
    moving.links.challenge()
    moving.measured((0.9, 0.1, 0.2))
    moving.move()
    assert moving.told == [("hold", "a set point has axis 1 0.8 from where it is measured")]


HEARD = {
    "hear_set_point": Robot.move,
    "hear_alive": lambda robot: robot.hear(OURS["alive"], alive_bytes(OURS["alive"], Alive(7, 1))),
    "hear_heartbeat": Robot.beat,
    "hear_stranger": lambda robot: robot.hear("PSM1/servo_jp"),
    "hear_hold": lambda robot: robot.hear("PSM1/hold"),
    "turn": lambda robot: robot.links.turn(),
    "challenge": lambda robot: robot.links.challenge(),
}


@pytest.mark.parametrize("what", HEARD)
def test_a_failure_holds_the_arm_and_nothing_of_that_motion_passes_any_more(moving, monkeypatch, what):
    def fail(*_of):
        assert moving.links._lock.locked(), "one thing is judged at a time"
        raise RuntimeError("a defect")

    with monkeypatch.context() as patched:
        patched.setattr(moving.monitor, what, fail)
        HEARD[what](moving)
    assert moving.told == [("hold", "the guard failed: RuntimeError: a defect")]
    assert moving.said("hold") == [cdr.EMPTY]
    assert len(moving.moves().said("servo_jp")) == 1
    assert (moving.monitor.gate, moving.links.broke, moving.links.refused) == (Gate.HELD, False, 0)
    assert len(moving.moves("b").said("servo_jp")) == 2, "the next arming does"


@pytest.mark.parametrize("key", ["PSM1/servo_jp", "PSM1/jaw/servo_jp"])
def test_where_a_set_point_cannot_be_said_the_arm_is_held_and_where_hold_cannot_the_link_is_of_no_use(moving, key):
    moving.robot.broken = {key}
    moving.move()
    assert moving.told == [("hold", "the guard failed: ZError: closed")]
    assert not moving.links.broke
    moving.robot.broken |= {"PSM1/hold"}
    moving.moves("b")
    assert (moving.links.broke, moving.monitor.gate, len(moving.told)) == (True, Gate.HELD, 1)


def test_a_link_that_broke_is_broken_though_it_comes_back(robot):
    (changed,) = robot.robot.changed
    for kind, broke in ((zenoh.SampleKind.PUT, False), (zenoh.SampleKind.DELETE, True), (zenoh.SampleKind.PUT, True)):
        changed(SimpleNamespace(kind=kind))
        assert robot.links.broke is broke


def test_at_its_end_the_arm_is_held_where_it_moves_and_nothing_is_judged_after(moving, monkeypatch):
    moving.links.end("the guard was stopped")
    assert moving.told == [("hold", "the guard was stopped")]
    assert moving.said("hold") == [cdr.EMPTY]
    assert moving.links._lock.locked()
    rests = Robot(monkeypatch)
    rests.links.end("the guard was stopped")
    assert (rests.told, rests.said("hold")) == ([], [])
