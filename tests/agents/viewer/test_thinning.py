import pytest

from agents.viewer.thinning import IN_A_FULL_MACHINE, MOST_PER_SECOND, Thinning
from schemas.topics import EXECUTION, FRAMES, PLAN, ROBOT_STATE, THREAD

SECOND = 1_000_000_000
START = 1_760_000_000 * SECOND


def kept(thinning, topic, key, rate_hz, seconds=2):
    times = [START + SECOND * k // rate_hz for k in range(seconds * rate_hz)]
    return [at for at in times if thinning.keeps(topic, key, at)]


@pytest.mark.parametrize("topic", MOST_PER_SECOND, ids=str)
@pytest.mark.parametrize("rate_hz", [30, 100, 1000])
def test_no_more_a_second_are_shown_than_promised(topic, rate_hz):
    assert len(kept(Thinning(), topic, "key", rate_hz)) == 2 * MOST_PER_SECOND[topic]


def test_a_slow_topic_is_shown_whole():
    assert len(kept(Thinning(), ROBOT_STATE, "key", 5)) == 10


@pytest.mark.parametrize("topic", [PLAN, EXECUTION], ids=str)
def test_events_are_never_thinned(topic):
    assert len(kept(Thinning(), topic, "key", 1000)) == 2000


def test_what_descends_from_one_frame_keeps_the_same_frames():
    thinning = Thinning()
    assert kept(thinning, FRAMES, "frames", 30) == kept(thinning, THREAD, "thread", 30)


def test_arms_are_thinned_apart():
    thinning = Thinning()
    assert kept(thinning, ROBOT_STATE, "psm1", 100) == kept(thinning, ROBOT_STATE, "psm2", 100)


def test_time_that_jumps_back_is_shown():
    thinning = Thinning()
    assert thinning.keeps(ROBOT_STATE, "key", START)
    assert thinning.keeps(ROBOT_STATE, "key", START - SECOND)


def test_fewer_frames_are_kept_where_there_is_no_room_and_the_same_of_all_that_descends_from_them():
    thinning = Thinning()
    thinning.there_is_room = False
    frames = kept(thinning, FRAMES, "frames", 30)
    assert len(frames) == 2 * IN_A_FULL_MACHINE
    assert frames == kept(thinning, THREAD, "thread", 30)
    assert len(kept(thinning, ROBOT_STATE, "psm1", 100)) == 2 * MOST_PER_SECOND[ROBOT_STATE]
    thinning.there_is_room = True
    assert len(kept(thinning, FRAMES, "more frames", 30)) == 2 * MOST_PER_SECOND[FRAMES]
