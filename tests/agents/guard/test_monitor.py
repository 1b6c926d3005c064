"""The safety monitor, rule by rule, with the time passed in."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.guard.description import Axis, Description
from agents.guard.monitor import Kind, Monitor
from shared.ros.guarded import UNKNOWN_MS, Alive, Gate, SetPoint

MS = 1_000_000
TICK = 5 * MS
# the bounds of docs/safety.md, in numbers of their own
PRESENCE_NS, LINK_NS, FRESH_NS, GONE_NS, GRACE_NS = 220 * MS, 100 * MS, 100 * MS, 100 * MS, 100 * MS
BURST_S, SETTLES_NS, AGAIN_NS, HOLDS_NS, OBEYS_NS = 0.06, 320 * MS, 50 * MS, 5000 * MS, 100 * MS
ENABLES_NS = 5000 * MS
AXES = (Axis(-1.5, 1.5, 1.0), Axis(0.0, 0.24, 0.2), Axis(-0.7, 1.4, 3.0))
ROBOT = Description("psm1", AXES, 200.0)
PEDAL = ROBOT._replace(pedal=True)
HERE = (0.1, 0.1, 0.2)
LEFT, UNMEASURED = "nobody stands by any more", "the arm's joints or jaw are not measured"


class Rig:
    """A monitor, a bridge that sends set points each tick, somebody who answers, and an arm that is measured."""

    def __init__(self, robot=ROBOT, start_ns=10**12, settles=True, place: tuple[float, ...] = HERE):
        self.monitor, self.now_ns, self.sequence = Monitor(robot), start_ns, 0
        self.asked, self.actions, self.answers, self.place = 0, [], True, place
        self.tick(72 if settles else 4)

    def tick(self, count=1, arming="", pressed=True):
        """Time passes; a challenge comes every 20 ms, and is answered at once for the arming."""
        for _ in range(count):
            self.now_ns += TICK
            if self.now_ns // TICK % 4 == 0:
                self.asked = self.told().challenge
                if arming and self.answers:
                    self.beat(arming, pressed)
            self.measure("joints", "jaw")
            self.actions += self.turn()

    def wait(self, wait_ns, arming="", measured=("joints", "jaw")):
        """So much time passes; then the arm is measured, a challenge comes, and is answered for the arming."""
        self.now_ns += wait_ns
        self.measure(*measured)
        self.asked = self.told().challenge
        if arming:
            self.beat(arming)

    def measure(self, *what):
        if "joints" in what:
            self.monitor.hear_joints(self.place[:-1], self.now_ns)
        if "jaw" in what:
            self.monitor.hear_jaw(self.place[-1:], self.now_ns)

    def beat(self, arming="a", pressed=True, arm="psm1", challenge=None):
        challenge = self.asked if challenge is None else challenge
        return self.monitor.hear_heartbeat(arm, arming, challenge, pressed, self.now_ns)

    def say(self, positions=HERE, arming="a", challenge=None, sequence=None):
        """A set point; what follows."""
        self.sequence += 1
        of = self.sequence if sequence is None else sequence, self.asked if challenge is None else challenge
        found = self.monitor.hear_set_point(SetPoint(*of, arming, tuple(positions)), self.now_ns)
        self.actions += found
        return found

    def moves(self, ticks=40, arming="a", pressed=True):
        """Somebody stands by a motion."""
        for _ in range(ticks):
            self.tick(1, arming, pressed)
            self.say(self.place, arming)
        return self

    def end(self, arming="a", ended=True):
        """The bridge says that its motion has ended."""
        self.monitor.hear_alive(Alive(99, self.asked, arming, ended=ended), self.now_ns)

    def stranger(self):
        return self.monitor.hear_stranger(self.now_ns)

    def pedal(self, *pressed):
        """Whether it counts after what the console says of it."""
        for each in pressed:
            self.monitor.hear_pedal(each, self.now_ns)
        return self.told().pedal

    def turn(self):
        return self.monitor.turn(self.now_ns)

    def told(self):
        return self.monitor.challenge(self.now_ns)

    @property
    def gate(self):
        return self.monitor.gate


def passed(actions):
    return [action.positions for action in actions if action.kind is Kind.PASS]


def reason(actions):
    (action,) = actions
    assert action.kind is Kind.HOLD
    return action.reason


@pytest.fixture(params=[10 * MS, 2**40 - 123_456_789])
def moving(request):
    """A rig in motion, soon after its computer started or long after, whose newest challenge was answered just now."""
    rig = Rig(start_ns=request.param).moves(8)
    rig.wait(MS, "a")
    assert passed(rig.say()) == [HERE]
    return rig


@pytest.fixture
def just_held(moving):
    """A rig whose motion was held just now, and nothing was measured since."""
    assert reason(moving.say((math.nan, 0.0, 0.0)))
    return moving


# who stands by


def test_a_motion_that_somebody_stands_by_passes_as_it_was_sent_and_its_end_shuts_the_gate():
    rig = Rig().moves()
    assert rig.actions == [(Kind.PASS, HERE, "")] * (40 - 3), "until the first answer nothing passes"
    for arming, ended in (("b", True), ("a", False)):
        rig.end(arming, ended)
        assert rig.gate is Gate.OPEN
    rig.end()
    assert rig.gate is Gate.SHUT
    rig.tick(100, "a")
    assert (rig.say(), len(rig.actions)) == ([], 37), "it ended as it should"
    rig.tick(4, "b")
    assert passed(rig.say(arming="b", sequence=0)) == [HERE], "numbers of another arming begin anew"


@pytest.mark.parametrize("answer", [{"arming": "b"}, {"arm": "psm2"}, {"challenge": 12345}, {"pressed": False}])
def test_what_is_no_answer_of_a_person_for_this_arming_and_arm_lets_nothing_pass(answer):
    rig = Rig()
    for _ in range(10):
        rig.tick()
        rig.beat(**answer)
        assert rig.say() == []
    assert rig.gate is Gate.SHUT


def test_presence_lasts_for_so_long_from_when_the_answered_challenge_was_issued(moving):
    asked = moving.asked
    moving.wait(MS, "a")
    moving.beat(challenge=asked)
    moving.say()
    for wait_ns in (100 * MS, 100 * MS, PRESENCE_NS - 200 * MS):
        moving.wait(wait_ns)
        assert (moving.turn(), passed(moving.say())) == ([], [HERE])
    moving.wait(1)
    assert reason(moving.turn()) == LEFT
    assert moving.gate is Gate.HELD
    assert moving.beat() == []
    moving.now_ns += 79 * MS - 1
    late = "the operator's answers take 300 ms to the guard, and 220 ms are allowed"
    assert reason(moving.beat(challenge=asked)) == late, "an answer that comes too late tells why it was held"
    assert moving.told().reason == late


def test_set_points_that_nobody_stands_by_are_dropped_for_a_moment_and_then_the_arm_is_held():
    rig = Rig()
    assert rig.say() == []
    rig.wait(GRACE_NS)
    assert rig.say() == []
    assert rig.say(arming="b") == [], "another one's time begins anew"
    rig.wait(GRACE_NS)
    assert rig.say(arming="b") == []
    rig.wait(1)
    assert reason(rig.say(arming="b")) == "set points come and nobody stands by"
    rig.now_ns += GRACE_NS
    assert rig.beat("b") == [], "as old as it may be"
    rig.now_ns += 50 * MS
    assert rig.beat("c") == rig.beat("b", arm="psm2") == []
    assert reason(rig.beat("b")).endswith("150 ms to the guard, and 100 ms are allowed")
    assert rig.beat("b") == [], "once"
    assert (rig.gate, rig.told().arming_id) == (Gate.HELD, "b")


# what may pass


@pytest.mark.parametrize("age_ns", [LINK_NS, LINK_NS + 1])
def test_a_set_point_that_is_late_or_answers_nothing_or_is_played_again_is_dropped(moving, age_ns):
    challenge = moving.asked
    moving.wait(50 * MS, "a")
    assert passed(moving.say())
    moving.wait(age_ns - 50 * MS, "a")
    assert bool(passed(moving.say(challenge=challenge))) == (age_ns == LINK_NS)
    assert passed(moving.say())
    newest = moving.sequence
    assert moving.say(arming="") == moving.say(challenge=7) == []
    for sequence in (newest, newest - 1, 0):
        assert moving.say(sequence=sequence) == []
    assert moving.gate is Gate.OPEN
    assert passed(moving.say(sequence=newest + 1)) == [HERE]


@pytest.mark.parametrize(
    ("positions", "why"),
    [
        ((0.1, 0.1), "has 2 numbers, where the arm has 3"),
        ((0.1, math.nan, 0.2), "axis 2 at nan, outside 0 to 0.24"),
        ((0.1, 0.1, 1.41), "axis 3 at 1.41, outside -0.7 to 1.4"),
        ((1.5 + 1.1e-9, 0.1, 0.2), "axis 1 at 1.5, outside"),
        ((0.1, -1.1e-9, 0.2), "axis 2 at -1.1e-09, outside"),
        ((0.1 + 1.0 * BURST_S * 1.01, 0.1, 0.2), "axis 1 go faster than 1 a second"),
        ((0.1, 0.1 - 0.2 * BURST_S * 1.01, 0.2), "axis 2 go faster than 0.2 a second"),
        ((0.1, 0.1, 0.2 + 3.0 * BURST_S * 1.01), "axis 3 go faster than 3 a second"),
    ],
)
def test_what_no_arm_should_be_sent_is_not_passed_and_holds_it(positions, why):
    rig = Rig().moves()
    rig.tick(1, "a")
    assert why in reason(rig.say(positions))
    assert (rig.gate, rig.say(HERE)) == (Gate.HELD, [])


def test_a_bad_set_point_before_anything_moves_burns_its_arming_and_limits_themselves_may_be_sent():
    rig = Rig(place=(1.5, 0.0, 1.4))
    rig.tick(1, "a")
    assert "axis 1 at nan" in reason(rig.say((math.nan, 0.1, 0.2)))
    assert rig.told().arming_id == "a"
    rig.tick(10, "a")
    assert rig.say() == []
    rig.moves(arming="b")
    rounded = (1.5 + 1e-9, -1e-9, 1.4 + 1e-9)
    assert passed(rig.say(rounded, "b")) == [rounded], "as rounding has it"


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_that_keeps_going_too_fast_is_held(axis):
    wide = tuple(Axis(-10, 10, each.speed) for each in AXES)
    for share in (0.99, 1.5):
        rig = Rig(Description("psm1", wide, 200.0)).moves()
        for _ in range(100):
            rig.place = tuple(at + share * wide[axis].speed * 5e-3 * (k == axis) for k, at in enumerate(rig.place))
            rig.moves(1)
        assert (rig.gate is Gate.OPEN) == (share < 1)


def test_more_set_points_than_a_bridge_sends_in_a_burst_are_none_of_a_bridge(moving):
    moving.wait(50 * MS, "a")
    found = [moving.say() for _ in range(19)]
    assert all(passed(each) for each in found[:18]), "1.5 times 200 a second for 60 ms"
    assert reason(found[18]) == "more than 300 set points a second come"


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_may_be_ahead_of_where_it_is_measured_by_a_quarter_of_a_second_of_its_speed(axis):
    axes = tuple(Axis(-10, 10, 1.0 if k == axis else 2.0) for k in range(3))
    rig, found = Rig(Description("psm1", axes, 200.0), place=(0.0, 0.0, 0.0)).moves(), []
    # by 1/128 each, so that nothing is rounded
    for at in (*(step / 128 for step in range(1, 33)), 0.25 + 1e-6):
        rig.wait(10 * MS, "a")
        found = rig.say([at if k == axis else 0.0 for k in range(3)])
        assert bool(passed(found)) == (at <= 0.25)
    assert reason(found) == f"a set point has axis {axis + 1} 0.25 from where it is measured"


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(-3, 3), st.integers(0, 40), st.booleans()), max_size=30))
def test_whatever_comes_what_passes_is_within_limits_and_no_faster_than_it_may(steps):
    rig, last, last_ns = Rig(), None, 0
    for arming, value, ticks, attended in steps:
        rig.answers = attended
        rig.tick(ticks, arming)
        # near, as a motion is, or anywhere
        position = (HERE[0] + value * (0.02 if ticks < 20 else 1.0), *HERE[1:])
        for found in passed(rig.say(position, arming)):
            assert all(axis.lower <= at <= axis.upper for axis, at in zip(AXES, found, strict=True))
            if last is not None:
                allowed = AXES[0].speed * ((rig.now_ns - last_ns) * 1e-9 + BURST_S) + abs(HERE[0] - last)
                assert abs(found[0] - last) <= allowed + 1e-9
            last, last_ns = found[0], rig.now_ns


# what ends a motion


def test_a_motion_that_sends_nothing_any_more_is_held(moving):
    moving.wait(GONE_NS, "a")
    assert moving.turn() == []
    moving.wait(1, "a")
    assert reason(moving.turn()) == "set points have ended, and not as a motion should"


@pytest.mark.parametrize(("seen", "old"), [("joints", "jaw"), ("jaw", "joints")])
def test_an_arm_whose_joints_or_jaw_are_not_measured_any_more_is_held_and_begins_no_motion(moving, seen, old):
    moving.wait(FRESH_NS, "a", measured=(seen,))
    assert (passed(moving.say()), moving.turn()) == ([HERE], [])
    moving.wait(1, "a", measured=(seen,))
    for values in ((), (math.nan,), (math.nan, 0.1), (math.inf, 0.1), (0.1, 0.1, 0.1)):
        # none of these is a measurement
        getattr(moving.monitor, f"hear_{old}")(values, moving.now_ns)
    assert reason(moving.turn()) == f"{UNMEASURED} any more"
    moving.beat("b")
    assert reason(moving.say(arming="b")) == UNMEASURED
    moving.wait(1, "c")
    assert passed(moving.say(arming="c")) == [HERE]


def test_set_points_of_another_arming_in_mid_motion_hold_and_neither_goes_on():
    rig = Rig().moves()
    rig.tick(4, "b")
    rig.beat("a")
    assert reason(rig.say(arming="b")) == "set points of another arming come in mid-motion"
    assert rig.told().arming_id == "a"
    for arming in ("a", "b"):
        rig.tick(8, arming)
        assert rig.say(arming=arming) == []


def test_a_motion_that_was_held_never_passes_again_and_another_arming_does():
    rig = Rig().moves()
    rig.answers = False
    rig.moves(60)
    told = rig.told()
    assert (told.gate, told.arming_id, told.reason) == (Gate.HELD, "a", LEFT)
    rig.answers = True
    for k in range(400):
        rig.monitor.hold("", rig.now_ns, f"another {k}")
    rig.tick(8, "a")
    assert rig.say() == [], "many others are remembered beside it"
    rig.moves(10, arming="b")
    assert (rig.gate, rig.told().reason) == (Gate.OPEN, "")


def test_somebody_elses_set_points_end_a_motion_and_pause_the_arm_once_where_they_go_on():
    rig = Rig()
    assert rig.stranger() == [], "before anything moves they are somebody else's concern"
    for arming in ("a", "b"):
        rig.moves(arming=arming)
        assert reason(rig.stranger()) == "somebody else sends set points too"
        rig.now_ns += OBEYS_NS
        assert rig.stranger() == []
        rig.now_ns += 1
        assert rig.stranger() == [(Kind.PAUSE, (), "set points come although the arm was held")]
        assert rig.stranger() == [], "once"
    rig.moves(arming="c").end("c")
    rig.now_ns += 10 * OBEYS_NS
    assert rig.stranger() == [], "after a motion that ended as it should"


def test_somebody_elses_hold_ends_what_moves_and_all_that_was_armed_before():
    rig = Rig().moves()
    assert rig.monitor.hear_hold(rig.now_ns) == [], "it is not said a second time at once"
    assert (rig.gate, rig.told().reason) == (Gate.HELD, "somebody said hold")
    rig.tick(4, "a")
    assert rig.say() == []
    # an arming of which the guard has heard, and of which no set point has come
    rig = Rig()
    rig.tick(8, "a")
    assert (rig.monitor.hear_hold(rig.now_ns), rig.gate) == ([], Gate.SHUT)
    assert passed(rig.moves(arming="a").actions) == []
    # a bridge that has not heard of the hold echoes a challenge of before
    rig.wait(0)
    asked = rig.asked
    for arming, after_ns in (("b", 0), ("c", 5 * MS), ("d", 5 * MS)):
        rig.now_ns += after_ns
        rig.monitor.hear_hold(rig.now_ns)
        rig.now_ns += after_ns
        rig.beat(arming)
        assert rig.say(arming=arming, challenge=asked) == []
    assert passed(rig.moves(arming="e").actions)


# what follows a hold, and a start


def test_a_hold_of_an_arm_that_is_not_measured_is_said_again_for_a_while(just_held):
    just_held.now_ns += FRESH_NS + 1
    assert reason(just_held.turn()) == "a set point has axis 1 at nan, outside -1.5 to 1.5"
    assert just_held.turn() == []
    just_held.now_ns += HOLDS_NS - FRESH_NS - 1
    assert just_held.turn()
    just_held.now_ns += AGAIN_NS
    assert just_held.turn() == []


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_hold_is_said_again_until_the_arm_has_stood_since_the_last_one(just_held, axis):
    def turn(at_mm, after_ns):
        just_held.place = tuple(at + 1e-3 * at_mm * (index == axis) for index, at in enumerate(HERE))
        just_held.now_ns += after_ns
        just_held.measure("joints", "jaw")
        return bool(just_held.turn())

    for at_mm in (2.1, 0.0, 2.1):
        assert not turn(at_mm, AGAIN_NS - 1)
        assert turn(at_mm, 1)
    assert [turn(at_mm, AGAIN_NS) for at_mm in (2.1, 3.0, 3.9)] == [False] * 3
    assert turn(4.8, AGAIN_NS), "an arm that creeps does not stand"


@pytest.mark.parametrize("after_ns", [1, SETTLES_NS])
@pytest.mark.parametrize("heard", ["set point", "answer", "answer of before"])
def test_what_a_guard_hears_of_as_it_begins_never_passes_for_it_may_have_been_held_by_the_one_before(after_ns, heard):
    rig = Rig(settles=False)
    began_ns = rig.now_ns - rig.now_ns // TICK % 4 * TICK
    rig.now_ns = began_ns + after_ns
    if heard == "set point":
        assert reason(rig.say()) == "the guard has begun anew while set points came"
        assert rig.say() == [], "once"
    else:
        rig.beat(challenge=rig.asked if heard == "answer" else 12345)
    assert rig.told().round_trip_ms == UNKNOWN_MS, "so that no bridge arms now"
    rig.now_ns = began_ns + SETTLES_NS + 1
    rig.wait(0, "b")
    assert (passed(rig.say()), passed(rig.say(arming="b"))) == ([], [HERE])
    rig.end("b")
    assert passed(rig.moves(100).actions) == [HERE], "that of b"


def test_the_bridge_is_told_how_long_its_way_takes():
    rig = Rig()
    rig.now_ns += MS
    told = rig.told()
    assert told.challenge != rig.asked, "nobody can answer before it was asked"
    assert (told.answers, told.round_trip_ms, told.gate, told.pedal) == (0, UNKNOWN_MS, Gate.SHUT, False)
    rig.now_ns += 40 * MS
    rig.monitor.hear_alive(Alive(5, told.challenge), rig.now_ns)
    again = rig.told()
    assert (again.answers, again.round_trip_ms) == (5, 0.0), "it echoed the newest"
    rig.now_ns += 50 * MS
    rig.say(challenge=told.challenge, sequence=6)
    assert rig.told().round_trip_ms == 50.0, "for so long a newer one was out"
    for age_ns, known in ((5000 * MS, True), (5000 * MS + 1, False)):
        rig.wait(MS)
        asked = rig.asked
        rig.wait(age_ns)
        rig.monitor.hear_alive(Alive(1, asked), rig.now_ns)
        assert (rig.told().round_trip_ms != UNKNOWN_MS) == known, "a challenge is remembered for five seconds"


# the pedal


def with_pedal(robot=PEDAL):
    """A rig whose pedal was released and pressed."""
    rig = Rig(robot)
    rig.pedal(False, True)
    return rig


def test_a_pressed_pedal_is_presence_where_the_arm_has_one_and_its_release_ends_it_at_once():
    rig = with_pedal().moves(pressed=False)
    assert rig.pedal(True), "told again to be down, it changes nothing"
    assert passed(rig.say())
    rig.pedal(False)
    assert reason(rig.say()) == LEFT
    none = with_pedal(ROBOT).moves(10, pressed=False)
    assert (none.gate, none.told().pedal) == (Gate.SHUT, False)
    none.moves(arming="b").pedal(False)
    assert passed(none.say(arming="b")), "nor does its release end anything"


@pytest.mark.parametrize("ends", [Rig.end, Rig.stranger])
def test_a_pedal_has_to_be_pressed_anew_for_each_motion(ends):
    rig = with_pedal().moves(pressed=False)
    ends(rig)
    assert not rig.pedal(True), "it is told to be down, and was never up"
    assert rig.moves(10, "b", pressed=False).gate is not Gate.OPEN
    rig.pedal(False, True)
    assert rig.moves(10, "c", pressed=False).gate is Gate.OPEN


def test_a_press_of_a_moment_ago_is_told_of_an_arm_that_is_not_measured_and_lets_nothing_pass():
    rig = Rig(PEDAL)
    rig.wait(2 * FRESH_NS, measured=())
    assert rig.pedal(False, True)
    rig.wait(ENABLES_NS, measured=())
    assert rig.told().pedal
    assert not passed(rig.say())
    rig.wait(1, measured=())
    assert not rig.told().pedal


def test_a_foot_that_was_down_when_the_guard_began_does_not_count():
    rig = Rig(PEDAL)
    assert not rig.pedal(True, True)
    assert rig.moves(10, pressed=False).gate is Gate.SHUT
    assert rig.pedal(False, True)


@pytest.mark.parametrize("heard", ["joints", "jaw"])
@pytest.mark.parametrize("foot", [True, False])
def test_what_the_pedal_said_before_its_console_was_not_heard_does_not_count(heard, foot):
    for away_ns in (FRESH_NS, FRESH_NS + 1):
        rig = with_pedal()
        rig.pedal(foot)
        rig.wait(away_ns // 2, measured=(heard,))
        rig.wait(away_ns - away_ns // 2)
        assert rig.pedal(True) == (away_ns == FRESH_NS), "a release may have been lost meanwhile"
    assert rig.pedal(False, True)
    rig.now_ns += ENABLES_NS + 1
    assert not rig.told().pedal, "a console that is not heard says nothing for long"


def test_a_description_is_what_its_document_says_and_one_that_no_arm_has_is_refused():
    of = {"arm": "psm1", "console": "PSM1", "axes": [list(axis) for axis in AXES], "rate_hz": 200, "pedal": True}
    assert Description.from_document(of) == PEDAL
    for rate_hz in (20, 1000):
        assert Description.from_document(of | {"rate_hz": rate_hz, "axes": [[0, 1, 0.5]] * 2}).rate_hz == rate_hz
    wrong = [of | {"rate_hz": rate} for rate in (19.9, 1000.5, "often")]
    wrong += [of | {"axes": [axis] * 2} for axis in ([0, 1], [1, 1, 1], [0, 1, 0], [0, 1, math.inf])]
    for document in ({}, of | {"axes": [[0, 1, 1]]}, *wrong):
        with pytest.raises(ValueError, match="the guard's description"):
            Description.from_document(document)
