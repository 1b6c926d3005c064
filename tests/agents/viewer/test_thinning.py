import pytest

from agents.viewer.entity import IN_A_FULL_MACHINE, MOST_PER_SECOND, Thinning
from schemas.topics import FRAMES, PLAN, ROBOT_STATE, THREAD

SECOND = 1_000_000_000
START = 1_760_000_000 * SECOND


def kept(thinning, topic, key, rate_hz, seconds=2):
    times = [START + SECOND * k // rate_hz for k in range(seconds * rate_hz)]
    return [at for at in times if thinning.keeps(topic, key, at)]


@pytest.mark.parametrize("topic", MOST_PER_SECOND, ids=str)
def test_no_more_a_second_are_shown_than_promised_and_a_slow_topic_whole(topic):
    assert len(kept(Thinning(), topic, "key", 100)) == 2 * MOST_PER_SECOND[topic]
    assert len(kept(Thinning(), topic, "key", 1)) == 2


def test_events_are_never_thinned_nor_is_time_that_jumps_back():
    thinning = Thinning()
    assert len(kept(thinning, PLAN, "plan", 100)) == 200
    assert thinning.keeps(ROBOT_STATE, "key", START)
    assert thinning.keeps(ROBOT_STATE, "key", START - SECOND)


def test_arms_are_thinned_apart_and_what_descends_from_one_frame_keeps_the_same_frames():
    thinning = Thinning()
    assert kept(thinning, ROBOT_STATE, "psm1", 100) == kept(thinning, ROBOT_STATE, "psm2", 100)
    assert kept(thinning, FRAMES, "frames", 30) == kept(thinning, THREAD, "thread", 30)


def test_where_there_is_no_room_fewer_frames_are_kept_and_the_same_of_all_that_descends_from_them():
    thinning = Thinning()
    thinning.there_is_room = False
    frames = kept(thinning, FRAMES, "frames", 30)
    assert len(frames) == 2 * IN_A_FULL_MACHINE
    assert frames == kept(thinning, THREAD, "thread", 30)
    assert len(kept(thinning, ROBOT_STATE, "psm1", 100)) == 2 * MOST_PER_SECOND[ROBOT_STATE]
