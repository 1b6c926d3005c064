"""Samples that wait until somebody wants to know: none is lost or looked at twice, and none waits that may not."""

import threading

from hypothesis import given
from hypothesis import strategies as st

from shared.runtime.delivery import MOST, Unlooked


class Seen:
    """What was looked at, and where the ring was seen empty between, as None."""

    def __init__(self):
        self.found, self.at_once = [], False
        self.unlooked = Unlooked(self._look_at, lambda: self.found.append(None), lambda: self.at_once)

    def _look_at(self, sample, came_s):
        assert came_s > 0
        self.found.append(sample)


@given(st.lists(st.integers() | st.none() | st.just("look"), max_size=3 * MOST))
def test_all_is_looked_at_once_in_its_order(told):
    seen = Seen()
    for one in told:
        if one == "look":
            seen.unlooked.look()
        else:
            seen.unlooked.put(one)
    seen.unlooked.look()
    assert seen.found == [one for one in told if one != "look"]


def test_nothing_is_looked_at_before_anybody_wants_to_know_but_what_would_be_too_much():
    seen = Seen()
    for number in range(MOST - 1):
        seen.unlooked.put(number)
    assert seen.found == []
    seen.unlooked.put(MOST - 1)
    assert seen.found == list(range(MOST))


def test_what_may_not_wait_takes_along_what_has_waited():
    seen = Seen()
    seen.unlooked.put("before")
    seen.at_once = True
    seen.unlooked.put("now")
    assert seen.found == ["before", "now"]


def test_two_that_look_at_a_time_look_at_each_once_in_order():
    seen, ended = Seen(), threading.Event()

    def look():
        while not ended.is_set():
            seen.unlooked.look()

    lookers = [threading.Thread(target=look) for _ in range(2)]
    for thread in lookers:
        thread.start()
    for number in range(2000):
        seen.unlooked.put(number)
    ended.set()
    for thread in lookers:
        thread.join()
    seen.unlooked.look()
    assert seen.found == list(range(2000))
