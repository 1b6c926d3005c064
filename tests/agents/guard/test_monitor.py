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
REMEMBERED_NS, BURNT, SETTLES_NS = 5000 * MS, 1000, 320 * MS
AGAIN_NS, HOLDS_NS, STANDS, OBEYS_NS = 50 * MS, 5000 * MS, 2e-3, 100 * MS
AXES = (Axis(-1.5, 1.5, 1.0), Axis(0.0, 0.24, 0.2), Axis(-0.7, 1.4, 3.0))
ROBOT = Description("psm1", AXES, 200.0)
HERE = (0.1, 0.1, 0.2)
TICK = 5 * MS


class Rig:
    """A monitor, a bridge that sends set points each tick, somebody who answers, and an arm that is measured."""

    def __init__(self, robot=ROBOT, start_ns=10**12, settles=True):
        self.monitor, self.now_ns, self.sequence = Monitor(robot), start_ns, 0
        self.asked, self.actions = 0, []
        self.place: tuple[float, ...] = HERE
        self.measures, self.answers = True, True
        self.tick(72 if settles else 4)

    def tick(self, count=1, arming=""):
        """Time passes; a challenge comes every 20 ms, and is answered at once for the arming."""
        for _ in range(count):
            self.now_ns += TICK
            if self.now_ns // TICK % 4 == 0:
                self.asked = self.monitor.challenge(self.now_ns).challenge
                if arming and self.answers:
                    self.beat(arming)
            if self.measures:
                self.monitor.hear_joints(self.place[:-1], self.now_ns)
                self.monitor.hear_jaw(self.place[-1:], self.now_ns)
            self.actions += self.monitor.turn(self.now_ns)

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

    def turn(self):
        """What follows from time alone, now."""
        return self.monitor.turn(self.now_ns)

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


def test_a_motion_that_somebody_stands_by_passes_as_it_was_sent_and_its_end_shuts_the_gate():
    rig = Rig().moves()
    assert len(passed(rig.actions)) == 40 - 3, "until the first answer nothing passes"
    assert set(passed(rig.actions)) == {HERE}
    assert rig.gate is Gate.OPEN
    rig.monitor.hear_alive(Alive(99, rig.asked, "a", ended=True), rig.now_ns)
    assert rig.gate is Gate.SHUT
    rig.tick(100, "a")
    assert rig.say() == []
    assert rig.held == [], "it ended as it should"


def test_only_the_open_arming_ends_and_only_where_it_is_said_to_have_ended():
    for alive in (Alive(9, 1, "b", ended=True), Alive(9, 1, "A", ended=True), Alive(9, 1, "a", ended=False)):
        rig = Rig().moves()
        rig.monitor.hear_alive(alive, rig.now_ns)
        assert rig.gate is Gate.OPEN


@pytest.mark.parametrize("late_ns", [0, 1])
def test_presence_lasts_from_when_the_challenge_was_issued_and_no_longer(late_ns):
    rig = Rig().moves()
    issued_ns, rig.answers = rig.now_ns - rig.now_ns // TICK % 4 * TICK, False
    while rig.now_ns + TICK <= issued_ns + PRESENCE_NS:
        rig.tick()
        assert passed(rig.say()) == [HERE]
    rig.now_ns = issued_ns + PRESENCE_NS + late_ns
    assert bool(passed(rig.say())) == (late_ns == 0)
    if late_ns:
        assert rig.held == ["nobody stands by any more"]


def test_a_turn_ends_what_nobody_stands_by_even_where_no_set_point_comes():
    rig = Rig().moves()
    rig.answers = False
    began_ns = rig.now_ns
    while not rig.held:
        rig.tick()
        rig.sequence += 1
        rig.monitor._passed_ns = rig.now_ns
    assert rig.held == ["nobody stands by any more"]
    assert rig.now_ns - began_ns <= PRESENCE_NS + TICK


@pytest.mark.parametrize(
    "answer",
    [
        {"arm": "psm2"},
        {"arm": "psm0"},
        {"challenge": 0},
        {"challenge": 12345},
        {"pressed": False},
    ],
)
def test_what_is_no_answer_of_a_person_at_this_arm_lets_nothing_pass(answer):
    rig = Rig()
    for _ in range(10):
        rig.tick()
        rig.beat("a", **answer)
        assert rig.say() == []
    assert rig.gate is Gate.SHUT


def test_an_answer_for_another_arming_lets_nothing_of_this_one_pass():
    rig = Rig()
    for _ in range(10):
        rig.tick(1, "b")
        assert rig.say(arming="a") == []


def test_an_old_answer_that_comes_late_does_not_make_presence_younger_or_older():
    rig = Rig().moves()
    old = rig.asked
    rig.tick(20, "a")
    newest_ns = rig.monitor._present["a"]
    rig.beat("a", challenge=old)
    assert rig.monitor._present["a"] == newest_ns


def test_a_challenge_is_forgotten_after_a_while():
    rig = Rig()
    old = rig.asked
    rig.now_ns += REMEMBERED_NS + TICK
    rig.tick(4)
    rig.monitor.hear_alive(Alive(1, old), rig.now_ns)
    assert rig.monitor.challenge(rig.now_ns).round_trip_ms == UNKNOWN_MS


def test_challenges_are_64_bits_of_chance_and_never_zero(monkeypatch):
    rig, drawn = Rig(), iter([0, 5, 2**64 - 1])
    made = {rig.monitor.challenge(rig.now_ns + k).challenge for k in range(200)}
    assert len(made) == 200
    monkeypatch.setattr(secrets, "randbits", lambda bits: {64: drawn}[bits].__next__())
    assert [rig.monitor.challenge(rig.now_ns + k).challenge for k in range(3)] == [1, 5, 2**64 - 1]


def test_set_points_that_nobody_stands_by_are_dropped_for_a_moment_and_then_the_arm_is_held():
    rig = Rig()
    began_ns = rig.now_ns
    while not rig.held:
        rig.tick()
        rig.say()
        assert passed(rig.actions) == []
    assert rig.held == ["set points come and nobody stands by"]
    assert GRACE_NS < rig.now_ns - began_ns <= GRACE_NS + 2 * TICK
    assert rig.gate is Gate.HELD


def test_a_motion_that_was_held_never_passes_again_and_another_arming_does():
    rig = Rig().moves()
    rig.answers = False
    rig.moves(60)
    assert rig.gate is Gate.HELD
    rig.answers = True
    for _ in range(40):
        rig.tick(1, "a")
        assert rig.say(arming="a") == []
    told = rig.monitor.challenge(rig.now_ns)
    assert (told.gate, told.arming_id, told.reason) == (Gate.HELD, "a", "nobody stands by any more")
    rig.moves(10, arming="b")
    assert rig.gate is Gate.OPEN
    assert rig.monitor.challenge(rig.now_ns).reason == ""


def test_a_set_point_without_an_arming_is_none():
    rig = Rig().moves()
    assert rig.say(arming="") == []
    assert rig.gate is Gate.OPEN


@pytest.mark.parametrize(
    ("positions", "why"),
    [
        ((0.1, 0.1), "has 2 numbers, where the arm has 3"),
        ((0.1, 0.1, 0.2, 0.0), "has 4 numbers, where the arm has 3"),
        ((0.1, math.nan, 0.2), "axis 2 at nan, outside 0 to 0.24"),
        ((0.1, math.inf, 0.2), "axis 2 at inf, outside 0 to 0.24"),
        ((1.51, 0.1, 0.2), "axis 1 at 1.51, outside -1.5 to 1.5"),
        ((0.1, -0.001, 0.2), "axis 2 at -0.001, outside 0 to 0.24"),
        ((0.1, 0.1, 1.41), "axis 3 at 1.41, outside -0.7 to 1.4"),
        ((0.1 + 1.0 * BURST_S * 1.01, 0.1, 0.2), "axis 1 go faster than 1 a second"),
        ((0.1, 0.1 - 0.2 * BURST_S * 1.01, 0.2), "axis 2 go faster than 0.2 a second"),
        ((0.1, 0.1, 0.2 + 3.0 * BURST_S * 1.01), "axis 3 go faster than 3 a second"),
        ((1.5 + 1.1e-9, 0.1, 0.2), "axis 1 at 1.5, outside"),
        ((0.1, -1.1e-9, 0.2), "axis 2 at -1.1e-09, outside"),
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
    assert rig.gate is Gate.OPEN
    assert rig.held == []


def test_a_bad_set_point_before_anything_moves_holds_too_and_burns_its_arming():
    rig = Rig()
    rig.tick(1, "a")
    assert "axis 1 at nan" in reason(rig.say((math.nan, 0.1, 0.2)))
    assert rig.monitor.challenge(rig.now_ns).arming_id == "a"
    rig.tick(10, "a")
    assert rig.say() == []


@pytest.mark.parametrize("other", ["b", "A"])
def test_what_comes_of_another_arming_in_mid_motion_holds_and_neither_goes_on(other):
    rig = Rig().moves()
    rig.tick(4, other)
    rig.beat("a")
    assert reason(rig.say(arming=other)) == "set points of another arming come in mid-motion"
    assert rig.monitor.challenge(rig.now_ns).arming_id == "a"
    for arming in ("a", other):
        rig.tick(8, arming)
        assert rig.say(arming=arming) == []


@pytest.mark.parametrize("age_ns", [LINK_NS, LINK_NS + 1])
def test_a_set_point_is_as_young_as_the_challenge_that_it_echoes(age_ns):
    rig = Rig().moves()
    challenge = rig.monitor.challenge(rig.now_ns).challenge
    rig.wait(50 * MS, "a")
    assert passed(rig.say())
    rig.wait(age_ns - 50 * MS, "a")
    assert bool(passed(rig.say(challenge=challenge))) == (age_ns == LINK_NS)
    assert rig.gate is Gate.OPEN, "a late one alone is dropped"


def test_a_set_point_of_an_unknown_challenge_is_dropped():
    rig = Rig().moves()
    assert rig.say(challenge=7) == []
    assert rig.gate is Gate.OPEN


def test_what_was_overtaken_or_is_played_again_is_dropped():
    rig = Rig().moves()
    for sequence in (rig.sequence, rig.sequence - 1, 0):
        assert rig.say(sequence=sequence) == []
    assert passed(rig.say(sequence=rig.sequence + 1)) == [HERE]


def test_numbers_of_another_arming_begin_anew():
    rig = Rig().moves()
    rig.monitor.hear_alive(Alive(0, rig.asked, "a", ended=True), rig.now_ns)
    rig.tick(4, "b")
    assert passed(rig.say(arming="b", sequence=0)) == [HERE]


@pytest.mark.parametrize("gone_ns", [GONE_NS, GONE_NS + TICK])
def test_a_motion_that_sends_nothing_any_more_is_held(gone_ns):
    rig = Rig().moves()
    last_ns = rig.now_ns
    while rig.now_ns < last_ns + gone_ns:
        rig.tick(1, "a")
    assert rig.held == (["set points have ended, and not as a motion should"] if gone_ns > GONE_NS else [])


@pytest.mark.parametrize("what", ["hear_joints", "hear_jaw"])
@pytest.mark.parametrize("values", [(), (math.nan,), (math.nan, 0.1), (0.1, 0.1, 0.1)])
def test_an_arm_that_is_not_measured_is_not_moved(what, values):
    rig = Rig().moves()
    rig.measures = False
    since_ns = rig.now_ns
    while not rig.held:
        rig.tick(1, "a")
        other = "hear_jaw" if what == "hear_joints" else "hear_joints"
        getattr(rig.monitor, other)(HERE[-1:] if other == "hear_jaw" else HERE[:-1], rig.now_ns)
        getattr(rig.monitor, what)(values, rig.now_ns)
        rig.say()
    assert "not measured" in rig.held[0]
    assert rig.now_ns - since_ns <= FRESH_NS + 2 * TICK
    assert rig.gate is Gate.HELD


def test_an_arm_that_was_never_measured_is_not_moved():
    rig = Rig()
    rig.monitor._measured[1] = (), -math.inf
    rig.tick(0)
    rig.beat("a")
    assert reason(rig.say()) == "the arm's joints or jaw are not measured"


def test_no_axis_goes_faster_than_it_may_however_set_points_are_spread():
    rig = Rig().moves()
    step, position = AXES[0].speed * TICK * 1e-9, HERE[0]
    for _ in range(200):
        rig.tick(1, "a")
        position += 0.999 * step
        if position > 1.4:
            break
        rig.place = (position, *HERE[1:])
        assert passed(rig.say(rig.place)) == [rig.place]
    over = (position - 1.4 * BURST_S, *HERE[1:])
    assert "faster" in reason(rig.say(over))


def test_travel_that_was_not_used_does_not_add_up():
    rig = Rig().moves(200)
    rig.tick(1, "a")
    assert "faster" in reason(rig.say((HERE[0] + 1.02 * BURST_S, *HERE[1:])))


def test_a_burst_of_what_was_on_its_way_passes_and_more_does_not():
    rig = Rig().moves()
    rig.tick(1, "a")
    step = AXES[0].speed * 0.005
    count = 0
    while (found := rig.say((HERE[0] + step * (count + 1), *HERE[1:]))) and found[0].kind is Kind.PASS:
        count += 1
    assert count == round(BURST_S / 0.005)


def test_more_set_points_than_a_bridge_sends_are_none_of_a_bridge():
    rig, found = Rig().moves(), []
    for _ in range(100):
        found = rig.say()
        if not passed(found):
            break
    assert reason(found) == "more than 300 set points a second come"


def test_a_set_point_far_from_where_the_arm_is_measured_holds_it():
    rig, found = Rig().moves(), []
    position = HERE[0]
    for _ in range(400):
        rig.tick(1, "a")
        position += 0.9 * AXES[0].speed * TICK * 1e-9
        found = rig.say((position, *HERE[1:]))
        if not passed(found):
            break
    assert f"axis 1 {position - HERE[0]:.3g} from where it is measured" in reason(found)
    assert position - HERE[0] == pytest.approx(AXES[0].speed * AHEAD_S, abs=0.01)


def test_somebody_elses_set_points_end_a_motion_and_pause_the_arm_where_they_go_on():
    rig = Rig()
    assert rig.monitor.hear_stranger(rig.now_ns) == [], "before anything moves they are somebody else's concern"
    rig.moves()
    assert reason(rig.monitor.hear_stranger(rig.now_ns)) == "somebody else sends set points too"
    for obeys_ns in (OBEYS_NS - 1, OBEYS_NS):
        assert rig.monitor.hear_stranger(rig.now_ns + obeys_ns) == []
    (pause,) = rig.monitor.hear_stranger(rig.now_ns + OBEYS_NS + 1)
    assert (pause.kind, pause.reason) == (Kind.PAUSE, "set points come although the arm was held")
    assert rig.monitor.hear_stranger(rig.now_ns + 2 * OBEYS_NS) == [], "once"


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


def test_a_hold_is_said_again_until_the_arm_stands():
    rig = Rig().moves()
    rig.answers = False
    while not rig.held:
        rig.tick()
        rig.say()
    held_ns = rig.now_ns
    for k in range(100):
        rig.place = (HERE[0] + 0.01 * k, *HERE[1:])
        rig.tick()
    assert len(rig.held) == 1 + (rig.now_ns - held_ns) // AGAIN_NS
    rig.tick(2 * AGAIN_NS // TICK)
    said = len(rig.held)
    rig.tick(200)
    assert len(rig.held) == said


def test_a_hold_of_an_arm_that_is_not_measured_is_said_for_a_while_and_not_for_ever():
    rig = Rig().moves()
    rig.measures = False
    rig.tick(round(2 * HOLDS_NS / TICK))
    assert len(rig.held) == pytest.approx(HOLDS_NS / AGAIN_NS, abs=3)


def test_the_bridge_is_told_how_long_its_way_takes():
    rig = Rig()
    rig.now_ns += MS
    told = rig.monitor.challenge(rig.now_ns)
    assert (told.answers, told.round_trip_ms, told.gate, told.pedal) == (0, UNKNOWN_MS, Gate.SHUT, False)
    rig.monitor.hear_alive(Alive(5, told.challenge), rig.now_ns + 30 * MS)
    again = rig.monitor.challenge(rig.now_ns + 40 * MS)
    assert (again.answers, again.round_trip_ms) == (5, 0.0), "it echoed the newest"
    rig.now_ns += 90 * MS
    rig.say(challenge=told.challenge, sequence=6)
    assert rig.monitor.challenge(rig.now_ns).round_trip_ms == 50.0, "for so long a newer one was out"


PEDAL = ROBOT._replace(pedal=True)


def with_pedal(robot=PEDAL):
    rig = Rig(robot)
    rig.monitor.hear_pedal(False)
    rig.monitor.hear_pedal(True)
    return rig


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
    assert rig.monitor.challenge(rig.now_ns).pedal
    rig.monitor.hear_pedal(False)
    assert reason(rig.say()) == "nobody stands by any more"


def test_a_pedal_that_the_description_does_not_name_counts_for_nothing():
    rig = processes(with_pedal(ROBOT), ticks=10)
    assert rig.gate is Gate.SHUT
    assert not rig.monitor.challenge(rig.now_ns).pedal


def test_a_pedal_has_to_be_pressed_anew_for_each_motion():
    rig = processes(with_pedal())
    rig.monitor.hear_alive(Alive(0, rig.asked, "a", ended=True), rig.now_ns)
    assert not rig.monitor.challenge(rig.now_ns).pedal
    rig.monitor.hear_pedal(True)
    processes(rig, 10, "b")
    assert rig.gate is Gate.SHUT, "it is told to be down, and was never up"
    rig.monitor.hear_pedal(False)
    rig.monitor.hear_pedal(True)
    rig.monitor._burnt.clear()
    assert processes(rig, 10, "c").gate is Gate.OPEN


def test_a_pedal_has_to_be_pressed_anew_after_a_hold():
    rig = processes(with_pedal())
    assert reason(rig.monitor.hear_stranger(rig.now_ns))
    assert not rig.monitor.challenge(rig.now_ns).pedal
    rig.monitor.hear_pedal(True)
    assert processes(rig, 10, "b").gate is Gate.HELD
    rig.monitor.hear_pedal(False)
    rig.monitor.hear_pedal(True)
    assert processes(rig, 10, "c").gate is Gate.OPEN


def test_a_pedal_counts_only_while_its_console_is_heard():
    rig = with_pedal()
    rig.measures = False
    rig.tick(round(FRESH_NS / TICK) + 2)
    assert not rig.monitor.challenge(rig.now_ns).pedal


def test_what_is_burnt_is_remembered_among_many():
    rig = Rig()
    for k in range(BURNT + 10):
        rig.monitor.hold("", rig.now_ns, f"arming-{k}")
    assert len(rig.monitor._burnt) == BURNT
    assert f"arming-{BURNT + 9}" in rig.monitor._burnt


def test_presence_is_remembered_of_those_alone_who_are_present():
    rig = Rig()
    rig.beat("a")
    for _ in range(11):
        rig.wait(20 * MS)
    rig.beat("b", challenge=rig.asked)
    assert set(rig.monitor._present) == {"a", "b"}
    rig.wait(1)
    rig.beat("b")
    assert set(rig.monitor._present) == {"b"}


def test_a_foot_that_was_down_when_the_guard_began_does_not_count():
    rig = Rig(PEDAL)
    rig.monitor.hear_pedal(True)
    rig.monitor.hear_pedal(True)
    assert processes(rig, 10).gate is Gate.SHUT
    assert not rig.monitor.challenge(rig.now_ns).pedal
    rig.monitor.hear_pedal(False)
    rig.monitor.hear_pedal(True)
    assert rig.monitor.challenge(rig.now_ns).pedal


@pytest.mark.parametrize("away_ns", [FRESH_NS, FRESH_NS + 1])
@pytest.mark.parametrize("lost", ["joints", "jaw"])
@pytest.mark.parametrize("foot", [True, False])
def test_what_the_pedal_said_before_its_console_was_not_heard_does_not_count(away_ns, lost, foot):
    rig = with_pedal()
    rig.measure("joints", "jaw")
    if not foot:
        rig.monitor.hear_pedal(False)
    rig.wait(away_ns // 2, measured=({"joints", "jaw"} - {lost}))
    rig.wait(away_ns - away_ns // 2)
    if not foot:
        rig.monitor.hear_pedal(True)
    assert rig.monitor.challenge(rig.now_ns).pedal == (away_ns == FRESH_NS), "a release may have been lost meanwhile"
    rig.monitor.hear_pedal(False)
    rig.monitor.hear_pedal(True)
    assert rig.monitor.challenge(rig.now_ns).pedal, "a release and a press are both heard"


@pytest.mark.parametrize("first", ["joints", "jaw"])
def test_a_foot_that_came_before_the_arm_was_measured_does_not_count(first):
    monitor = Monitor(PEDAL)
    hears = {"joints": lambda: monitor.hear_joints(HERE[:-1], 1), "jaw": lambda: monitor.hear_jaw(HERE[-1:], 1)}
    monitor.challenge(1)
    hears.pop(first)()
    monitor.hear_pedal(False)
    monitor.hear_pedal(True)
    hears.popitem()[1]()
    assert not monitor.challenge(1).pedal


def test_presence_ends_however_little_the_clock_has_run():
    monitor = Monitor(ROBOT)
    monitor.challenge(1)
    asked = monitor.challenge(110 * MS).challenge
    for arming, at_ns in (("early", 200 * MS), ("a", 325 * MS)):
        monitor.hear_heartbeat("psm1", arming, asked, True, at_ns)
    newest = monitor.challenge(326 * MS).challenge
    monitor.hear_joints(HERE[:-1], 326 * MS)
    monitor.hear_jaw(HERE[-1:], 326 * MS)
    said = SetPoint(1, newest, "a", HERE)
    assert monitor.hear_set_point(SetPoint(1, asked, "a", HERE), 330 * MS) == [], "too old"
    assert monitor.hear_set_point(said, 110 * MS + PRESENCE_NS + 1) == []
    assert passed(monitor.hear_set_point(said, 110 * MS + PRESENCE_NS))
    monitor.hear_heartbeat("psm1", "b", newest, True, 110 * MS + PRESENCE_NS + 1)
    assert set(monitor._present) == {"b"}


def test_a_motion_that_sends_nothing_any_more_is_held_however_little_the_clock_has_run():
    rig = Rig(start_ns=10 * MS).moves(8)
    assert passed(rig.say())
    rig.wait(rig.now_ns, "a")
    assert reason(rig.turn()) == "set points have ended, and not as a motion should"


@pytest.mark.parametrize("way_ms", [150, 390])
@pytest.mark.parametrize("start_ns", [10 * MS, 10**12])
def test_where_answers_come_too_late_for_a_motion_to_begin_the_hold_says_by_how_much(way_ms, start_ns):
    rig = Rig(start_ns=start_ns)
    rig.wait(0)
    asked = rig.asked
    for _ in range(way_ms // 5):
        rig.tick()
        rig.say()
    assert rig.held[0] == "set points come and nobody stands by"
    said = len(rig.held)
    for other in ("another", "A", ""):
        rig.beat(other, challenge=asked)
    rig.beat("a", challenge=asked, arm="psm2")
    assert len(rig.held) == said
    for again in ("xa", "yxa"):
        rig.beat(again.lstrip("xy"), challenge=asked)
    late = f"the operator's answers take {way_ms} ms to the guard, and 100 ms are allowed"
    assert rig.held[said:] == [late], "once"
    told = rig.monitor.challenge(rig.now_ns)
    assert (told.gate, told.arming_id, told.reason) == (Gate.HELD, "a", late)


def test_where_answers_begin_to_come_too_late_in_a_motion_the_hold_says_so_too(moving):
    asked, issued_ns = moving.asked, moving.now_ns
    moving.wait(60 * MS)
    moving.say()
    for at_ns in (100 * MS, 180 * MS):
        moving.wait(issued_ns + at_ns - moving.now_ns)
        moving.say()
    moving.wait(issued_ns + PRESENCE_NS + 1 - moving.now_ns)
    assert reason(moving.turn()) == "nobody stands by any more"
    assert moving.monitor.hear_heartbeat("psm1", "a", moving.asked, True, moving.now_ns) == []
    moving.now_ns = issued_ns + PRESENCE_NS + 80 * MS
    (told,) = moving.monitor.hear_heartbeat("psm1", "a", asked, True, moving.now_ns)
    assert told.reason == "the operator's answers take 300 ms to the guard, and 220 ms are allowed"


def test_an_answer_that_is_as_old_as_it_may_be_is_not_late():
    rig = Rig()
    rig.wait(0)
    asked, issued_ns = rig.asked, rig.now_ns
    rig.say()
    rig.wait(GRACE_NS + 1)
    assert reason(rig.say()) == "set points come and nobody stands by"
    for at_ns, told in ((GRACE_NS, False), (GRACE_NS + 1, True)):
        heard = rig.monitor.hear_heartbeat("psm1", "a", asked, True, issued_ns + at_ns)
        assert bool(heard) == told


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
    assert rig.monitor.challenge(rig.now_ns).round_trip_ms == UNKNOWN_MS, "so that no bridge arms now"
    rig.now_ns = began_ns + SETTLES_NS + 1
    for _ in range(100):
        rig.tick(1, "a")
        assert passed(rig.say()) == []
    assert passed(rig.moves(20, "b").actions)


def test_a_guard_that_has_settled_passes_what_begins_then():
    rig = Rig(settles=False)
    rig.now_ns = rig.now_ns - rig.now_ns // TICK % 4 * TICK + SETTLES_NS + 1
    rig.wait(0, "a")
    rig.monitor.hear_alive(Alive(1, rig.asked), rig.now_ns)
    assert rig.monitor.challenge(rig.now_ns).round_trip_ms == 0.0
    assert passed(rig.say()) == [HERE]


def test_before_its_first_challenge_a_guard_lets_nothing_pass():
    monitor = Monitor(ROBOT)
    assert reason(monitor.hear_set_point(SetPoint(1, 0, "a", HERE), 10**12))
    monitor.hear_heartbeat("psm1", "b", 0, True, 10**12)
    assert {"a", "b"} <= set(monitor._burnt)


def test_a_challenge_of_another_run_counts_for_nothing():
    before, now = Rig(), Rig()
    for _ in range(10):
        now.tick()
        now.beat("a", challenge=before.asked)
        assert now.say(challenge=before.asked) == []
    assert now.monitor._present == {}
    assert now.gate is Gate.SHUT


STARTS_NS = [10 * MS, 2**40 - 123_456_789]
"""Of clocks: soon after a start, and across a power of two."""


@pytest.fixture(params=STARTS_NS)
def moving(request):
    """A rig in motion whose clock began at one of the times."""
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


def test_presence_ends_to_the_nanosecond(moving):
    moving.wait(PRESENCE_NS - 2)
    moving.wait(0)
    issued_ns = moving.now_ns - (PRESENCE_NS - 2)
    moving.monitor._passed_ns = moving.now_ns
    for at_ns, held in ((issued_ns + PRESENCE_NS, False), (issued_ns + PRESENCE_NS + 1, True)):
        moving.now_ns = at_ns
        assert bool(moving.turn()) == held


@pytest.mark.parametrize("start_ns", STARTS_NS)
def test_the_first_answer_is_awaited_to_the_nanosecond(start_ns):
    rig = Rig(start_ns=start_ns)
    assert rig.say() == []
    rig.wait(GRACE_NS)
    assert rig.say() == []
    assert rig.say(arming="b") == [], "another one's time begins anew"
    rig.wait(GRACE_NS)
    assert rig.say(arming="b") == []
    rig.wait(1)
    assert reason(rig.say(arming="b")) == "set points come and nobody stands by"


def test_set_points_may_be_away_for_so_many_nanoseconds(moving):
    moving.wait(GONE_NS, "a")
    assert moving.turn() == []
    moving.wait(1, "a")
    assert reason(moving.turn()) == "set points have ended, and not as a motion should"


@pytest.mark.parametrize(("seen", "old"), [("joints", "jaw"), ("jaw", "joints")])
def test_a_measurement_is_fresh_to_the_nanosecond(moving, seen, old):
    moving.wait(FRESH_NS, "a", measured=(seen,))
    assert passed(moving.say()) == [HERE]
    assert moving.turn() == []
    moving.wait(1, "a", measured=(seen,))
    assert reason(moving.turn()) == "the arm's joints or jaw are not measured any more"
    moving.measure(old)
    moving.wait(1, "b")
    assert passed(moving.say(arming="b")) == [HERE]


def test_an_unmeasured_arm_is_held_again_to_the_nanosecond(just_held):
    just_held.now_ns += AGAIN_NS - 1
    assert just_held.turn() == []
    just_held.now_ns += 1
    just_held.monitor._measured[1] = (), -math.inf
    assert reason(just_held.turn()) == "a set point has axis 1 at nan, outside -1.5 to 1.5"
    assert just_held.turn() == []


@pytest.mark.parametrize(("after_ns", "held"), [(HOLDS_NS, True), (HOLDS_NS + 1, False)])
def test_an_unmeasured_arm_is_held_for_so_long_alone(just_held, after_ns, held):
    just_held.now_ns += after_ns
    assert bool(just_held.turn()) == held


@pytest.mark.parametrize("axis", [None, 0, 1, 2])
@pytest.mark.parametrize("moved", [2.1e-3, -2.1e-3])
def test_an_arm_stands_that_has_not_moved_since_its_hold_was_said(just_held, axis, moved):
    for k in range(1, 4):
        if axis is not None:
            just_held.place = tuple(at + k * moved * (index == axis) for index, at in enumerate(HERE))
        just_held.now_ns += AGAIN_NS - 1
        just_held.measure("joints", "jaw")
        assert just_held.turn() == []
        just_held.now_ns += 1
        assert bool(just_held.turn()) == (axis is not None)
    just_held.now_ns += AGAIN_NS
    just_held.measure("joints", "jaw")
    assert just_held.turn() == []


def test_an_arm_that_creeps_does_not_stand(just_held):
    for k in range(1, 4):
        just_held.place = (HERE[0] + 0.9e-3 * k, *HERE[1:])
        just_held.now_ns += AGAIN_NS
        just_held.measure("joints", "jaw")
        assert bool(just_held.turn()) == (k == 3)


@pytest.mark.parametrize("begins", [True, False])
def test_an_arm_that_was_not_measured_at_its_hold_or_is_not_now_is_not_known_to_stand(just_held, begins):
    if begins:
        just_held.monitor._measured[1] = (), -math.inf
        assert just_held.monitor.hold("again", just_held.now_ns)
    just_held.now_ns += FRESH_NS + 1
    if begins:
        just_held.measure("joints", "jaw")
    assert just_held.turn()


def test_a_hair_is_no_movement():
    rig = Rig()
    rig.place = (0.0, 0.1, 0.2)
    rig.moves()
    rig.tick(1, "a")
    assert reason(rig.say((math.nan, 0.0, 0.0)))
    rig.place = (STANDS, 0.1, 0.2)
    rig.now_ns += AGAIN_NS
    rig.measure("joints", "jaw")
    assert rig.turn() == []


@pytest.mark.parametrize(("age_ns", "known"), [(REMEMBERED_NS, True), (REMEMBERED_NS + 1, False)])
@pytest.mark.parametrize("start_ns", STARTS_NS)
def test_a_challenge_is_remembered_to_the_nanosecond(start_ns, age_ns, known):
    rig = Rig(start_ns=start_ns)
    rig.wait(0)
    rig.wait(MS)
    old = rig.asked
    rig.wait(age_ns)
    rig.monitor.hear_alive(Alive(1, old), rig.now_ns)
    assert (rig.monitor.challenge(rig.now_ns).round_trip_ms != UNKNOWN_MS) == known


def test_as_many_set_points_as_a_bridge_sends_in_a_burst_may_come_at_once(moving):
    moving.wait(50 * MS, "a")
    found = [bool(passed(moving.say())) for _ in range(19)]
    assert found == [True] * 18 + [False], "1.5 times 200 a second for 60 ms"


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
    ahead = [0.25 + 1e-6 if k == axis else 0.0 for k in range(3)]
    assert reason(rig.say(ahead)) == f"a set point has axis {axis + 1} 0.25 from where it is measured"


def test_a_step_of_exactly_the_burst_may_come():
    rig = Rig()
    rig.place = (0.0, 0.1, 0.2)
    rig.moves()
    rig.wait(50 * MS, "a")
    assert passed(rig.say((BURST_S, 0.1, 0.2)))


def test_travel_that_was_used_comes_back_with_time(moving):
    for share in (1, 2):
        moving.wait(80 * MS, "a")
        there = (HERE[0] + 0.99 * share * BURST_S, *HERE[1:])
        assert passed(moving.say(there)) == [there]


def test_an_arm_of_one_joint_and_a_jaw_is_one_too():
    rig = Rig(ROBOT._replace(axes=AXES[:2]))
    rig.place = HERE[:2]
    assert passed(rig.moves().actions)


def test_ids_are_the_same_where_they_read_the_same():
    made = iter(range(100_000))
    rig = Rig()

    def again(text):
        return (f"{next(made)}{text}").lstrip("0123456789")

    for _ in range(20):
        rig.tick()
        rig.beat(again("arming"), arm=again("psm") + "1")
        rig.say(arming=again("arming"))
    assert len(passed(rig.actions)) >= 17
    rig.monitor.hear_alive(Alive(99, rig.asked, again("arming"), ended=True), rig.now_ns)
    assert rig.gate is Gate.SHUT


def test_a_pedal_that_is_told_again_to_be_down_changes_nothing():
    rig = processes(with_pedal())
    rig.monitor.hear_pedal(True)
    assert passed(rig.say())
    processes(rig)
    assert rig.gate is Gate.OPEN


def test_a_pedal_that_the_description_does_not_name_ends_nothing():
    rig = Rig().moves()
    rig.monitor.hear_pedal(False)
    assert passed(rig.say())


def test_who_sends_set_points_after_a_motion_has_ended_as_it_should_is_not_paused():
    rig = Rig().moves()
    rig.monitor.hear_alive(Alive(99, rig.asked, "a", ended=True), rig.now_ns)
    assert rig.monitor.hear_stranger(rig.now_ns + 10 * OBEYS_NS) == []


def test_an_arm_that_was_paused_once_is_paused_again_after_its_next_hold():
    rig = Rig()
    for arming in ("a", "b"):
        rig.moves(arming=arming)
        rig.monitor.hear_stranger(rig.now_ns)
        rig.tick(21)
        assert [action.kind for action in rig.monitor.hear_stranger(rig.now_ns)] == [Kind.PAUSE]


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(-3, 3), st.integers(0, 40), st.booleans()), max_size=60))
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


def document(**other):
    return {"arm": "psm1", "console": "PSM1", "axes": [[0, 1, 1]] * 2, "rate_hz": 200, "pedal": False} | other


@pytest.mark.parametrize(
    "document",
    [
        {},
        document(axes=[[0, 1, 1]]),
        document(axes=[[1, 0, 1]] * 2),
        document(axes=[[0, 1, 0]] * 2),
        document(axes=[[0, 1, math.inf]] * 2),
        document(rate_hz=0),
        document(rate_hz=19.9),
        document(rate_hz=1001),
        document(axes=[[0, 1]] * 2),
        document(axes=[[1, 1, 1]] * 2),
        document(axes=[[0, 1, -1]] * 2),
        document(axes=[[0, 1, math.nan]] * 2),
        document(axes=[[0, math.nan, 1]] * 2),
        document(axes=[]),
        document(axes=5),
        document(rate_hz=-1),
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
    document = {"arm": "psm1", "console": "PSM1", "axes": axes, "rate_hz": 200.0, "pedal": True}
    assert Description.from_document(document) == PEDAL


@pytest.mark.parametrize("other", [{"rate_hz": 20}, {"rate_hz": 1000}, {"axes": [[0, 1, 0.5]] * 2}])
def test_a_description_of_an_unusual_arm_is_taken(other):
    assert Description.from_document(document(**other)).rate_hz == other.get("rate_hz", 200)
