import threading

from agents.viewer.screen import Backlog


def drained(backlog):
    backlog.close()
    return list(iter(backlog.take, None))


def test_whoever_takes_waits_for_items_in_the_order_in_which_they_came_whatever_their_lane_until_the_end():
    backlog, taken = Backlog(), []
    reader = threading.Thread(target=lambda: taken.extend(iter(backlog.take, None)), daemon=True)
    reader.start()
    for number in range(6):
        backlog.put("even" if number % 2 == 0 else "odd", number, 10, "all")
    backlog.close()
    reader.join(60)
    assert taken == [0, 1, 2, 3, 4, 5]


def test_the_oldest_of_a_full_lane_gives_way_and_is_counted_and_other_lanes_keep_theirs():
    backlog = Backlog()
    backlog.put("calm", "plan", 3, "plan")
    for number in range(10):
        backlog.put("flood", number, 3, "robot_bridge/state")
    assert backlog.dropped() == {"robot_bridge/state": 7}
    assert drained(backlog) == ["plan", 7, 8, 9]


def test_what_comes_after_the_end_is_dropped_and_what_was_abandoned_is_not_handed_out():
    backlog = Backlog()
    backlog.put("lane", "abandoned", 3, "early")
    backlog.abandon()
    backlog.put("lane", "late", 3, "late")
    assert backlog.take() is None
    assert backlog.dropped() == {"late": 1}
