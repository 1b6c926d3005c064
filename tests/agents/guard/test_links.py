"""The monitor's links from end to end, with nothing made up but Zenoh's session."""

import base64
import json
import struct
from functools import partial
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
RESTS_NS = 1000 * MS
ROBOT = Description("psm1", (Axis(-1.5, 1.5, 1.0), Axis(0.0, 0.24, 0.2), Axis(-0.7, 1.4, 3.0)), 200.0, pedal=True)
HERE = (0.1, 0.1, 0.2)
OURS = {topic: key_of("PSM1", topic) for topic in ("set_point", "alive", "challenge")}
SAYS = {name: f"PSM1/{name}" for name in ("servo_jp", "jaw/servo_jp", "hold", "state_command")}
HEARS = {name: f"PSM1/{name}" for name in ("servo_jp", "jaw/servo_jp", "measured_js", "jaw/measured_js", "hold")}
BEAT, BEAT_TYPE = "lab/heartbeat/psm1", "application/protobuf;lab/heartbeat/psm1"
DOCUMENT: dict[str, Any] = {
    "robot": {
        "settings": {"mode": "client", "connect/endpoints": ["tcp/127.0.0.1:1"]},
        "attachments": False,
        "tokens": ["@/{session}/node", "@/{session}/of/{session}"],
        "says": SAYS | {"challenge": OURS["challenge"]},
        "hears": HEARS
        | {"pedal": "footpedals/operator_present"}
        | {name: OURS[name] for name in ("set_point", "alive")},
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
        self.config, self.put, self.subscribers, self.publishers = config, [], {}, {}
        self.tokens, self.changed, self.broken = [], [], set()
        self.info = SimpleNamespace(declare_transport_events_listener=self.changed.append)

    def zid(self):
        return "c0ffee"

    def liveliness(self):
        return SimpleNamespace(declare_token=self.tokens.append)

    def declare_publisher(self, key, **quality):
        def put(payload, attachment=None):
            if key in self.broken:
                raise zenoh.ZError("closed")
            self.put.append((key, payload, attachment))

        self.publishers[key] = quality
        return SimpleNamespace(key_expr=key, put=put)

    def declare_subscriber(self, key, handler, **how):
        newest = []
        self.subscribers[key] = handler, how, newest
        return SimpleNamespace(try_recv=lambda: newest.pop() if newest else None)


def sample(key, data, encoding="zenoh/bytes") -> Any:
    return SimpleNamespace(key_expr=key, payload=SimpleNamespace(to_bytes=lambda: data), encoding=encoding)


class Robot:
    """Links to a robot and a rig that are there at once, in virtual time."""

    def __init__(self, monkeypatch, start_ns=10**12, **robot):
        self.now_ns, self.told, self.sequence, self.sessions = start_ns, [], 0, []
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

    def hear(self, key, data, under=None):
        """A message comes from the robot's Zenoh."""
        handler, _, _ = self.robot.subscribers[under or key]
        handler(sample(key, data))

    def beat(self, arming="a", key=BEAT, encoding=BEAT_TYPE, data=None, **fields):
        """A heartbeat comes."""
        beat = Heartbeat(arm="psm1", arming_id=arming, guard_challenge=self.asked, pressed=True)
        for name, value in fields.items():
            setattr(beat, name, value)
        self.rig.subscribers[BEAT][0](sample(key, beat.SerializeToString() if data is None else data, encoding))

    def measured(self, place=HERE):
        """The console says where the arm is."""
        for name, part in (("measured_js", place[:-1]), ("jaw/measured_js", place[-1:])):
            self.robot.subscribers[f"PSM1/{name}"][2][:] = [sample("", cdr.joint_state(part, 5))]

    def said(self, name):
        """What was published on a key."""
        return [payload for key, payload, _ in self.robot.put if key == f"PSM1/{name}"]

    @property
    def asked(self):
        """The newest challenge."""
        told = [payload for key, payload, _ in self.robot.put if key == OURS["challenge"]]
        return challenge_from(OURS["challenge"], told[-1]).challenge

    def turns(self, count=1):
        for _ in range(count):
            self.now_ns += 10 * MS
            self.measured()
            self.links.turn()
            self.links.challenge()

    def move(self, arming="a", positions=HERE):
        """A set point comes."""
        self.sequence += 1
        said = SetPoint(self.sequence, self.asked, arming, positions)
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
    made = Robot(monkeypatch)
    made.turns(40)
    return made


@pytest.fixture
def moving(robot):
    """Links of a motion."""
    assert robot.moves().monitor.gate is Gate.OPEN
    return robot


def test_links_are_opened_as_the_document_says(monkeypatch):
    kept: list[int] = []
    ring = zenoh.handlers.RingChannel
    monkeypatch.setattr("zenoh.handlers.RingChannel", lambda capacity: kept.append(capacity) or ring(capacity))
    robot = Robot(monkeypatch)
    assert kept == [1, 1], "the newest measurement alone"
    assert json.loads(robot.robot.config.get_json("connect/endpoints")) == ["tcp/127.0.0.1:1"]
    assert [json.loads(session.config.get_json("mode")) for session in robot.sessions] == ["client", "client"]
    assert robot.robot.tokens == ["@/c0ffee/node", "@/c0ffee/of/c0ffee"]
    assert set(robot.robot.publishers) == {*SAYS.values(), OURS["challenge"]}
    at_once = {
        "congestion_control": zenoh.CongestionControl.DROP,
        "priority": zenoh.Priority.REAL_TIME,
        "express": True,
    }
    assert all(quality == at_once for quality in robot.robot.publishers.values())
    assert set(robot.robot.subscribers) == set(DOCUMENT["robot"]["hears"].values())
    assert set(robot.rig.subscribers) == {BEAT}
    for key, (handler, how, _) in robot.robot.subscribers.items():
        measured = key in ("PSM1/measured_js", "PSM1/jaw/measured_js")
        assert isinstance(handler, ring) == measured
        assert how == ({} if measured else {"allowed_origin": zenoh.Locality.REMOTE}), "not what it says itself"


def test_a_set_point_is_passed_on_to_joints_and_jaw(moving):
    assert [cdr.joint_positions(data) for data in moving.said("servo_jp")] == [HERE[:-1]]
    assert [cdr.joint_positions(data) for data in moving.said("jaw/servo_jp")] == [HERE[-1:]]
    assert moving.said("servo_jp") == [cdr.joint_state(HERE[:-1], 2 * moving.now_ns)]
    assert (moving.told, moving.links.refused) == ([], 0)
    moving.move(positions=(9.0, 0.1, 0.2))
    assert moving.said("hold") == [cdr.EMPTY]
    assert moving.told == [("hold", "a set point has axis 1 at 9, outside -1.5 to 1.5")]
    assert len(moving.said("servo_jp")) == 1


@pytest.mark.parametrize("stranger", ["servo_jp", "jaw/servo_jp"])
def test_a_strangers_set_point_holds_the_arm_and_then_pauses_it(moving, stranger):
    moving.hear(f"PSM1/{stranger}", b"anything")
    assert moving.said("hold") == [cdr.EMPTY]
    moving.now_ns += 101 * MS
    moving.hear(f"PSM1/{stranger}", b"anything")
    assert moving.said("state_command") == [cdr.string_stamped("pause", 2 * moving.now_ns)]
    assert [what for what, _ in moving.told] == ["hold", "pause"]
    assert moving.said("hold") == [cdr.EMPTY]


def test_the_end_of_a_motion_and_somebody_elses_hold_shut_the_gate(moving):
    ended = Alive(9, moving.asked, "a", ended=True)
    moving.hear(OURS["alive"], alive_bytes(OURS["alive"], ended))
    assert moving.monitor.gate is Gate.SHUT
    assert moving.moves("b").monitor.gate is Gate.OPEN
    moving.hear("PSM1/hold", cdr.EMPTY)
    assert moving.monitor.gate is Gate.HELD
    assert (moving.said("hold"), moving.links.refused) == ([], 0)


def test_the_pedal_is_heard(robot):
    for button, told in ((1, False), (0, False), (1, True)):
        # a std_msgs/Header of no frame, no axes, one button
        joy = cdr.LITTLE_ENDIAN + struct.pack("<iII4xIIi", 0, 0, 1, 0, 1, button)
        robot.hear("footpedals/operator_present", joy)
        robot.turns()
        told_now = [payload for key, payload, _ in robot.robot.put if key == OURS["challenge"]][-1]
        assert challenge_from(OURS["challenge"], told_now).pedal == told


@pytest.mark.parametrize("attachments", [True, False])
def test_what_is_said_to_rmw_zenoh_has_a_number_a_time_and_its_publishers_id_beside_it(monkeypatch, attachments):
    robot = Robot(monkeypatch, attachments=attachments)
    robot.turns(40)
    robot.moves()
    beside = {key: found for key, _, found in robot.robot.put}
    assert beside[OURS["challenge"]] is None, "it is of no ROS topic"
    if not attachments:
        assert set(beside.values()) == {None}
        return
    joints, jaw = (struct.unpack("<qqB16s", beside[SAYS[name]]) for name in ("servo_jp", "jaw/servo_jp"))
    assert (joints[:3], jaw[:3]) == ((1, 2 * robot.now_ns, 16), (2, 2 * robot.now_ns, 16))
    assert joints[3] == jaw[3] != Robot(monkeypatch).links._gid


@pytest.mark.parametrize("topic", ["set_point", "alive"])
@pytest.mark.parametrize("named", ["sent", "said"])
def test_a_message_of_the_bridge_that_names_another_key_is_none(robot, topic, named):
    robot.turns()
    robot.beat()
    own, other = OURS[topic], key_of("PSM2", topic)
    sent, said = (other, own) if named == "sent" else (own, other)
    point, alive = SetPoint(7, robot.asked, "a", HERE), Alive(7, robot.asked)
    data = set_point_bytes(said, point) if topic == "set_point" else alive_bytes(said, alive)
    robot.hear(sent, data, under=own)
    assert robot.links.refused == 1
    assert robot.monitor._answers == 0
    robot.hear(own, b"")
    robot.hear("footpedals/operator_present", b"garbage")
    assert robot.links.refused == 3
    assert (robot.said("servo_jp"), robot.told) == ([], [])


NEWER = b"\xfa\x07\x01x"
"""A field that no heartbeat has yet."""


@pytest.mark.parametrize(
    "wrong",
    [
        {"key": "lab/heartbeat/psm2"},
        {"encoding": "application/protobuf;lab/heartbeat/psm2"},
        {"data": b"\xff\xff"},
        {"data": "newer"},
    ],
)
def test_a_heartbeat_of_another_key_type_or_version_is_none(robot, wrong):
    robot.turns()
    if wrong == {"data": "newer"}:
        beat = Heartbeat(arm="psm1", arming_id="a", guard_challenge=robot.asked, pressed=True)
        wrong = {"data": beat.SerializeToString() + NEWER}
    robot.beat(**wrong)
    assert (robot.links.refused, robot.monitor._present) == (1, {})
    robot.move()
    assert robot.said("servo_jp") == []


@pytest.mark.parametrize("other", [{"arm": "psm2"}, {"arming_id": "b"}, {"guard_challenge": 5}, {"pressed": False}])
def test_each_field_of_a_heartbeat_counts(robot, other):
    robot.turns()
    robot.beat(**other)
    robot.move()
    assert (robot.said("servo_jp"), robot.links.refused) == ([], 0)


@pytest.mark.parametrize("set_s", [-10, 10])
def test_a_clock_that_is_set_in_mid_motion_neither_blinds_a_guard_nor_ends_the_motion(monkeypatch, set_s):
    robot, ahead_ns = Robot(monkeypatch), [0]
    # the guard's own clocks again, over those of a machine
    monkeypatch.undo()
    machine = SimpleNamespace(monotonic_ns=lambda: robot.now_ns, time_ns=lambda: 2**60 + robot.now_ns + ahead_ns[0])
    monkeypatch.setattr("shared.clock.time", machine)
    robot.turns(40)
    robot.moves()
    ahead_ns[0] = set_s * 1000 * MS
    robot.moves()
    assert robot.monitor.gate is Gate.OPEN
    for _ in range(23):
        robot.turns()
        robot.move()
    assert (robot.monitor.gate, robot.told) == (Gate.HELD, [("hold", "nobody stands by any more")])


@pytest.mark.parametrize("what", ["set point", "heartbeat"])
def test_turns_are_quick_for_a_second_after_what_stirs(robot, what):
    assert robot.links.turn() is False
    if what == "heartbeat":
        robot.beat()
    else:
        robot.move()
    robot.now_ns += RESTS_NS - 1
    assert robot.links.turn() is True
    robot.now_ns += 1
    assert robot.links.turn() is False


def test_a_measurement_counts_as_old_as_the_look_before_it(monkeypatch):
    robot = Robot(monkeypatch)
    robot.links.challenge()
    robot.measured()
    robot.links.turn()
    assert robot.monitor._position(robot.now_ns) == (), "it may have lain there for long"
    robot.now_ns += 400 * MS
    robot.links.turn()
    looked_ns = robot.now_ns
    robot.measured()
    robot.now_ns += 90 * MS
    robot.links.turn()
    assert robot.monitor._position(looked_ns + 100 * MS) == HERE
    assert robot.monitor._position(looked_ns + 100 * MS + 1) == ()


def test_a_set_point_is_judged_by_the_newest_measurement(moving):
    moving.now_ns += 10 * MS
    moving.links.challenge()
    moving.measured((0.9, 0.1, 0.2))
    moving.move()
    assert moving.told == [("hold", "a set point has axis 1 0.8 from where it is measured")]


@pytest.mark.parametrize("what", ["measured_js", "jaw/measured_js"])
def test_a_measurement_that_is_none_keeps_nothing_from_being_held(moving, what):
    newest = moving.robot.subscribers[f"PSM1/{what}"][2]
    while not moving.told:
        moving.now_ns += 10 * MS
        moving.links.challenge()
        moving.beat()
        newest[:] = [sample("", b"garbage")]
        before = moving.links.refused
        moving.links.turn()
        assert moving.links.refused == before + 1
    assert "set points have ended" in moving.told[0][1] or "not measured" in moving.told[0][1]


def fail(*_of):
    raise RuntimeError("a defect")


HEARD = {
    "hear_set_point": lambda robot: robot.move(),
    "hear_alive": lambda robot: robot.hear(OURS["alive"], alive_bytes(OURS["alive"], Alive(7, 1))),
    "hear_heartbeat": lambda robot: robot.beat(),
    "hear_stranger": lambda robot: robot.hear("PSM1/servo_jp", b""),
    "hear_hold": lambda robot: robot.hear("PSM1/hold", b""),
    "turn": lambda robot: robot.links.turn(),
    "challenge": lambda robot: robot.links.challenge(),
}


@pytest.mark.parametrize("what", HEARD)
def test_a_failure_holds_the_arm_and_nothing_of_that_motion_passes_any_more(moving, monkeypatch, what):
    with monkeypatch.context() as patched:
        patched.setattr(moving.monitor, what, fail)
        HEARD[what](moving)
    assert moving.told == [("hold", "the guard failed: RuntimeError: a defect")]
    assert moving.said("hold") == [cdr.EMPTY]
    moving.moves()
    assert len(moving.said("servo_jp")) == 1
    assert (moving.monitor.gate, moving.links.broke, moving.links.refused) == (Gate.HELD, False, 0)
    assert len(moving.moves("b").said("servo_jp")) == 2, "the next arming does"


def test_one_thing_is_judged_at_a_time(moving, monkeypatch):
    locked = []

    def watched(judged, *of):
        locked.append(moving.links._lock.locked())
        return judged(*of)

    for what, hear in HEARD.items():
        with monkeypatch.context() as patched:
            patched.setattr(moving.monitor, what, partial(watched, getattr(moving.monitor, what)))
            hear(moving)
    assert locked == [True] * len(HEARD)
    assert not moving.links._lock.locked()


@pytest.mark.parametrize("key", ["PSM1/servo_jp", "PSM1/jaw/servo_jp"])
def test_where_a_set_point_cannot_be_said_the_arm_is_held_and_where_hold_cannot_the_link_is_of_no_use(moving, key):
    moving.robot.broken = {key}
    moving.move()
    assert moving.told == [("hold", "the guard failed: ZError: closed")]
    assert not moving.links.broke
    moving.moves("b")
    moving.robot.broken |= {"PSM1/hold"}
    moving.moves("c")
    assert moving.links.broke
    assert moving.monitor.gate is Gate.HELD
    assert len(moving.told) == 2


class Told:
    """A kind that Zenoh tells: equal to its name, and another object each time."""

    def __init__(self, kind):
        self.kind = kind

    def __eq__(self, other):
        return self.kind == other

    def __hash__(self):
        return hash(self.kind)


def test_a_link_that_broke_is_broken_though_it_comes_back(robot):
    (changed,) = robot.robot.changed
    for kind, broke in (
        (zenoh.SampleKind.PUT, False),
        (zenoh.SampleKind.DELETE, True),
        (zenoh.SampleKind.PUT, True),
    ):
        changed(SimpleNamespace(kind=Told(kind)))
        assert robot.links.broke is broke


def test_at_its_end_the_arm_is_held_where_it_moves_and_nothing_is_judged_after(moving):
    moving.links.end("the guard was stopped")
    assert moving.told == [("hold", "the guard was stopped")]
    assert moving.said("hold") == [cdr.EMPTY]
    assert moving.links._lock.locked()


def test_at_its_end_an_arm_that_does_not_move_or_is_not_there_is_left_alone(robot):
    robot.links.end("the guard was stopped")
    assert (robot.told, robot.said("hold")) == ([], [])
    links = Links(Monitor(ROBOT), DOCUMENT, fail)
    links.end("the guard was stopped")
    assert links.broke is False
