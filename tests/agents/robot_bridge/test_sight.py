"""No blind motion: frames by the bridge's own clock, an absolute cap, and long motions as chains of segments."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from agents.robot_bridge.agent import RobotBridgeConfig
from agents.robot_bridge.limits import MotionLimits
from agents.robot_bridge.sight import Sight
from schemas.messages import (
    Arm,
    ChallengeEcho,
    CommandAnswer,
    CommandHeader,
    ExecutionKind,
    FrameNotice,
    FrameStamp,
    GraspPlan,
    Outcome,
    Status,
)
from schemas.topics import ARM, FRAME_NOTICE
from shared.runtime.agent import Command, Received
from tests.agents.robot_bridge.test_agent import EPOCH, SECOND, TICK, WAYPOINTS, Drive, plan, stands_still

PERIOD_TICKS = 3


class Seen(Drive):
    """A bridge whose camera tells of frames, which echo a challenge of `late` states ago."""

    late, sees = 0, True

    def see(self) -> None:
        states = self.states()
        if self.sees and len(states) > self.late:
            echo = (ChallengeEcho("psm1", states[-1 - self.late].challenge_ns),)
            stamp = FrameStamp(1, self.now_ns, self.now_ns, "c", echo)
            self.feed(Received(FRAME_NOTICE, "", 0, FrameNotice(stamp)))

    def goes(self, ticks: int, pressed: bool = False) -> None:
        for index in range(ticks):
            if index % PERIOD_TICKS == 0:
                self.see()
                self.beat(pressed=pressed)
            self.tick()

    def armed(self, segments: int = 0, plan_id: str = "p1", pressed: bool = False) -> str:
        """Arm a plan; the code of a refusal."""
        self.armings += 1
        header = CommandHeader(f"arming-{self.armings}", self.now_ns + SECOND, "ann")
        asked_ns = self.states()[-1].challenge_ns
        message = Arm(header, "psm1", plan_id, asked_ns, pressed=pressed, segments=segments)
        answer = self.feed(Command(ARM, "psm1", message, self.now_ns))[0]
        assert isinstance(answer, CommandAnswer)
        if answer.outcome is Outcome.ACCEPTED:
            self.arming_id = header.id
        return answer.code

    def fresh(self, plan_id: str = "p1", **changes: Any) -> GraspPlan:
        """A plan of a frame that is taken now."""
        echo = (ChallengeEcho("psm1", self.states()[-1].challenge_ns),)
        stamp = FrameStamp(1, self.now_ns, self.now_ns, "c", echo)
        return plan(plan_id, stamp=stamp, **changes)


def seen(config: RobotBridgeConfig | None = None, segments: int = 0) -> Seen:
    drive = Seen(config)
    drive.see()
    drive.publish(drive.fresh())
    assert drive.armed(segments) == ""
    return drive


def test_a_motion_goes_on_while_the_camera_is_seen_to_run_and_holds_within_the_limit_once_it_freezes():
    drive = seen()
    drive.goes(150)
    assert drive.bridge.executes
    drive.sees = False
    last_ns = drive.now_ns
    drive.goes(80)
    held = drive.events()[-1]
    assert (held.kind, held.code) == (ExecutionKind.HELD, "frame_age")
    assert held.at_ns - last_ns <= 0.5 * SECOND + PERIOD_TICKS * TICK
    assert stands_still(drive, 5)
    assert drive.armed() == "frame_age"


def test_a_queue_that_is_as_long_all_the_time_cannot_pass_for_a_fresh_camera():
    drive = seen()
    drive.goes(100)
    # frames come at their rate, and each was taken 0.6 s ago, whatever their own clock says
    drive.late = 60
    drive.goes(30)
    assert drive.events()[-1].code == "frame_age"


def test_how_old_a_frame_may_be_is_told_with_the_state():
    drive = seen(RobotBridgeConfig(maximum_frame_age_s=0.25))
    assert drive.states()[-1].maximum_frame_age_s == 0.25
    drive.sees = False
    drive.goes(30)
    assert "0.25 s are allowed" in drive.events()[-1].reason


@pytest.mark.parametrize(
    ("stamp", "is_real", "why"),
    [
        (None, True, "no camera has told of a frame yet"),
        (None, False, ""),
        (FrameStamp(1, EPOCH, EPOCH, "c"), True, "echoes no challenge of psm1"),
        (FrameStamp(1, EPOCH, EPOCH, "c"), False, ""),
        (FrameStamp(1, EPOCH - SECOND, EPOCH, "c"), False, "is 1.0 s old"),
        (FrameStamp(1, 5, 5, "c", (ChallengeEcho("psm1", EPOCH),)), True, ""),
        (FrameStamp(1, EPOCH, EPOCH, "c", (ChallengeEcho("psm1", EPOCH - SECOND),)), True, "is 1.0 s old"),
        (FrameStamp(1, EPOCH, EPOCH, "c", (ChallengeEcho("psm2", EPOCH),)), True, "echoes no challenge of psm1"),
        (
            FrameStamp(1, EPOCH, EPOCH, "c", (ChallengeEcho("psm1", EPOCH + 1),)),
            True,
            "before the bridge's clock was set",
        ),
    ],
)
def test_what_is_not_known_of_a_frame_speaks_against_moving_a_real_arm(stamp, is_real, why):
    sight = Sight("psm1", is_real)
    if stamp is not None:
        sight.hear(stamp)
    refusal = sight.refusal(EPOCH, 0.5)
    assert ("" if refusal is None else refusal.sentence).find(why) >= 0
    assert (refusal is None) == (why == "")


CAPPED = RobotBridgeConfig(maximum_motion_s=5.0)
"""The whole grasp takes seven seconds, five of them in contact with thread."""


def at_the_end_of_a_segment(segments: int = 4) -> Seen:
    drive = seen(CAPPED, segments)
    for _ in range(600):
        drive.goes(1)
        drive.see()
        drive.beat()
        if drive.events()[-1].kind is ExecutionKind.SEGMENT_ENDED:
            return drive
    raise AssertionError(drive.events())


def test_a_motion_above_the_cap_is_refused_where_it_was_not_armed_as_a_chain_whatever_the_speed():
    for limits in (MotionLimits(), MotionLimits().slowed(0.5)):
        drive = Seen(dataclasses.replace(CAPPED, limits=limits))
        drive.see()
        drive.publish(drive.fresh())
        assert drive.armed() == "too_long"


def test_a_long_motion_rests_before_contact_and_goes_on_by_a_plan_from_a_fresh_image_under_one_arming():
    drive = at_the_end_of_a_segment()
    joints = drive.states()[-1].joints
    for _ in range(30):
        drive.goes(1)
        drive.see()
        drive.beat()
    assert (abs(drive.states()[-1].joints - joints) < 1e-9).all(), "it rests"
    drive.publish(drive.fresh("p1+", continues="p1"))
    for _ in range(900):
        drive.see()
        drive.beat("p1")
        drive.tick()
        if not drive.bridge.executes:
            break
    kinds = [(event.kind, event.arming_id) for event in drive.events()]
    assert kinds[-1] == (ExecutionKind.FINISHED, "arming-1")
    assert drive.events()[-1].plan_id == "p1+"


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ("old frame", "segment"),
        ("elsewhere", "segment"),
        ("rejected", "rejected_plan"),
        ("another", ""),
    ],
)
def test_a_plan_that_does_not_go_on_from_there_ends_a_chain(change, code):
    drive = at_the_end_of_a_segment()
    ended_ns = drive.events()[-1].at_ns
    drive.goes(3)
    following = drive.fresh("p1+", continues="p1")
    if change == "old frame":
        stamp = dataclasses.replace(following.stamp, echoes=(ChallengeEcho("psm1", ended_ns - 1),))
        following = dataclasses.replace(following, stamp=stamp)
    elif change == "elsewhere":
        aside = np.zeros((4, 4))
        aside[1, 3] = 0.011
        moved = (dataclasses.replace(each, T_camera_tool=each.T_camera_tool + aside) for each in WAYPOINTS)
        following = dataclasses.replace(following, waypoints=tuple(moved))
    elif change == "rejected":
        following = drive.fresh("p1+", continues="p1", status=Status.FAILED, reason="no thread is seen", waypoints=())
    else:
        following = dataclasses.replace(following, continues="p0")
    drive.publish(following)
    drive.goes(1)
    event = drive.events()[-1]
    assert (event.kind, event.code) == ((ExecutionKind.HELD, code) if code else (ExecutionKind.SEGMENT_ENDED, ""))


def test_a_chain_is_no_longer_than_it_was_armed_for():
    drive = at_the_end_of_a_segment(segments=2)
    execution = drive.bridge._execution
    assert execution is not None
    execution.segments = 1
    drive.publish(drive.fresh("p1+", continues="p1"))
    assert "armed for 1 segments at most" in drive.events()[-1].reason


def test_an_arm_waits_for_its_next_segment_for_a_while_and_no_longer():
    drive = at_the_end_of_a_segment()
    for _ in range(1100):
        drive.see()
        drive.beat()
        drive.tick()
    held = drive.events()[-1]
    assert (held.kind, held.code) == (ExecutionKind.HELD, "segment")


def test_a_motion_that_is_slowed_down_under_way_holds_at_the_cap():
    drive = seen(RobotBridgeConfig(maximum_motion_s=8.0))
    drive.bridge.configure(dataclasses.replace(drive.bridge.config, ratio=0.5))
    for _ in range(900):
        drive.see()
        drive.beat()
        drive.tick()
    held = drive.events()[-1]
    assert (held.kind, held.code) == (ExecutionKind.HELD, "too_long")


def test_a_motion_holds_once_the_frame_of_its_plan_is_older_than_a_plan_and_its_motion_may_be():
    drive = Seen(RobotBridgeConfig(maximum_motion_s=8.0))
    drive.see()
    drive.publish(drive.fresh())
    for _ in range(500):
        drive.see()
        drive.tick()
    assert drive.armed() == ""
    # whoever sets it lower means the plan that is carried out, too
    drive.bridge.configure(dataclasses.replace(drive.bridge.config, maximum_plan_age_s=0.1))
    for _ in range(400):
        drive.see()
        drive.beat()
        drive.tick()
    held = drive.events()[-1]
    assert (held.kind, held.code) == (ExecutionKind.HELD, "frame_age")
    assert "the frame of its plan is 8.1 s old" in held.reason


def test_a_plan_whose_frame_echoes_an_old_challenge_is_refused_whatever_the_cameras_own_clock_says():
    drive = Seen(RobotBridgeConfig(maximum_plan_age_s=1.0))
    echo = (ChallengeEcho("psm1", drive.states()[-1].challenge_ns),)
    for _ in range(110):
        drive.see()
        drive.tick()
    drive.publish(plan(stamp=FrameStamp(1, drive.now_ns, drive.now_ns, "c", echo)))
    assert drive.armed() == "frame_age"
    drive.publish(drive.fresh())
    assert drive.armed() == ""


@pytest.mark.parametrize(("share", "code"), [(1.0, ""), (0.5, "too_long")])
def test_a_lower_speed_makes_a_motion_longer_and_its_cap_no_larger(share, code):
    # at full speed the whole grasp takes seven seconds
    drive = Seen(RobotBridgeConfig(maximum_motion_s=8.0, limits=MotionLimits().slowed(share)))
    drive.see()
    drive.publish(drive.fresh())
    assert drive.armed() == code
