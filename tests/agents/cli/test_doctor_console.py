"""What `doctor --arm` says of a console: of the emulated one, what goes wrong there, and what others might say."""

import contextlib
import threading
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest

from agents.configuration.rig import ArmSection, simulated_rig
from agents.configuration.sections import DvrkSection
from agents.diagnostics.doctor.console import CONFORMANCE, TELEOPERATION, Came, Told, examine_console, judged
from agents.dvrk_emulator.console import Behaviour, EmulatedConsole
from agents.dvrk_emulator.oracle import Field, Oracle
from agents.dvrk_emulator.wire import BridgeWire, RmwWire
from agents.robot_bridge.dvrk.psm import DvrkPsm
from shared.clock import now_ns
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.rigid_transforms import transform
from shared.ros import crtk
from shared.ros.naming import Ros2dds
from shared.ros.types import BOOL, JOINT_STATE, OPERATING_STATE, STRING, encode, message
from shared.terminal import UsageError
from tests.rigs.robot.world import TOOL

MS = 1_000_000
JOINTS = np.array((0.1, -0.1, 0.15, 0.2, 0.1, -0.1))
TIMELY = {"joints come", "the jaw comes", "the base's pose comes", "nothing is held back"}
"""What a busy machine may spoil."""
SECTION = DvrkSection(endpoint="tcp/127.0.0.1:7447", tool=TOOL, has_no=("endoscope_arm",))


def of(findings):
    """State and text of each finding, by its row."""
    return {one.what.removeprefix("PSM1: "): (one.state, one.found) for one in findings}


@contextlib.contextmanager
def running(wire):
    """An emulated console, enabled and homed, whose time passes."""
    console = EmulatedConsole(wire, "PSM1", Oracle(Field(SIMULATED_T_CAMERA_BASE), False), Behaviour(ready=True))
    stopped = threading.Event()
    lives = threading.Thread(target=console.run, args=(stopped,))
    lives.start()
    try:
        yield console
    finally:
        stopped.set()
        lives.join()
        console.close()


@pytest.fixture
def rig(settings):
    """Has a dVRK's arm on the router of the tests."""

    def rig(codec="ros2dds"):
        dvrk = SECTION.model_copy(update={"endpoint": settings.endpoint, "codec": codec})
        arm = ArmSection(backend="dvrk", T_camera_base=SIMULATED_T_CAMERA_BASE.tolist(), dvrk=dvrk)
        return simulated_rig().model_copy(update={"robot": {"psm1": arm}})

    return rig


@pytest.mark.parametrize(("codec", "wire"), [("ros2dds", BridgeWire), ("rmw_zenoh", partial(RmwWire, domain=0))])
def test_the_emulated_console_does_all_that_is_relied_on(session, rig, codec, wire):
    with running(wire(session)):
        found = list(examine_console(rig(codec), "psm1", 1.5))
    told = of(found)
    assert {row for row, (state, _) in told.items() if state == "WRONG"} <= TIMELY
    assert len(told) == len(CONFORMANCE) + 2
    assert told["camera and joints"][0] == "?", "no rig runs"
    assert told["frame of the pose"][0] == "ok"
    assert told["operating state"] == ("ok", "ENABLED, homed")
    # nobody moves it
    assert (told["busy"][0], told["set points"][0]) == ("?", "?")


@pytest.mark.parametrize(("word", "row"), [("mute", "joints come"), ("teleop", "teleoperation")])
def test_what_goes_wrong_at_the_console_is_told_in_its_row(session, rig, word, row):
    with running(BridgeWire(session)) as console:
        console.request(word)
        told = of(examine_console(rig(), "psm1", 1.5))
    assert told[row][0] == "WRONG"


def test_where_nothing_is_heard_that_alone_is_said(rig):
    finding, _ = examine_console(rig(), "psm1", 1.0)
    assert finding.remedy
    assert "nothing was heard of PSM1" in finding.found
    with pytest.raises(UsageError, match=r"no dVRK arm 'psm2'; it has psm1"):
        list(examine_console(rig(), "psm2", 1.0))


@dataclass
class Says:
    """What a console says at 100 Hz for half a second: by default all as it should be, and the arm moves."""

    unit: float = 1.0
    late_ms: float = 0.0
    jaw_late_ms: float = 0.0
    pose_T: np.ndarray | None = None
    other_T: np.ndarray | None = None
    heads_off: float = 0.0
    latched: bool = True
    busy: bool = False

    def told(self):
        """All of it, heard."""
        told = Told(SECTION)
        if self.latched:
            told.hear("operating_state", encode(OPERATING_STATE, state("ENABLED", False)), 995 * MS)
            told.hear("tool_type", encode(STRING, message(STRING, TOOL)), 995 * MS)
            told.hear(TELEOPERATION, encode(BOOL, message(BOOL, False)), 995 * MS)
        for i in range(100):
            at = (1000 + 10 * i) * MS
            joints = JOINTS + np.array((0.1 * i / 100, 0, 0, 0, 0, 0))
            arrives = at + round(self.late_ms * MS) * (i == 50)
            T = LARGE_NEEDLE_DRIVER.forward(joints)
            told.hear("measured_js", crtk.joint_command(self.unit * joints, at), arrives)
            told.hear(
                "jaw/measured_js", crtk.joint_command(np.array([0.3]), at - round(self.jaw_late_ms * MS)), arrives
            )
            told.hear(
                "local/measured_cp", crtk.pose_command(T if self.pose_T is None else self.pose_T @ T, at), arrives
            )
            told.hear("measured_cp", crtk.pose_command(T if self.other_T is None else self.other_T @ T, at), arrives)
            told.hear("servo_jp", crtk.joint_command(joints, at), at)
            told.hear("jaw/servo_jp", crtk.joint_command(np.array([0.3]), at), at)
            told.hear("setpoint_js", crtk.joint_command(joints + self.heads_off, at), at + MS)
            told.hear("jaw/setpoint_js", crtk.joint_command(np.array([0.3]), at), at + MS)
            if self.busy:
                told.hear("operating_state", encode(OPERATING_STATE, state("ENABLED", True)), at)
        return told


def hears(told, topic, *messages):
    """What was heard of a topic, in place of all else."""
    told.came[topic] = []
    for i, data in enumerate(messages):
        told.hear(topic, data, (1000 + 10 * i) * MS)
    return told


def row(told, what):
    return of(judged(told))[what]


@pytest.mark.parametrize("positions", [[], [0.1], [np.nan] * 6, [0.1] * 7])
@pytest.mark.parametrize("topic", ["measured_js", "setpoint_js", "servo_jp"])
def test_joints_that_are_too_few_too_many_or_no_numbers_are_told_and_nothing_else_is_lost(topic, positions):
    odd = encode(JOINT_STATE, joint_state(positions))
    told = hears(Says().told(), topic, odd, odd)
    assert len(of(judged(told))) == len(CONFORMANCE) + 1
    state, found = row(told, "units" if topic == "measured_js" else "set points")
    assert (state, "finite positions" in found) == ("WRONG", True)
    state, found = row(hears(Says().told(), topic, b"no message"), "units" if topic == "measured_js" else "set points")
    assert (state, "cannot be read" in found) == ("WRONG", True)


def test_a_console_that_falls_silent_is_told_even_where_it_came_evenly_before():
    told = Says().told()
    told.ended_ns = (2000 + 1500) * MS
    assert row(told, "joints come") == ("WRONG", "100 a second, the longest silence 1510 ms")
    told.broken = 1
    assert "broke 1 times" in row(told, "PSM1")[1]


def test_what_was_not_compared_is_not_called_well():
    short = Says().told()
    for topic in ("servo_jp", "jaw/servo_jp"):
        short.came[topic] = short.came[topic][:20]
    assert row(short, "set points")[0] == "?"
    busy = Says().told()
    busy.came["operating_state"] = []
    busy.hear("operating_state", encode(OPERATING_STATE, state("ENABLED", True)), 0)
    assert row(busy, "busy")[0] == "WRONG", "it was said before the first set point, and holds"
    busy.came["operating_state"] = []
    assert row(busy, "busy")[0] == "?"


def test_stamps_that_are_missing_or_of_a_clock_that_was_set_are_told():
    none = hears(Says().told(), "measured_js", *(crtk.joint_command(JOINTS, 0) for _ in range(5)))
    assert row(none, "one clock") == ("WRONG", "some have no stamp")
    assert row(none, "frame of the pose")[0] == "?"
    back = hears(Says().told(), "measured_js", *(crtk.joint_command(JOINTS, at * 2000 * MS) for at in (5, 6, 1)))
    assert row(back, "one clock") == ("WRONG", "stamps go back")


def test_an_error_that_was_said_before_is_told_and_one_that_comes_now_is_wrong():
    told = Says().told()
    said = encode(STRING, message(STRING, "PSM1: over current"))
    told.hear("error", said, 1)
    told.came["error"][0] = Came(told.span_ns[0], told.came["error"][0].value)
    assert row(told, "errors") == ("ok", "none now; it had said: PSM1: over current")
    told.hear("error", said, told.span_ns[0] + 2000 * MS)
    assert row(told, "errors")[0] == "WRONG"


def test_who_else_announced_motions_and_an_endoscope_that_does_not_come_are_told():
    told = Says().told()
    told.owners.add("@/abc/somebody")
    assert row(told, "other owners")[0] == "WRONG"
    told.section = SECTION.model_copy(update={"has_no": ()})
    assert row(told, "endoscope")[0] == "WRONG"


def test_a_bridge_stays_ready_while_doctor_listens(session, rig, settings, until):
    with running(BridgeWire(session)):
        backend = DvrkPsm("PSM1", settings, Ros2dds(), TOOL, dry_run=False)
        with contextlib.closing(backend):
            until(lambda: "no guard stands by" in backend.state(now_ns()).reason, "that nothing else is in the way")
            listening = threading.Thread(target=lambda: list(examine_console(rig(), "psm1", 1.5)))
            listening.start()
            while listening.is_alive():
                assert "somebody else" not in backend.state(now_ns()).reason
                listening.join(0.02)


def joint_state(positions):
    stamp = message("builtin_interfaces/msg/Time", 1, 0)
    nothing = np.zeros(0)
    return message(
        JOINT_STATE, message("std_msgs/msg/Header", stamp, ""), [], np.array(positions, float), nothing, nothing
    )


def state(word, busy):
    stamp = message("builtin_interfaces/msg/Time", 1, 0)
    return message(OPERATING_STATE, message("std_msgs/msg/Header", stamp, ""), word, True, busy)


AS_WELL = {
    "units": ("frame of the pose", "set points"),
    "joints come": ("the jaw comes", "the base's pose comes", "nothing is held back"),
    "nothing is held back": ("joints come", "the jaw comes", "the base's pose comes"),
    "operating state": ("tool", "teleoperation"),
    "tool": ("operating state", "teleoperation"),
}
"""What shows the same."""
AWAY = transform(np.eye(3), np.array((0.1, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("says", "where", "found"),
    [
        (Says(unit=1000.0), "units", "beyond a PSM's limits"),
        (Says(late_ms=150.0), "joints come", "longest silence 160 ms"),
        (Says(late_ms=150.0), "nothing is held back", "at most 150 ms later"),
        (Says(jaw_late_ms=8.0), "one clock", "within"),
        (Says(pose_T=AWAY), "frame of the pose", "measured_cp fits"),
        (Says(pose_T=AWAY, other_T=AWAY), "frame of the pose", "100.0 mm"),
        (Says(heads_off=0.02), "set points", "times as far"),
        (Says(busy=True), "busy", "busy while set points come"),
        (Says(latched=False), "operating state", "came late"),
        (Says(latched=False), "tool", "came late"),
    ],
)
def test_each_duty_that_is_not_done_is_told_in_its_row_alone(says, where, found):
    wrong = {name: text for name, (state, text) in of(judged(says.told())).items() if state == "WRONG"}
    assert found in wrong[where]
    assert set(wrong) <= {where, *AS_WELL.get(where, ())}


def test_a_console_that_does_everything_is_well_in_every_row_and_which_frame_is_which_is_found_out():
    told = of(judged(Says(other_T=AWAY).told()))
    assert {name for name, (state, _) in told.items() if state != "ok"} == set()
    assert "100 mm and 0 degrees away" in told["frame of the other pose"][1]
    exchanged = of(judged(Says(pose_T=AWAY).told()))
    assert "exchanged" in next(
        one.remedy for one in judged(Says(pose_T=AWAY).told()) if "frame of the pose" in one.what
    )
    assert exchanged["joints come"][0] == "ok"
