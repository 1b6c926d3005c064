import threading

from agents.viewer.backlog import Backlog


def drained(backlog):
    backlog.close()
    return list(iter(backlog.take, None))


def test_items_come_out_in_the_order_in_which_they_came_in_whatever_their_lane():
    backlog = Backlog()
    for number in range(6):
        backlog.put("even" if number % 2 == 0 else "odd", number, 10, "all")
    assert drained(backlog) == [0, 1, 2, 3, 4, 5]


def test_the_oldest_of_a_full_lane_gives_way_and_is_counted():
    backlog = Backlog()
    for number in range(10):
        backlog.put("lane", number, 3, "robot_bridge/state")
    assert backlog.dropped() == {"robot_bridge/state": 7}
    assert drained(backlog) == [7, 8, 9]


def test_a_flood_of_one_lane_pushes_nothing_out_of_another():
    backlog = Backlog()
    backlog.put("calm", "plan", 3, "plan")
    for _ in range(1000):
        backlog.put("flood", "state", 3, "state")
    assert drained(backlog)[0] == "plan"
    assert backlog.dropped() == {"state": 997}


def test_what_comes_after_the_end_is_dropped():
    backlog = Backlog()
    backlog.close()
    backlog.put("lane", "late", 3, "late")
    assert backlog.take() is None
    assert backlog.dropped() == {"late": 1}


def test_taking_waits_for_the_next_item_and_for_the_end():
    backlog, taken = Backlog(), []
    reader = threading.Thread(target=lambda: taken.extend(iter(backlog.take, None)), daemon=True)
    reader.start()
    backlog.put("lane", 1, 3, "lane")
    backlog.put("lane", 2, 3, "lane")
    backlog.close()
    reader.join(60)
    assert taken == [1, 2]


def test_what_is_abandoned_is_not_handed_out():
    backlog = Backlog()
    backlog.put("lane", 1, 3, "lane")
    backlog.abandon()
    assert backlog.take() is None
