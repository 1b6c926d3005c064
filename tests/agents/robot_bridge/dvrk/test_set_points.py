"""Whether a console heads for what it was sent, by what it says of its own set points."""

import numpy as np

from agents.robot_bridge.dvrk.guard_link import REMEMBERED, GuardLink
from agents.robot_bridge.dvrk.set_points import SAME, SETTLES_NS, WINDOW_NS, SetPointsWatch
from agents.robot_bridge.plans import Code
from shared.ros import crtk

START, MS = 10**18, 10**6
HERE = np.array((0.2, 0.0, 0.13, 0.0, 0.0, 0.0))
STEP = np.array((0.001, 0, 0, 0, 0, 0))


class Console:
    """What a watch is told and asked, 200 times a second; the console says what it was sent some turns ago."""

    def __init__(self):
        self.watch, self.now_ns, self.found = SetPointsWatch("PSM1"), START, []
        self.stands(HERE)

    def turn(self, says, sent=None, jaw=0.0):
        self.now_ns += 5 * MS
        if sent is not None:
            self.watch.sent(sent, jaw, self.now_ns)
        for kind, values in (("setpoint_js", says), ("jaw/setpoint_js", np.array([jaw]))):
            self.watch.hear(kind, crtk.joint_command(values, self.now_ns), self.now_ns)
        if judged := self.watch.judge(self.now_ns):
            self.found.append(judged.code)

    def stands(self, at, turns=300):
        for _ in range(turns):
            self.turn(at)

    def moves(self, start, turns, clip=np.inf, late=4):
        points = [start + i * STEP for i in range(turns)]
        for i, point in enumerate(points):
            says = start if i < late else np.minimum(points[i - late], np.array((clip, *np.full(5, np.inf))))
            self.turn(says, point)
        return points[-1]


def test_a_console_that_follows_late_or_stops_at_a_point_that_it_was_sent_is_left_alone():
    console = Console()
    end = console.moves(HERE, 400)
    console.stands(end - 4 * STEP)
    console.moves(end, 200)
    assert console.found == []


def test_joints_that_are_clipped_are_found_also_where_nothing_else_moves():
    console = Console()
    console.moves(HERE, 100, clip=HERE[0] + 0.05)
    assert console.found == [], "within what was sent a moment ago"
    console.moves(HERE + 100 * STEP, 100, clip=HERE[0] + 0.05)
    assert set(console.found) == {Code.OTHER_SET_POINT}


def test_set_points_that_creep_while_we_send_none_are_found_unless_it_was_told_to_go_elsewhere():
    console, slow = Console(), 0.002 * SAME["setpoint_js"]
    for i in range(600):
        console.turn(HERE + i * slow)
        assert i >= 400 or console.found == [], "not farther than how a point may come out"
    assert set(console.found) == {Code.OTHER_SET_POINT}
    held = Console()
    held.watch.let_go(held.now_ns)
    held.stands(HERE + 20 * STEP, 1 + SETTLES_NS // (5 * MS))
    assert held.found == []


def test_what_is_not_told_or_cannot_be_read_is_not_watched():
    watch = SetPointsWatch("PSM1")
    watch.sent(HERE, 0.0, START)
    assert watch.judge(START + 10 * WINDOW_NS) is None
    for data in (b"", crtk.joint_command(np.zeros(1), START)):
        watch.hear("setpoint_js", data, START)
        assert watch.judge(START) is None
    watch.hear("setpoint_js", crtk.joint_command(HERE, START), START)
    assert watch.judge(START + 10 * WINDOW_NS) is None, "what was said so long ago says nothing"


def test_where_the_console_has_the_jaw_head_is_told_as_it_said_last():
    watch = SetPointsWatch("PSM1")
    assert watch.jaw_rad is None
    for data, told in ((crtk.joint_command(np.array([0.3]), START), 0.3), (b"", None)):
        watch.hear("jaw/setpoint_js", data, START)
        assert watch.jaw_rad == told


def test_a_jaw_that_stands_through_a_long_motion_is_ours_to_its_end():
    link = GuardLink("PSM1", lambda _key, _payload: True, lambda: 0)
    for number in range(REMEMBERED + 100):
        joints = tuple(1e-4 * number + 0.1 * axis for axis in range(6))
        link.move((*joints, 0.5), "a")
        assert link.ours(crtk.joint_command(np.array(joints), 0), 6)
        assert link.ours(crtk.joint_command(np.array([0.5]), 0), 1)
    assert not link.ours(crtk.joint_command(np.array([0.6]), 0), 1)
    strange = np.array((9.0, 9.0, 9.0, 9.0, 9.0, 0.5))
    assert not link.ours(crtk.joint_command(strange, 0), 6), "joints of somebody else, the last of which is our jaw's"
