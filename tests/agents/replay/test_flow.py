"""A fast replay waits until all has followed from what it sent, and for nothing else."""

from agents.replay.flow import Awaited, awaited_of
from schemas.messages import Consumed, Progress
from schemas.topics import FRAMES, OBSERVATIONS, ROBOT_STATE, THREAD, key

FRAME, SEEN, CURVE = (key("test", topic) for topic in (FRAMES, OBSERVATIONS, THREAD))
STATE, OTHER = key("test", ROBOT_STATE, "psm1"), key("test", ROBOT_STATE, "psm2")
EPOCH, THEIRS = 1, 2


def said(perception=4, seen=9, reconstruction=9, curves=5, planner=5):
    return {
        "perception/main": Progress(FRAME, (Consumed(FRAME, EPOCH, perception),), (Consumed(SEEN, THEIRS, seen),)),
        "reconstruction/main": Progress(
            SEEN, (Consumed(SEEN, THEIRS, reconstruction),), (Consumed(CURVE, THEIRS, curves),)
        ),
        "planner/main": Progress(CURVE, (Consumed(CURVE, THEIRS, planner),), ()),
    }


def test_all_is_settled_when_the_last_consumer_of_what_followed_is_done():
    assert awaited_of(said(), {FRAME: 4}, EPOCH, {}) is None


def test_each_stage_is_waited_for():
    assert awaited_of(said(perception=3), {FRAME: 4}, EPOCH, {}) == Awaited("perception/main", FRAME, 4)
    assert awaited_of(said(reconstruction=8), {FRAME: 4}, EPOCH, {}) == Awaited("reconstruction/main", SEEN, 9)
    assert awaited_of(said(planner=4), {FRAME: 4}, EPOCH, {}) == Awaited("planner/main", CURVE, 5)
    # the same number of another run is another message
    assert awaited_of(said(), {FRAME: 4}, EPOCH + 5, {}) == Awaited("perception/main", FRAME, 4)


def test_what_was_published_before_need_not_have_been_heard():
    assert awaited_of(said(planner=2), {}, EPOCH, {(CURVE, THEIRS): 5}) is None
    assert awaited_of(said(planner=2), {}, EPOCH, {(CURVE, THEIRS): 4}) == Awaited("planner/main", CURVE, 5)


def test_only_those_who_listen_to_a_key_are_waited_for():
    everyones = {"planner/main": Progress(key("test", ROBOT_STATE, "*"), (), ())}
    own = {"simulator/main": Progress(STATE, (), ())}
    assert awaited_of(everyones, {OTHER: 0}, EPOCH, {}) == Awaited("planner/main", OTHER, 0)
    assert awaited_of(own, {OTHER: 0}, EPOCH, {}) is None
    assert awaited_of({}, {OTHER: 0}, EPOCH, {}) is None
