"""No blind motion: frames by the bridge's own clock, an absolute cap, and long motions as chains of segments."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from agents.robot_bridge.agent import RobotBridgeConfig
from agents.robot_bridge.arm_status import Challenges, Sight
from agents.robot_bridge.limits import MotionLimits
from schemas.messages import ChallengeEcho, ExecutionKind, FrameStamp
from tests.agents.robot_bridge.drive import (
    BEAT_TICKS,
    EPOCH,
    SECOND,
    TICK,
    WAYPOINTS,
    Drive,
    plan,
    rejected,
    stands_still,
)

HELD = ExecutionKind.HELD


def seen(**config) -> Drive:
    """A bridge whose camera tells of frames as they are taken."""
    return Drive(RobotBridgeConfig(**config), camera=0)


def test_a_motion_goes_on_while_the_camera_is_seen_to_run_and_holds_within_the_limit_once_it_freezes():
    drive = seen(maximum_frame_age_s=0.5).armed().run(150)
    assert drive.bridge.executes
    assert drive.states[-1].maximum_frame_age_s == 0.5
    drive.camera = None
    last_ns = drive.now_ns
    drive.run(80)
    assert drive.ended == (HELD, "frame_age")
    assert "0.5 s are allowed" in drive.events[-1].reason
    assert drive.events[-1].at_ns - last_ns <= 0.5 * SECOND + BEAT_TICKS * TICK
    assert stands_still(drive, 5)
    assert drive.arm().code == "frame_age"


def test_a_queue_that_is_as_long_all_the_time_cannot_pass_for_a_fresh_camera():
    drive = seen().armed().run(100)
    # frames come at their rate, and each was taken 0.6 s ago, whatever their own clock says
    drive.camera = 60
    assert drive.run(30).ended == (HELD, "frame_age")


def stamp(captured_ns: int, *echoes: ChallengeEcho) -> FrameStamp:
    return FrameStamp(1, captured_ns, captured_ns, "c", echoes)


@pytest.mark.parametrize(
    ("stamp", "is_real", "why"),
    [
        (None, True, "no camera has told of a frame yet"),
        (None, False, ""),
        (stamp(EPOCH), True, "echoes no challenge of psm1"),
        (stamp(EPOCH), False, ""),
        (stamp(EPOCH - SECOND), False, "is 1.0 s old"),
        (stamp(5, ChallengeEcho("psm1", EPOCH)), True, ""),
        (stamp(EPOCH, ChallengeEcho("psm1", EPOCH - SECOND)), True, "is 1.0 s old"),
        (stamp(EPOCH, ChallengeEcho("psm2", EPOCH)), True, "echoes no challenge of psm1"),
        (stamp(EPOCH, ChallengeEcho("psm1", EPOCH + 1)), True, "before the bridge's clock was set"),
        (stamp(EPOCH, ChallengeEcho("psm1", EPOCH - 1)), True, "before this bridge began"),
    ],
)
def test_what_is_not_known_of_a_frame_speaks_against_moving_a_real_arm(stamp, is_real, why):
    challenges = Challenges()
    challenges.issue(EPOCH)
    sight = Sight("psm1", is_real, challenges)
    if stamp is not None:
        sight.hear(stamp)
    refusal = sight.refusal(EPOCH, 0.5)
    assert (refusal is None) == (why == "")
    assert refusal is None or why in refusal.sentence


def test_a_plan_whose_frame_echoes_an_old_challenge_is_refused_whatever_the_cameras_own_clock_says():
    drive = seen(maximum_plan_age_s=1.0)
    echoes = drive.stamp().echoes
    drive.tick(SECOND + TICK)
    drive.see()
    drive.publish(plan(stamp=stamp(drive.now_ns, *echoes)))
    assert drive.arm().code == "stale"
    drive.armed()


def test_a_motion_holds_once_the_frame_of_its_plan_is_older_than_a_plan_and_its_motion_may_be():
    drive = seen(maximum_motion_s=8.0)
    drive.publish(plan(stamp=drive.stamp()))
    drive.tick(5 * SECOND)
    drive.see()
    assert drive.arm().code == ""
    # whoever sets it lower means the plan that is carried out, too
    drive.bridge.configure(dataclasses.replace(drive.bridge.config, maximum_plan_age_s=0.1))
    assert drive.run(400).ended == (HELD, "frame_age")
    assert "the frame of its plan is 8.1 s old" in drive.events[-1].reason


# how long a motion may last: the whole grasp takes seven seconds, five of them in contact with thread


@pytest.mark.parametrize(
    ("cap_s", "share", "code"), [(5.0, 1.0, "too_long"), (8.0, 1.0, ""), (8.0, 0.5, "too_long"), (16.0, 0.5, "")]
)
def test_a_motion_above_the_cap_is_refused_where_it_was_not_armed_as_a_chain_whatever_the_speed(cap_s, share, code):
    drive = seen(maximum_motion_s=cap_s, limits=MotionLimits().slowed(share))
    drive.publish(plan(stamp=drive.stamp()))
    assert drive.arm().code == code


@pytest.mark.slow
def test_a_motion_that_is_slowed_down_under_way_holds_at_the_cap():
    drive = seen(maximum_motion_s=8.0).armed()
    drive.bridge.configure(dataclasses.replace(drive.bridge.config, ratio=0.5))
    assert drive.run(900).ended == (HELD, "too_long")
    assert len(drive.states) == pytest.approx(800, abs=5)


def at_the_end_of_a_segment(segments: int = 4) -> Drive:
    drive = seen(maximum_motion_s=5.0).armed(segments=segments)
    while drive.events[-1].kind is not ExecutionKind.SEGMENT_ENDED:
        drive.run(1)
        assert drive.bridge.executes, drive.events
    return drive


def test_a_long_motion_rests_before_contact_and_goes_on_by_a_plan_from_a_fresh_image_under_one_arming():
    drive = at_the_end_of_a_segment()
    joints = drive.states[-1].joints
    assert (abs(drive.run(30).states[-1].joints - joints) < 1e-9).all(), "it rests"
    # a frame takes a while to become a plan
    drive.publish(plan("p1+", stamp=drive.stamp(10), continues="p1"))
    end = drive.run(900).events[-1]
    assert (end.kind, end.arming_id, end.plan_id) == (ExecutionKind.FINISHED, "arming-1", "p1+")


def test_a_plan_that_does_not_go_on_from_there_ends_a_chain():
    def follows(make=plan, old=False, segments=4, **changes):
        drive = at_the_end_of_a_segment()
        # fewer than any rig would chain
        drive.bridge._execution.segments = segments
        before_ns = drive.events[-1].at_ns - 1
        now = drive.run(3).stamp()
        old_stamp = dataclasses.replace(now, echoes=(ChallengeEcho("psm1", before_ns),))
        drive.publish(make("p1+", **({"stamp": old_stamp if old else now, "continues": "p1"} | changes)))
        return drive.ended, drive.events[-1].reason

    aside = np.zeros((4, 4))
    aside[1, 3] = 0.011
    elsewhere = tuple(dataclasses.replace(each, T_camera_tool=each.T_camera_tool + aside) for each in WAYPOINTS)
    cases: list[tuple[dict[str, Any], str, str]] = [
        ({"old": True}, "segment", "a frame of before the last one ended"),
        ({"waypoints": elsewhere}, "segment", "11.0 mm from where it was armed"),
        ({"make": rejected}, "rejected_plan", "the goal is not on the thread"),
        ({"segments": 1}, "segment", "armed for 1 segments at most"),
    ]
    for following, code, reason in cases:
        ended, why = follows(**following)
        assert (ended, reason in why) == ((HELD, code), True)
    assert follows(continues="p0")[0] == (ExecutionKind.SEGMENT_ENDED, ""), "it is another chain's"


@pytest.mark.slow
def test_an_arm_waits_for_its_next_segment_for_a_while_and_no_longer():
    drive = at_the_end_of_a_segment()
    ended_ns = drive.now_ns
    assert drive.run(1100).ended == (HELD, "segment")
    assert drive.now_ns - ended_ns == pytest.approx(10 * SECOND, abs=2 * TICK)
