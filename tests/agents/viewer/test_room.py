from agents.viewer.live import Room


def judged(room, share, seconds):
    """Whether there is room after so many seconds of work, in messages of 10 ms each."""
    for _ in range(round(100 * seconds)):
        room.worked(0.01 * share, 0.01)
    return room.there_is


def test_a_machine_is_full_where_its_processor_is_waited_for_and_a_little_waiting_changes_nothing():
    room = Room()
    assert judged(room, 1.0, 3)
    assert judged(room, 0.7, 3)
    assert not judged(room, 0.4, 3)
    assert not judged(room, 0.7, 3)
    assert judged(room, 0.95, 3)


def test_a_single_slow_message_is_not_enough_and_a_change_is_told_once():
    room = Room()
    assert not room.worked(0.01, 0.4)
    assert room.there_is
    told = [room.worked(0.001, 0.01) for _ in range(500)]
    assert sum(told) == 1
