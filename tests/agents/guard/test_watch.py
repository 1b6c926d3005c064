"""What the guard does about an arm, turn by turn."""

from agents.guard.watch import Action, Heard, Watch

MS = 10**6
START = 10**18


def told(turns):
    """Each is (ms, ms since a set point, since a heartbeat, since the bridge's state, whether it moves)."""
    watch, found = Watch(), []
    for at_ms, point, beat, state, moving in turns:
        now = START + at_ms * MS
        heard = Heard(now - point * MS, now - beat * MS, now - state * MS, moving)
        if following := watch.turn(heard, now):
            found.append((at_ms, following[0]))
    return found


def test_a_motion_that_somebody_stands_by_is_left_alone_and_so_is_its_end():
    going = [(t, 5, t % 50, 10, True) for t in range(0, 1000, 10)]
    ending = [(1000 + t, 5 + t, 20 + t, 10, False) for t in range(0, 2000, 10)]
    assert told(going + ending) == []


def test_a_bridge_that_falls_silent_is_followed_by_one_hold():
    going = [(t, 5, 20, 10, True) for t in range(0, 100, 10)]
    gone = [(100 + t, 5 + t, 20, 10 + t, True) for t in range(0, 2000, 10)]
    assert told(going + gone) == [(250, Action.HOLD)]


def test_set_points_that_nobody_stands_by_are_held_and_then_paused_once():
    runaway = [(t, 2, 20 + t, 10, True) for t in range(0, 1000, 10)]
    assert told(runaway) == [(210, Action.HOLD), (320, Action.PAUSE)]


def test_an_arm_that_is_held_is_guarded_again_when_somebody_stands_by():
    runaway = [(t, 2, 300, 10, True) for t in range(0, 200, 10)]
    again = [(500 + t, 2, 20, 10, True) for t in range(0, 50, 10)]
    gone = [(600 + t, 50 + t, 20, 50 + t, True) for t in range(0, 300, 10)]
    assert [action for _, action in told(runaway + again + gone)] == [Action.HOLD, Action.HOLD]


def test_an_arm_that_never_moved_is_left_alone():
    assert told([(t, 10**6, 10**6, 10**6, False) for t in range(0, 1000, 10)]) == []
