"""A pull on one arm: bounds that were armed, the order of its segments, the planner's word, and that it may let go."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from agents.robot_bridge.agent import RobotBridgeConfig
from agents.robot_bridge.limits import MotionLimits
from schemas.messages import (
    EndSight,
    ExecutionKind,
    Phase,
    Pull,
    PullBounds,
    PullStop,
    Status,
    StrandEnd,
    Tail,
    TailLength,
)
from schemas.topics import SURFACE, TAIL
from tests.agents.robot_bridge.drive import (
    BEAT_TICKS,
    SECOND,
    Drive,
    RealArm,
    plan,
    stands_still,
    tissue,
    waypoint,
)

HELD, FINISHED, RESTS = ExecutionKind.HELD, ExecutionKind.FINISHED, ExecutionKind.SEGMENT_ENDED
BOUNDS = PullBounds(length_m=0.025, time_s=60.0, radius_m=0.03)
NEAR = ((20, 6, 75), 0.3, Phase.CAPTURE, 0.4)
GRASPED = (
    waypoint((20, 6, 72), 1.0, Phase.APPROACH, 0.4),
    waypoint((20, 6, 75), 1.0, Phase.APPROACH, 0.4),
    waypoint(*NEAR),
    waypoint((20, 6, 75), 0.0, Phase.GRASP, 0.4),
)
OPENED = (waypoint((24, 6, 75), 1.0, Phase.RELEASE, 0.4), waypoint((24, 6, 65), 1.0, Phase.RELEASE, 0.4))
"""Where the first segment of most tests ends."""
LENGTH = TailLength(0.03, 0.0005, at_least=False)


def end(place_mm: tuple[float, float, float]) -> StrandEnd:
    return StrandEnd(np.array(place_mm) / 1e3, 1e-8 * np.eye(3), EndSight.SEEN)


def told(segment: int = 1, last: bool = False, entry_mm: Any = (12, 6, 85), **changes: Any) -> Pull:
    ends = end((-20, 6, 85)), end((6, 6, 85)), end(entry_mm)
    made = Pull(0.02, segment, LENGTH, *ends, None, None, last, None, "pull")
    return dataclasses.replace(made, **changes)


def pulled(x_mm: float, y_mm: float = 6, jaw_rad: float = 0.0) -> Any:
    return waypoint((x_mm, y_mm, 75), jaw_rad, Phase.PULL, 0.4)


class Pulls(Drive):
    """A bridge before a camera, and a planner that tells of the tail with each frame, as long as it `measures`."""

    def __init__(self, *args: Any, **rest: Any) -> None:
        self.stop: PullStop | None = None
        self.measures, self.tail_late = True, 0
        super().__init__(*args, camera=0, **rest)

    def see(self) -> None:
        super().see()
        if not self.states or self.camera is None:
            return
        status, why = (Status.OK, "") if self.measures else (Status.FAILED, "the thread is not seen")
        length = LENGTH if self.measures else None
        of = "p1", "psm1", self.stamp(min(self.tail_late, len(self.states) - 1)), status, why, 1, 0.02, length
        self.hear(TAIL, Tail(*of, None, None, None, None, None, None, self.stop if self.measures else None, why))

    def begun(self, *ways: Any, bounds: PullBounds | None = BOUNDS, **changes: Any) -> "Pulls":
        first = plan("p1", stamp=self.stamp(), waypoints=(*GRASPED, *(ways or (pulled(24),))), pull=told(**changes))
        self.publish(first)
        answer = self.arm(pull=bounds)
        assert answer.code == "", answer
        return self

    @property
    def opens(self) -> tuple[Any, ...]:
        """What lets go where the tool is, and goes back along the fingers."""
        here = self.states[-1].T_camera_base @ self.states[-1].T_base_tool
        back = here.copy()
        back[:3, 3] -= 0.01 * here[:3, 2]
        return tuple(dataclasses.replace(OPENED[0], T_camera_tool=T) for T in (here, back))

    def until_it_rests(self) -> "Pulls":
        begun = len(self.events)
        for _ in range(1500):
            self.run(1)
            self.see()
            if any(event.kind in (RESTS, HELD, FINISHED) for event in self.events[begun:]):
                break
        return self

    def goes_on(self, name: str, *ways: Any, after: str = "p1", late: int = 10, **changes: Any) -> "Pulls":
        """By a plan from a frame that was taken so many turns ago."""
        self.run(20)
        of: dict[str, Any] = {
            "stamp": self.stamp(late),
            "waypoints": ways,
            "continues": after,
            "pull": told(2, **changes),
        }
        self.publish(plan(name, **of))
        return self


@pytest.fixture
def resting() -> Pulls:
    drive = Pulls().begun().until_it_rests()
    assert drive.ended == (RESTS, "")
    return drive


def refusal(drive: Pulls, bounds: PullBounds | None, *ways: Any, **changes: Any) -> tuple[str, str]:
    values: dict[str, Any] = {"waypoints": (*GRASPED, *ways), "pull": told()} | changes
    drive.publish(plan("p1", stamp=drive.stamp(), **values))
    answer = drive.arm(pull=bounds)
    return answer.code, answer.reason


def test_a_pull_rests_with_the_thread_held_goes_on_by_the_next_plan_and_lets_go_under_one_arming(resting):
    closed = resting.states[-1]
    resting.goes_on("p2", pulled(26)).until_it_rests()
    assert (resting.ended, resting.events[-1].plan_id) == ((RESTS, ""), "p2")
    moved = resting.states[-1].T_base_tool[:3, 3] - closed.T_base_tool[:3, 3]
    assert np.linalg.norm(moved) == pytest.approx(0.002, abs=2e-4)
    resting.goes_on("p3", *resting.opens, after="p2", last=True).until_it_rests()
    assert resting.ended == (FINISHED, "")
    assert resting.states[-1].jaw_rad == pytest.approx(1.0, abs=0.01)
    assert {event.arming_id for event in resting.events} == {"arming-1"}


def test_it_pulls_at_a_tenth_of_full_speed(resting):
    places = np.array([state.T_base_tool[:3, 3] for state in resting.states])
    phases = [event.at_ns for event in resting.events if event.phase is Phase.GRASP]
    began = next(i for i, state in enumerate(resting.states) if state.measured_ns >= phases[0])
    limits = MotionLimits()
    fastest = np.linalg.norm(np.diff(places[began:], axis=0), axis=1).max() / 0.01
    assert fastest <= 1.1 * limits.speed * limits.pull_share


@pytest.mark.parametrize(
    ("bounds", "ways", "changes", "code", "why"),
    [
        (None, (pulled(24),), {}, "pull_bounds", "state with the arming how much"),
        (PullBounds(0.4, 60.0, 0.03), (pulled(24),), {}, "pull_bounds", "300 mm of thread at most, not for 400"),
        (PullBounds(0.03, 700.0, 0.03), (pulled(24),), {}, "pull_bounds", "600 s at most"),
        (PullBounds(0.03, 60.0, 0.2), (pulled(24),), {}, "pull_bounds", "100 mm from the entry at most"),
        (BOUNDS, (), {"pull": None}, "pull_bounds", "is a grasp"),
        (PullBounds(0.003, 60.0, 0.03), (pulled(24),), {}, "pull_length", "4.0 mm, and the pull was armed for 3 mm"),
        (PullBounds(0.03, 60.0, 0.01), (pulled(24),), {}, "pull_region", "and the pull was armed for 10 mm"),
        (BOUNDS, (pulled(24),), {"pull": None}, "pull_order", "does not both pull and tell what"),
        (BOUNDS, (pulled(24),), {"waypoints": (pulled(24),)}, "pull_order", "hold nothing"),
        (BOUNDS, (pulled(24), *OPENED), {}, "pull_order", "lets go and does more"),
        (BOUNDS, (waypoint((20, 6, 70), 0.0, Phase.RETREAT), pulled(24)), {}, "pull_order", "hold nothing"),
        (BOUNDS, (waypoint((22, 6, 75), 0.0, Phase.GRASP, 0.4), pulled(24)), {}, "pull_order", "while they close"),
        (BOUNDS, (pulled(24, jaw_rad=1.0), pulled(25)), {}, "pull_order", "would open on the way"),
        (BOUNDS, (waypoint((22, 6, 75), 0.0, Phase.PULL, 0.9),), {}, "pull_order", "would be turned by"),
    ],
)
def test_a_pull_outside_of_its_bounds_or_out_of_order_is_not_armed(bounds, ways, changes, code, why):
    told_code, reason = refusal(Pulls(), bounds, *ways, **changes)
    assert (told_code, why in reason) == (code, True), reason


@pytest.mark.parametrize(
    ("ways", "changes", "code", "why"),
    [
        ((pulled(30), pulled(24), pulled(30), pulled(24)), {}, "pull_length", "travelled 28.0 mm"),
        ((pulled(44),), {}, "pull_region", "from the entry, and the pull was armed for 30 mm"),
        ((pulled(25),), {"entry_mm": (25, 6, 85)}, "pull_region", "the entry is 13.0 mm from where it was"),
        ((pulled(25),), {"entry": None}, "pull_region", "the entry is not told of"),
        ((*GRASPED, pulled(24)), {}, "pull_order", "the jaws hold thread"),
        ((pulled(25), *OPENED), {}, "pull_order", "lets go and does more"),
        ((*OPENED[1:], OPENED[1]), {"last": True}, "pull_order", "6.0 mm before they open"),
        ((waypoint((24, 6, 75), 0.1, Phase.RELEASE, 0.4),), {"last": True}, "pull_order", "would not open"),
        ((OPENED[0], waypoint((24, 6, 40), 1.0, Phase.RELEASE, 0.4)), {"last": True}, "pull_order", "mm away"),
        ((*OPENED, waypoint((24, 6, 65), 0.0, Phase.RELEASE, 0.4)), {"last": True}, "pull_order", "close again"),
        ((pulled(25, jaw_rad=1.0), pulled(26)), {}, "pull_order", "would open on the way"),
        ((pulled(25),), {"late": 60}, "segment", "a frame of before the last one ended"),
    ],
)
def test_each_further_segment_is_checked_against_what_was_armed_and_a_wrong_one_holds(
    resting, ways, changes, code, why
):
    resting.goes_on("p2", *ways, **changes)
    assert (resting.ended, why in resting.events[-1].reason) == ((HELD, code), True), resting.events[-1]
    assert stands_still(resting, 5)


def test_a_pull_that_is_held_while_it_lets_go_may_still_hold_thread(resting):
    resting.goes_on("p2", *resting.opens, last=True).run(1)
    resting.hold()
    resting.run(10)
    for changes in ({}, {"waypoints": GRASPED, "pull": None}):
        code, reason = refusal(resting, None if changes else BOUNDS, pulled(24), **changes)
        assert (code, "may hold thread" in reason) == ("pull_order", True), reason


def test_a_word_to_stop_counts_though_a_newer_tail_comes_before_the_next_turn():
    drive = during_the_pull()
    before = drive.states[-1].T_base_tool[:3, 3]
    drive.stop = PullStop.TENSION
    drive.see()
    drive.stop = None
    drive.see()
    assert drive.until_it_rests().ended == (RESTS, "")
    assert np.linalg.norm(drive.states[-1].T_base_tool[:3, 3] - before) < 0.005 * 0.55


def test_what_is_no_pull_does_not_go_on_with_one(resting):
    resting.publish(plan("p2", stamp=resting.run(2).stamp(), continues="p1"))
    assert resting.ended == (HELD, "pull_order")


def test_a_pull_ends_with_its_time_and_may_still_let_go():
    drive = Pulls().begun(bounds=PullBounds(0.03, 3.0, 0.03)).until_it_rests()
    assert drive.ended == (HELD, "pull_time")
    again = Pulls().begun(bounds=PullBounds(0.03, 12.0, 0.03)).until_it_rests()
    again.run(1200 - len(again.states) - 30)
    assert again.ended == (RESTS, "")
    again.goes_on("p2", *OPENED, last=True, entry=None).until_it_rests()
    assert again.ended == (FINISHED, "")


def during_the_pull(**config: Any) -> Pulls:
    drive = Pulls(RobotBridgeConfig(**config)).begun(pulled(24), pulled(34))
    while not drive.bridge._execution.pulls:
        drive.run(1)
    drive.run(100)
    assert drive.bridge.executes
    return drive


def test_a_tail_that_is_not_measured_any_more_holds_the_pull_within_a_second():
    drive = during_the_pull()
    drive.measures, last_ns = False, drive.now_ns
    assert drive.run(150).ended == (HELD, "tail_lost")
    assert drive.events[-1].at_ns - last_ns <= SECOND + BEAT_TICKS * 10**7
    assert stands_still(drive, 5)


def test_a_late_tail_holds_it_too_and_so_does_a_frozen_image_and_nobody_who_stands_by():
    drive = during_the_pull()
    drive.tail_late = 105
    assert drive.run(110).ended == (HELD, "tail_lost")
    drive = during_the_pull()
    drive.camera = None
    assert drive.run(80).ended == (HELD, "frame_age")
    drive = during_the_pull()
    for _ in range(30):
        drive.see()
        drive.tick()
    assert drive.ended == (HELD, "heartbeat_lost")


def test_a_pull_of_which_no_tail_was_told_does_not_begin():
    drive = Pulls()
    drive.measures = False
    drive.begun().until_it_rests()
    assert drive.ended == (HELD, "tail_lost")
    assert [event.phase for event in drive.events if event.phase][-1] is Phase.GRASP


def test_the_planners_word_ends_a_segment_where_it_is_and_the_jaws_may_let_go_from_there():
    drive = during_the_pull()
    before = drive.states[-1].T_base_tool[:3, 3]
    drive.stop = PullStop.REACHED
    drive.until_it_rests()
    assert drive.ended == (RESTS, "")
    went_m = np.linalg.norm(drive.states[-1].T_base_tool[:3, 3] - before)
    # at 5 mm/s until the next frame, and down to rest within half a second
    assert went_m < 0.005 * (0.05 + 0.5)
    assert stands_still(drive, 5)
    drive.goes_on("p2", *drive.opens, last=True).until_it_rests()
    assert drive.ended == (FINISHED, "")


def test_jaws_let_go_after_a_hold_without_bounds_from_where_they_are_and_are_not_turned_round(resting):
    resting.hold()
    assert resting.ended == (HELD, "hold_command")
    resting.run(10)
    code, reason = refusal(resting, BOUNDS, pulled(24))
    assert (code, "let go first" in reason) == ("pull_order", True)
    nothing = told(last=True, tail_m=None, tail=None, free_end=None, exit=None, entry=None, stop=PullStop.LET_GO)
    resting.publish(plan("p9", stamp=resting.stamp(), waypoints=resting.opens, pull=nothing))
    assert resting.arm("p9").code == ""
    for _ in range(1500):
        resting.run(1)
        resting.beat("p9")
        if not resting.bridge.executes:
            break
    assert resting.ended == (FINISHED, "")
    assert resting.states[-1].jaw_rad > 0.9
    resting.run(10)
    assert refusal(resting, BOUNDS, pulled(24)) == ("", ""), "then thread may be pulled again"


def test_a_grasp_of_a_real_arm_is_told_no_less_than_before():
    drive = Pulls(backend=RealArm())
    code, reason = refusal(drive, BOUNDS, pulled(24))
    assert code in ("no_presence", "unknown"), reason


def test_where_a_real_arm_grasps_anew_tissue_must_have_been_measured_and_where_it_pulls_on_it_was_before():
    registered = RobotBridgeConfig(calibration_id="c", registered_ns=1_700_000_000 * SECOND)
    drive = Pulls(registered, backend=RealArm())
    seen = tissue(drive.now_ns, 0.09)
    valid = np.zeros_like(seen.valid)
    valid[:5, :5] = True
    depth = np.where(valid, seen.depth, 0.0)
    drive.hear(SURFACE, dataclasses.replace(seen, valid=valid, depth=depth, deviation=1e-3 * depth))
    stands = drive.bridge._stands
    setup = stands.with_tissue(drive.now_ns, 30.0)

    def unknown(*ways: Any) -> bool:
        segment = plan("p3", stamp=drive.stamp(), waypoints=ways, pull=told(3), continues="p2")
        why = stands.unknown(segment, setup, drive.now_ns)
        assert why is None or "not measured at the thread" in why.sentence
        return why is not None

    assert unknown(*GRASPED, pulled(24))
    assert not unknown(pulled(24))
