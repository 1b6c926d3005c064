"""What the guard does about an arm, turn by turn, and which set points it lets through."""

from agents.guard.gate import Gate
from agents.guard.watch import Action, Heard, Watch

MS = 10**6
START = 10**18


def told(turns):
    """Each is (ms, ms since a set point, since a heartbeat, since the bridge said that its motion is over)."""
    watch, found = Watch(), []
    for at_ms, point, beat, over in turns:
        now = START + at_ms * MS
        if following := watch.turn(Heard(now - point * MS, now - beat * MS, now - over * MS), now):
            found.append((at_ms, following[0]))
    return found


def test_a_motion_that_somebody_stands_by_is_left_alone_and_so_is_its_end():
    going = [(t, 5, t % 50, 5000) for t in range(0, 1000, 10)]
    ending = [(1000 + t, 15 + t, 20 + t, 5) for t in range(0, 2000, 10)]
    assert told(going + ending) == []


def test_set_points_that_end_as_no_motion_should_are_followed_by_one_hold():
    going = [(t, 5, 20, 5000) for t in range(0, 100, 10)]
    gone = [(100 + t, 5 + t, 20, 5000) for t in range(0, 2000, 10)]
    assert told(going + gone) == [(200, Action.HOLD)]


def test_set_points_that_nobody_stands_by_are_held_and_then_paused_once():
    runaway = [(t, 2, 20 + t, 5000) for t in range(0, 1000, 10)]
    assert told(runaway) == [(210, Action.HOLD), (320, Action.PAUSE)]


def test_an_arm_that_is_held_is_guarded_again_when_somebody_stands_by():
    runaway = [(t, 2, 300, 5000) for t in range(0, 200, 10)]
    again = [(500 + t, 2, 20, 5000) for t in range(0, 50, 10)]
    gone = [(600 + t, 50 + t, 20, 5000) for t in range(0, 300, 10)]
    assert [action for _, action in told(runaway + again + gone)] == [Action.HOLD, Action.HOLD]


def test_somebody_elses_set_point_in_mid_motion_is_followed_by_a_hold():
    watch = Watch()
    assert watch.turn(Heard(START, START, 0, 0), START) is None
    following = watch.turn(Heard(START, START, 0, START), START + MS)
    assert following is not None
    assert following[0] is Action.HOLD


def test_an_arm_that_never_moved_is_left_alone():
    assert told([(t, 10**6, 10**6, 10**6) for t in range(0, 1000, 10)]) == []


def test_what_a_link_kept_back_goes_no_further_and_what_is_fresh_does():
    gate, ahead = Gate(), 77 * 10**12
    assert not gate.passes(START + ahead, START + MS), "nothing is known of the link yet"
    for t in range(0, 1200, 100):
        gate.alive(START + ahead + t * MS, START + (t + 2) * MS)
    sent = [1200 + 5 * i for i in range(100)]
    came = [t + 2 if t < 1300 else max(t + 2, 1600) for t in sent]
    passed = [t for t, at in zip(sent, came, strict=True) if gate.passes(START + ahead + t * MS, START + at * MS)]
    assert passed == [t for t in sent if t < 1300 or t >= 1600 - 2 - 50]
    assert not gate.passes(START + ahead + 1300 * MS, START + 1301 * MS), "it was overtaken"


def test_of_a_motion_that_was_held_nothing_goes_further_however_fresh_and_the_next_motion_does():
    gate = Gate()
    for t in range(0, 1200, 100):
        gate.alive(START + t * MS, START + (t + 2) * MS)
    assert gate.passes(START + 1200 * MS, START + 1202 * MS)
    gate.shut()
    kept = [t for t in range(1205, 1400, 5) if gate.passes(START + t * MS, START + max(t + 2, 1330) * MS)]
    assert kept == []
    assert gate.passes(START + 1600 * MS, START + 1602 * MS)
    assert gate.passes(START + 1605 * MS, START + 1607 * MS)


def test_a_link_that_had_kept_what_first_came_is_not_believed():
    gate = Gate()
    stamps = list(range(0, 400, 5))
    gate.alive(START, START + 3000 * MS)
    assert not any(gate.passes(START + t * MS, START + (3000 + i) * MS) for i, t in enumerate(stamps))
