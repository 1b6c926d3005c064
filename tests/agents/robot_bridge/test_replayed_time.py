"""A real arm does not live in the time of a recording; a simulated one may."""

import pytest

from agents.robot_bridge.refusals import Code
from schemas.messages import ExecutionKind, ReplayClock
from schemas.topics import REPLAY_CLOCK
from tests.agents.robot_bridge.drive import EPOCH, SECOND, Drive, UnreliableArm, plan, stands_still


class OwesRealTime(UnreliableArm):
    """Behaves as a simulated arm, and owes what a real one owes."""

    accepts_replayed_time = False


def replays(drive):
    drive.hear(REPLAY_CLOCK, ReplayClock(EPOCH - 3600 * SECOND, 1.0))


def ticks(drive, seconds):
    for _ in range(round(100 * seconds)):
        drive.tick()


def test_a_real_arm_is_not_armed_while_a_recording_is_replayed_and_is_once_that_is_over():
    drive = Drive(backend=OwesRealTime())
    drive.publish(plan())
    replays(drive)
    refused = drive.arm()
    assert (refused.code, "a recording is replayed" in refused.reason) == (Code.REPLAY, True)
    drive.publish(plan("p2"))
    ticks(drive, 2.1)
    assert drive.arm("p2").code == Code.REPLAY, "a plan that came during a replay may be of the recording"
    assert drive.arm().code == ""


def test_a_real_arm_that_moves_holds_when_a_replay_begins():
    drive = Drive(backend=OwesRealTime()).armed()
    drive.run(20)
    replays(drive)
    assert drive.ended == (ExecutionKind.HELD, Code.REPLAY)
    assert stands_still(drive)


def test_a_simulated_arm_listens_to_no_replay_clock_since_its_ticks_are_in_that_time_already():
    simulated, real = (Drive(backend=arm()).bridge for arm in (UnreliableArm, OwesRealTime))
    assert (simulated.accepts_replayed_time, real.accepts_replayed_time) == (True, False)
    assert REPLAY_CLOCK not in [i.topic for i in simulated.inputs]
    assert REPLAY_CLOCK in [i.topic for i in real.inputs]


@pytest.mark.parametrize("jump_s", [3600, -3600])
def test_an_arm_holds_where_a_replay_ends_or_begins_under_it(jump_s):
    drive = Drive().armed()
    drive.run(20)
    drive.tick(jump_s * SECOND)
    assert drive.events[-1].kind is ExecutionKind.HELD
    assert drive.events[-1].reason
