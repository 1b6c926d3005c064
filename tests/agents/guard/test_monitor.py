"""The safety monitor, rule by rule, with the time passed in."""

import math
import secrets

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.guard.description import Axis, Description
from agents.guard.monitor import Kind, Monitor
from shared.ros.guarded import UNKNOWN_MS, Alive, Gate, SetPoint

MS = 1_000_000
# the bounds of docs/safety.md, in numbers of their own
PRESENCE_NS, LINK_NS, FRESH_NS, GONE_NS, GRACE_NS = 220 * MS, 100 * MS, 100 * MS, 100 * MS, 100 * MS
AHEAD_S, BURST_S = 0.25, 0.06
REMEMBERED_NS, SETTLES_NS = 5000 * MS, 320 * MS
AGAIN_NS, HOLDS_NS, OBEYS_NS = 50 * MS, 5000 * MS, 100 * MS
AXES = (Axis(-1.5, 1.5, 1.0), Axis(0.0, 0.24, 0.2), Axis(-0.7, 1.4, 3.0))
ROBOT = Description("psm1", AXES, 200.0)
HERE = (0.1, 0.1, 0.2)
TICK = 5 * MS
STARTS_NS = [10 * MS, 2**40 - 123_456_789]
"""Of clocks: soon after a start, and across a power of two."""


class Rig:
    """A monitor, a bridge that sends set points each tick, somebody who answers, and an arm that is measured."""

    def __init__(self, robot=ROBOT, start_ns=10**12, settles=True):
        self.monitor, self.now_ns, self.sequence = Monitor(robot), start_ns, 0
        self.asked, self.actions = 0, []
        self.place: tuple[float, ...] = HERE
        self.answers = True
        self.tick(72 if settles else 4)

    def tick(self, count=1, arming=""):
        """Time passes; a challenge comes every 20 ms, and is answered at once for the arming."""
        for _ in range(count):
            self.now_ns += TICK
            if self.now_ns // TICK % 4 == 0:
                self.asked = self.monitor.challenge(self.now_ns).challenge
                if arming and self.answers:
                    self.beat(arming)
            self.measure("joints", "jaw")
            self.actions += self.turn()

    def wait(self, wait_ns, arming="", measured=("joints", "jaw")):
        """So much time passes; then the arm is measured, a challenge comes, and is answered for the arming."""
        self.now_ns += wait_ns
        self.measure(*measured)
        self.asked = self.monitor.challenge(self.now_ns).challenge
        if arming:
            self.beat(arming)

    def measure(self, *what):
        if "joints" in what:
            self.monitor.hear_joints(self.place[:-1], self.now_ns)
        if "jaw" in what:
            self.monitor.hear_jaw(self.place[-1:], self.now_ns)

    def beat(self, arming, pressed=True, arm="psm1", challenge=None):
        challenge = self.asked if challenge is None else challenge
        self.actions += self.monitor.hear_heartbeat(arm, arming, challenge, pressed, self.now_ns)

    def say(self, positions=HERE, arming="a", challenge=None, sequence=None):
        """A set point; what follows."""
        self.sequence += 1
        of = self.sequence if sequence is None else sequence, self.asked if challenge is None else challenge
        found = self.monitor.hear_set_point(SetPoint(*of, arming, tuple(positions)), self.now_ns)
        self.actions += found
        return found

    def moves(self, ticks=40, arming="a"):
        """Somebody stands by a motion."""
        for _ in range(ticks):
            self.tick(1, arming)
            self.say(self.place, arming)
        return self

    def end(self, arming="a", ended=True):
        """The bridge says that its motion has ended."""
        self.monitor.hear_alive(Alive(99, self.asked, arming, ended=ended), self.now_ns)

    def turn(self):
        """What follows from time alone, now."""
        return self.monitor.turn(self.now_ns)

    def told(self):
        """What the bridge is told with a challenge."""
        return self.monitor.challenge(self.now_ns)

    @property
    def held(self):
        return [action.reason for action in self.actions if action.kind is Kind.HOLD]

    @property
    def gate(self):
        return self.monitor.gate


def passed(actions):
    return [action.positions for action in actions if action.kind is Kind.PASS]


def reason(actions):
    (action,) = actions
    assert action.kind is Kind.HOLD
    return action.reason


@pytest.fixture(params=STARTS_NS)
def moving(request):
    """A rig in motion, whose newest challenge was issued and answered just now."""
    rig = Rig(start_ns=request.param).moves(8)
    rig.wait(MS, "a")
    assert passed(rig.say()) == [HERE]
    return rig


@pytest.fixture(params=STARTS_NS)
def just_held(request):
    """A rig whose motion was held just now, and nothing was measured since."""
    rig = Rig(start_ns=request.param).moves(8)
    rig.wait(MS, "a")
    assert reason(rig.say((math.nan, 0.0, 0.0)))
    return rig


def test_a_motion_that_somebody_stands_by_passes_as_it_was_sent_and_its_end_shuts_the_gate():
    rig = Rig().moves()
    assert passed(rig.actions) == [HERE] * (40 - 3), "until the first answer nothing passes"
    for arming, ended in (("b", True), ("a", False)):
        rig.end(arming, ended)
        assert rig.gate is Gate.OPEN
    rig.end()
    assert rig.gate is Gate.SHUT
    rig.tick(100, "a")
    assert rig.say() == []
    assert rig.held == [], "it ended as it should"
    rig.tick(4, "b")
    assert passed(rig.say(arming="b", sequence=0)) == [HERE], "numbers of another arming begin anew"


@pytest.mark.parametrize(
    "answer",
    [
        {"arming": "b"},
        {"arm": "psm2"},
        {"challenge": 0},
        {"challenge": 12345},
        {"pressed": False},
    ],
)
def test_what_is_no_answer_of_a_person_for_this_arming_and_arm_lets_nothing_pass(answer):
    rig = Rig()
    for _ in range(10):
        rig.tick()
        rig.beat(**({"arming": "a"} | answer))
        assert rig.say() == []
    assert rig.gate is Gate.SHUT


def test_challenges_are_64_bits_of_chance_and_never_zero(monkeypatch):
    rig, drawn = Rig(), iter([0, 5, 2**64 - 1])
    monkeypatch.setattr(secrets, "randbits", lambda bits: {64: drawn}[bits].__next__())
    assert [rig.monitor.challenge(rig.now_ns + k).challenge for k in range(3)] == [1, 5, 2**64 - 1]


def test_presence_lasts_for_so_long_from_when_the_answered_challenge_was_issued(moving):
    older = moving.asked
    moving.wait(MS, "a")
    moving.beat("a", challenge=older)
    moving.say()
    for wait_ns in (100 * MS, 100 * MS, 20 * MS):
        moving.wait(wait_ns)
        assert moving.turn() == []
        assert passed(moving.say()) == [HERE]
    moving.wait(1)
    assert reason(moving.turn()) == "nobody stands by any more"
    assert moving.gate is Gate.HELD


@pytest.mark.parametrize("start_ns", STARTS_NS)
def test_set_points_that_nobody_stands_by_are_dropped_for_a_moment_and_then_the_arm_is_held(start_ns):
    rig = Rig(start_ns=start_ns)
    assert rig.say() == []
    rig.wait(GRACE_NS)
    assert rig.say() == []
    assert rig.say(arming="b") == [], "another one's time begins anew"
    rig.wait(GRACE_NS)
    assert rig.say(arming="b") == []
    rig.wait(1)
    assert reason(rig.say(arming="b")) == "set points come and nobody stands by"
    assert rig.gate is Gate.HELD


def test_a_motion_that_sends_nothing_any_more_is_held(moving):
    moving.wait(GONE_NS, "a")
    assert moving.turn() == []
    moving.wait(1, "a")
    assert reason(moving.turn()) == "set points have ended, and not as a motion should"


@pytest.mark.parametrize(("seen", "old"), [("joints", "jaw"), ("jaw", "joints")])
def test_an_arm_whose_joints_or_jaw_are_not_measured_any_more_is_held(moving, seen, old):
    moving.wait(FRESH_NS, "a", measured=(seen,))
    assert passed(moving.say()) == [HERE]
    assert moving.turn() == []
    moving.wait(1, "a", measured=(seen,))
    assert reason(moving.turn()) == "the arm's joints or jaw are not measured any more"
    moving.measure(old)
    moving.wait(1, "b")
    assert passed(moving.say(arming="b")) == [HERE]


def test_an_arm_that_is_not_measured_does_not_begin_to_move():
    rig = Rig()
    rig.wait(FRESH_NS + 1, "a", measured=("joints",))
    assert reason(rig.say()) == "the arm's joints or jaw are not measured"


@pytest.mark.parametrize("what", ["hear_joints", "hear_jaw"])
def test_numbers_that_are_not_one_finite_number_for_each_axis_are_no_measurement(moving, what):
    other = ("jaw" if what == "hear_joints" else "joints",)
    moving.wait(50 * MS, "a", measured=other)
    moving.say()
    moving.wait(FRESH_NS + 1 - 50 * MS, "a", measured=other)
    for values in ((), (math.nan,), (math.nan, 0.1), (math.inf, 0.1), (0.1, 0.1, 0.1)):
        getattr(moving.monitor, what)(values, moving.now_ns)
    assert "not measured" in reason(moving.turn())


@pytest.mark.parametrize("age_ns", [LINK_NS, LINK_NS + 1])
def test_a_set_point_is_as_young_as_the_challenge_that_it_echoes(moving, age_ns):
    challenge = moving.asked
    moving.wait(50 * MS, "a")
    assert passed(moving.say())
    moving.wait(age_ns - 50 * MS, "a")
    assert bool(passed(moving.say(challenge=challenge))) == (age_ns == LINK_NS)
    assert moving.gate is Gate.OPEN, "a late one alone is dropped"


def test_a_set_point_of_no_arming_of_an_unknown_challenge_or_that_is_played_again_is_dropped():
    rig = Rig().moves()
    newest = rig.sequence
    assert rig.say(arming="") == rig.say(challenge=7) == []
    for sequence in (newest, newest - 1, 0):
        assert rig.say(sequence=sequence) == []
    assert rig.gate is Gate.OPEN
    assert passed(rig.say(sequence=newest + 1)) == [HERE]


@pytest.mark.parametrize(
    ("positions", "why"),
    [
        ((0.1, 0.1), "has 2 numbers, where the arm has 3"),
        ((0.1, 0.1, 0.2, 0.0), "has 4 numbers, where the arm has 3"),
        ((0.1, math.nan, 0.2), "axis 2 at nan, outside 0 to 0.24"),
        ((0.1, math.inf, 0.2), "axis 2 at inf, outside 0 to 0.24"),
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
    assert rig.gate is Gate.HELD
    assert rig.say(HERE) == []


def test_limits_themselves_may_be_sent():
    rig = Rig()
    rig.place = (1.5, 0.0, 1.4)
    rig.moves()
    rounded = (1.5 + 1e-9, -1e-9, 1.4 + 1e-9)
    assert passed(rig.say(rounded)) == [rounded], "as rounding has it"


def test_a_bad_set_point_before_anything_moves_holds_too_and_burns_its_arming():
    rig = Rig()
    rig.tick(1, "a")
    assert "axis 1 at nan" in reason(rig.say((math.nan, 0.1, 0.2)))
    assert rig.told().arming_id == "a"
    rig.tick(10, "a")
    assert rig.say() == []


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
    assert (told.gate, told.arming_id, told.reason) == (Gate.HELD, "a", "nobody stands by any more")
    rig.answers = True
    rig.tick(8, "a")
    assert rig.say() == []
    for k in range(400):
        rig.monitor.hold("", rig.now_ns, f"another {k}")
    rig.tick(8, "a")
    assert rig.say() == [], "many others are remembered beside it"
    rig.moves(10, arming="b")
    assert rig.gate is Gate.OPEN
    assert rig.told().reason == ""


@pytest.mark.parametrize("share", [0.99, 1.5])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_that_keeps_going_too_fast_is_held(axis, share):
    axes = (Axis(-10, 10, 1.0), Axis(-10, 10, 0.2), Axis(-10, 10, 3.0))
    rig = Rig(Description("psm1", axes, 200.0)).moves()
    for _ in range(100):
        rig.place = tuple(at + share * axes[axis].speed * 5e-3 * (k == axis) for k, at in enumerate(rig.place))
        rig.tick(1, "a")
        rig.say(rig.place)
    assert rig.held[:1] == (
        [f"a set point has axis {axis + 1} go faster than {axes[axis].speed:g} a second"] * (share > 1)
    )


def test_a_step_of_a_burst_may_come_and_comes_again_after_a_while():
    rig = Rig()
    rig.place = (0.0, 0.1, 0.2)
    rig.moves()
    for step in (1, 2):
        rig.wait(80 * MS, "a")
        assert passed(rig.say((step * BURST_S, 0.1, 0.2)))


def test_more_set_points_than_a_bridge_sends_in_a_burst_are_none_of_a_bridge(moving):
    moving.wait(50 * MS, "a")
    found = [moving.say() for _ in range(19)]
    assert all(passed(each) for each in found[:18]), "1.5 times 200 a second for 60 ms"
    assert reason(found[18]) == "more than 300 set points a second come"


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_may_be_ahead_of_where_it_is_measured_by_a_quarter_of_a_second_of_its_speed(axis):
    axes = tuple(Axis(-10, 10, 1.0 if k == axis else 2.0) for k in range(3))
    rig = Rig(Description("psm1", axes, 200.0))
    rig.place = (0.0, 0.0, 0.0)
    rig.moves()
    # by 1/128 each, so that nothing is rounded
    for step in range(1, 33):
        rig.wait(10 * MS, "a")
        assert passed(rig.say([step / 128 if k == axis else 0.0 for k in range(3)])), step
    rig.wait(10 * MS, "a")
    ahead = [AHEAD_S + 1e-6 if k == axis else 0.0 for k in range(3)]
    assert reason(rig.say(ahead)) == f"a set point has axis {axis + 1} 0.25 from where it is measured"


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(-3, 3), st.integers(0, 40), st.booleans()), max_size=30))
def test_whatever_comes_what_passes_is_within_limits_and_no_faster_than_it_may(steps):
    rig = Rig()
    last, last_ns = None, 0
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


def test_somebody_elses_set_points_end_a_motion_and_pause_the_arm_once_where_they_go_on():
    rig = Rig()
    assert rig.monitor.hear_stranger(rig.now_ns) == [], "before anything moves they are somebody else's concern"
    for arming in ("a", "b"):
        rig.moves(arming=arming)
        assert reason(rig.monitor.hear_stranger(rig.now_ns)) == "somebody else sends set points too"
        assert rig.monitor.hear_stranger(rig.now_ns + OBEYS_NS) == []
        (pause,) = rig.monitor.hear_stranger(rig.now_ns + OBEYS_NS + 1)
        assert (pause.kind, pause.reason) == (Kind.PAUSE, "set points come although the arm was held")
        assert rig.monitor.hear_stranger(rig.now_ns + 2 * OBEYS_NS) == [], "once"
    rig.moves(arming="c").end("c")
    assert rig.monitor.hear_stranger(rig.now_ns + 10 * OBEYS_NS) == [], "after a motion that ended as it should"


def test_somebody_elses_hold_ends_a_motion_for_good_and_is_not_said_a_second_time_at_once():
    rig = Rig()
    assert rig.monitor.hear_hold(rig.now_ns) == []
    assert rig.gate is Gate.SHUT
    rig.moves()
    assert rig.monitor.hear_hold(rig.now_ns) == []
    assert rig.gate is Gate.HELD
    rig.tick(4, "a")
    assert rig.say() == []


def test_a_hold_before_the_first_set_point_ends_the_arming_that_was_heard_of():
    rig = Rig()
    rig.tick(8, "a")
    rig.monitor.hear_hold(rig.now_ns)
    rig.moves(arming="a")
    assert passed(rig.actions) == []
    assert passed(rig.moves(arming="b").actions), "another arming is none of its"


def test_what_a_bridge_sent_before_it_heard_of_a_hold_opens_nothing():
    rig = Rig()
    rig.wait(0)
    asked = rig.asked
    for after_ns in (0, 5 * MS, 5 * MS):
        rig.now_ns += after_ns
        rig.monitor.hear_hold(rig.now_ns)
        rig.now_ns += after_ns
        arming = f"a{after_ns}-{rig.now_ns}"
        rig.beat(arming)
        assert rig.say(arming=arming, challenge=asked) == []
    assert passed(rig.moves(arming="a").actions), "one that echoes a challenge of since does"


def test_a_hold_of_an_arm_that_is_not_measured_is_said_again_for_a_while(just_held):
    just_held.now_ns += FRESH_NS + 1
    assert reason(just_held.turn()) == "a set point has axis 1 at nan, outside -1.5 to 1.5"
    assert just_held.turn() == []
    just_held.now_ns += HOLDS_NS - FRESH_NS - 1
    assert just_held.turn()
    just_held.now_ns += AGAIN_NS
    assert just_held.turn() == []


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("moved", [2.1e-3, -2.1e-3])
def test_a_hold_is_said_again_until_the_arm_has_stood_since_the_last_one(just_held, axis, moved):
    for k in range(1, 4):
        just_held.place = tuple(at + k * moved * (index == axis) for index, at in enumerate(HERE))
        just_held.now_ns += AGAIN_NS - 1
        just_held.measure("joints", "jaw")
        assert just_held.turn() == []
        just_held.now_ns += 1
        assert just_held.turn()
    just_held.now_ns += AGAIN_NS
    just_held.measure("joints", "jaw")
    assert just_held.turn() == []


def test_an_arm_that_creeps_does_not_stand(just_held):
    for k in range(1, 4):
        just_held.place = (HERE[0] + 0.9e-3 * k, *HERE[1:])
        just_held.now_ns += AGAIN_NS
        just_held.measure("joints", "jaw")
        assert bool(just_held.turn()) == (k == 3)


def test_the_bridge_is_told_how_long_its_way_takes():
    rig = Rig()
    rig.now_ns += MS
    told = rig.told()
    assert (told.answers, told.round_trip_ms, told.gate, told.pedal) == (0, UNKNOWN_MS, Gate.SHUT, False)
    rig.monitor.hear_alive(Alive(5, told.challenge), rig.now_ns + 30 * MS)
    again = rig.monitor.challenge(rig.now_ns + 40 * MS)
    assert (again.answers, again.round_trip_ms) == (5, 0.0), "it echoed the newest"
    rig.now_ns += 90 * MS
    rig.say(challenge=told.challenge, sequence=6)
    assert rig.told().round_trip_ms == 50.0, "for so long a newer one was out"


@pytest.mark.parametrize(("age_ns", "known"), [(REMEMBERED_NS, True), (REMEMBERED_NS + 1, False)])
def test_a_challenge_is_forgotten_after_a_while(age_ns, known):
    rig = Rig()
    rig.wait(MS)
    old = rig.asked
    rig.wait(age_ns)
    rig.monitor.hear_alive(Alive(1, old), rig.now_ns)
    assert (rig.told().round_trip_ms != UNKNOWN_MS) == known


@pytest.mark.parametrize("start_ns", STARTS_NS)
def test_where_answers_come_too_late_for_a_motion_to_begin_the_hold_says_by_how_much(start_ns):
    rig = Rig(start_ns=start_ns)
    rig.wait(0)
    asked = rig.asked
    rig.say()
    rig.wait(GRACE_NS)
    rig.say()
    rig.now_ns += 1
    assert reason(rig.say()) == "set points come and nobody stands by"
    early_ns = rig.now_ns - 1
    assert rig.monitor.hear_heartbeat("psm1", "a", asked, True, early_ns) == [], "as old as it may be"
    rig.now_ns += 50 * MS
    rig.beat("another", challenge=asked)
    rig.beat("a", challenge=asked, arm="psm2")
    for _ in range(2):
        rig.beat("a", challenge=asked)
    late = "the operator's answers take 150 ms to the guard, and 100 ms are allowed"
    assert rig.held[1:] == [late], "once"
    told = rig.told()
    assert (told.gate, told.arming_id, told.reason) == (Gate.HELD, "a", late)


def test_where_answers_begin_to_come_too_late_in_a_motion_the_hold_says_so_too(moving):
    moving.wait(0)
    asked = moving.asked
    for wait_ns in (100 * MS, 100 * MS, 20 * MS):
        moving.wait(wait_ns)
        moving.say()
    moving.wait(1)
    assert reason(moving.turn()) == "nobody stands by any more"
    assert moving.monitor.hear_heartbeat("psm1", "a", moving.asked, True, moving.now_ns) == []
    moving.now_ns += 80 * MS
    (told,) = moving.monitor.hear_heartbeat("psm1", "a", asked, True, moving.now_ns)
    assert told.reason == "the operator's answers take 300 ms to the guard, and 220 ms are allowed"


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
        rig.beat("a", challenge=rig.asked if heard == "answer" else 12345)
    assert rig.told().round_trip_ms == UNKNOWN_MS, "so that no bridge arms now"
    rig.now_ns = began_ns + SETTLES_NS + 1
    for _ in range(100):
        rig.tick(1, "a")
        assert passed(rig.say()) == []
    assert passed(rig.moves(20, "b").actions)


def test_a_guard_that_has_settled_passes_what_begins_then():
    assert reason(Monitor(ROBOT).hear_set_point(SetPoint(1, 0, "a", HERE), 10**12)), "before its first challenge"
    rig = Rig(settles=False)
    rig.now_ns = rig.now_ns - rig.now_ns // TICK % 4 * TICK + SETTLES_NS + 1
    rig.wait(0, "a")
    rig.monitor.hear_alive(Alive(1, rig.asked), rig.now_ns)
    assert rig.told().round_trip_ms == 0.0
    assert passed(rig.say()) == [HERE]


PEDAL = ROBOT._replace(pedal=True)


def with_pedal(robot=PEDAL):
    """A rig whose pedal was released and pressed."""
    rig = Rig(robot)
    press_anew(rig)
    return rig


def press_anew(rig):
    rig.monitor.hear_pedal(False)
    rig.monitor.hear_pedal(True)


def processes(rig, ticks=40, arming="a"):
    """A process beats by itself beside somebody's foot."""
    for _ in range(ticks):
        rig.tick()
        rig.beat(arming, pressed=False)
        rig.say(arming=arming)
    return rig


def test_a_pressed_pedal_is_presence_and_its_release_ends_it_at_once():
    rig = processes(with_pedal())
    assert rig.gate is Gate.OPEN
    assert rig.told().pedal
    rig.monitor.hear_pedal(True)
    assert passed(rig.say()), "told again to be down, it changes nothing"
    rig.monitor.hear_pedal(False)
    assert reason(rig.say()) == "nobody stands by any more"


def test_a_pedal_that_the_description_does_not_name_counts_for_nothing():
    rig = processes(with_pedal(ROBOT), ticks=10)
    assert rig.gate is Gate.SHUT
    assert not rig.told().pedal
    rig.moves(arming="b")
    rig.monitor.hear_pedal(False)
    assert passed(rig.say(arming="b")), "nor does its release end anything"


@pytest.mark.parametrize("ends", [Rig.end, lambda rig: rig.monitor.hear_stranger(rig.now_ns)], ids=["end", "hold"])
def test_a_pedal_has_to_be_pressed_anew_for_each_motion(ends):
    rig = processes(with_pedal())
    ends(rig)
    assert not rig.told().pedal
    rig.monitor.hear_pedal(True)
    assert processes(rig, 10, "b").gate is not Gate.OPEN, "it is told to be down, and was never up"
    press_anew(rig)
    assert processes(rig, 10, "c").gate is Gate.OPEN


def test_a_foot_that_was_down_when_the_guard_began_does_not_count():
    rig = Rig(PEDAL)
    rig.monitor.hear_pedal(True)
    rig.monitor.hear_pedal(True)
    assert processes(rig, 10).gate is Gate.SHUT
    assert not rig.told().pedal
    press_anew(rig)
    assert rig.told().pedal


@pytest.mark.parametrize("away_ns", [FRESH_NS, FRESH_NS + 1])
@pytest.mark.parametrize("lost", ["joints", "jaw"])
@pytest.mark.parametrize("foot", [True, False])
def test_what_the_pedal_said_before_its_console_was_not_heard_does_not_count(away_ns, lost, foot):
    rig = with_pedal()
    if not foot:
        rig.monitor.hear_pedal(False)
    rig.wait(away_ns // 2, measured=({"joints", "jaw"} - {lost}))
    rig.wait(away_ns - away_ns // 2)
    if not foot:
        rig.monitor.hear_pedal(True)
    assert rig.told().pedal == (away_ns == FRESH_NS), "a release may have been lost meanwhile"
    press_anew(rig)
    assert rig.told().pedal, "a release and a press are both heard"
    rig.now_ns += FRESH_NS + 1
    assert not rig.told().pedal, "a console that is not heard says nothing"


def document(**other):
    return {"arm": "psm1", "console": "PSM1", "axes": [[0, 1, 1]] * 2, "rate_hz": 200, "pedal": False} | other


@pytest.mark.parametrize(
    "document",
    [
        {},
        document(axes=5),
        document(axes=[[0, 1, 1]]),
        document(axes=[[0, 1]] * 2),
        document(axes=[[1, 1, 1]] * 2),
        document(axes=[[0, math.nan, 1]] * 2),
        document(axes=[[0, 1, 0]] * 2),
        document(axes=[[0, 1, math.inf]] * 2),
        document(rate_hz=19.9),
        document(rate_hz=1000.5),
        document(rate_hz=math.nan),
        document(rate_hz="often"),
    ],
)
def test_a_description_that_no_arm_has_is_refused(document):
    with pytest.raises(ValueError, match="the guard's description"):
        Description.from_document(document)


def test_a_description_is_what_its_document_says():
    axes = [[axis.lower, axis.upper, axis.speed] for axis in AXES]
    assert Description.from_document(document(axes=axes, pedal=True)) == PEDAL
    for rate_hz in (20, 1000):
        assert Description.from_document(document(rate_hz=rate_hz, axes=[[0, 1, 0.5]] * 2)).rate_hz == rate_hz
