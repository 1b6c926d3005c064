"""A planner and a bridge that pull a thread together, in step and from images of it alone."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from agents.planner.agent import Planner, reaches_of
from agents.planner.captures import ArmView
from agents.planner.config import PlannerConfig
from agents.planner.curve import curve_of
from agents.planner.needle import NeedleAround
from agents.planner.pulling.segments import begin, go_on
from agents.planner.pulling.way import Around, jaw_of
from agents.planner.tissue_clearance import NOTHING_SEEN
from schemas.messages import (
    CommandHeader,
    ExecutionKind,
    Phase,
    PullBounds,
    PullGoal,
    PullStop,
    Status,
)
from schemas.topics import PLAN, TAIL, topic_of
from shared.kinematics import psm
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rigid_transforms import compose, inverse
from shared.runtime.replay import replay
from tests.agents.planner import bench
from tests.agents.planner.pulling.bench import ENTRY_MM, Field, threaded

HELD, FINISHED, RESTS = ExecutionKind.HELD, ExecutionKind.FINISHED, ExecutionKind.SEGMENT_ENDED
BASE = SIMULATED_BASES["psm1"]
EXIT_PX = np.array((442.0, 269.5))


def first(
    tail_m=0.02, thread=None, config=None, tissue=NOTHING_SEEN, reaches=None, pixel=EXIT_PX, **around: Any
) -> Any:
    """The first segment of a pull."""
    reaches = reaches or reaches_of(psm.LARGE_NEEDLE_DRIVER, 0.32)
    home = compose(BASE, psm.forward(np.array([0.0, 0, 0.1, 0, 0, 0])))
    arm = ArmView(BASE, home, lambda T: reaches(compose(inverse(BASE), T)))
    goal = PullGoal(CommandHeader("g", 1, "ann"), "psm1", tail_m, pixel)
    return begin(goal, thread or threaded(), arm, config or PlannerConfig(), Around(tissue, **around))


def jaws_mm(plan):
    return 1e3 * jaw_of(np.stack([w.T_camera_tool for w in plan.waypoints]), plan.depth_m)


# the plan of a segment


def test_the_first_segment_grasps_the_standing_strand_and_pulls_it_away_from_its_entry():
    plan = first()
    assert (plan.plan_id, plan.status, plan.continues) == ("pull-g", Status.OK, "")
    phases = [w.phase for w in plan.waypoints]
    assert (phases[-3], set(phases[-2:])) == (Phase.GRASP, {Phase.PULL})
    jaws = jaws_mm(plan)
    strand_mm = 1e3 * plan.pull.grip.strand_m
    np.testing.assert_allclose(np.linalg.norm(jaws[-3] - ENTRY_MM), strand_mm, atol=0.2)
    # no more may run than a segment, and surely none of what is loose or unsure
    assert strand_mm < np.linalg.norm(jaws[-1] - ENTRY_MM) <= strand_mm + 5.0
    assert len({w.jaw_rad for w in plan.waypoints if w.phase in (Phase.GRASP, Phase.PULL)}) == 1
    bounds = plan.pull.bounds
    assert bounds.length_m > 0.01
    assert np.linalg.norm(jaws[-3:] - ENTRY_MM, axis=1).max() < 1e3 * bounds.radius_m


def test_near_the_end_a_segment_is_no_longer_than_what_is_left_of_the_tail():
    long, short = (np.linalg.norm(jaws_mm(first(tail_m))[-1] - ENTRY_MM) for tail_m in (0.02, 0.028))
    # a bite of 6 mm gives by 4.2 mm at half a newton, and no more may run in a segment; of the other tail 2 mm are left
    assert long - short == pytest.approx(2.2, abs=0.3)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"tail_m": 0.03}, "the tail is 30.0 mm long (29.3 to 30.7), and 30.0 mm were asked for"),
        ({"tail_m": 0.004}, "a tail of 5 mm at least is left"),
        ({"thread": threaded(loose_mm=12.0)}, "the standing strand is 12 mm long, too short to be grasped"),
        ({"reaches": lambda T: np.zeros(len(T), bool)}, "unreachable"),
        ({"thread": threaded(40.0)}, "the free end is out of view: the tail is at least 33.8 mm"),
        ({"tissue": bench.tissue(60.0)}, "the standing strand cannot be pulled: "),
        ({"thread": bench.failed()}, "there is no thread: too few observations"),
    ],
)
def test_a_pull_that_cannot_be_is_a_rejection_with_one_sentence(changes, why):
    plan = first(**changes)
    assert (plan.status, plan.waypoints, why in plan.reason) == (Status.FAILED, (), True), plan.reason


def test_the_way_keeps_clear_of_needle_and_of_another_instrument():
    free = first().pull.grip
    end, begun = free.way_end_camera, free.jaw_camera
    middle = begun + 0.5 * (end - begun)
    crossing = middle + np.linspace(-0.03, 0.03, 31)[:, None] * np.array((0.0, 1.0, 0.0))
    needle = NeedleAround(crossing, np.full(31, 0.0005))
    for plan in (first(needle=needle), first(instruments=(crossing,))):
        other = plan.pull.grip.way_end_camera
        steps = np.linspace(0.0, 1.0, 50)[:, None]
        way = begun + steps * (other - begun)
        apart = np.linalg.norm(way[:, None] - crossing, axis=2).min()
        assert apart > 0.001, "it ends before it, or goes another way"
        assert np.linalg.norm(other - end) > 0.005


def test_where_the_tissue_lies_under_the_thread_the_jaws_lift_before_they_pull():
    plan = first(tissue=bench.tissue(80.5))
    assert plan.status is Status.OK, plan.reason
    jaws = jaws_mm(plan)
    assert (jaws[-2:, 2] < jaws[-3, 2] - 2.0).all()


# the whole of it


@pytest.fixture(scope="module", params=[False, True], ids=["one curve", "parted"])
def pulled(request):
    """From 30 to 12 mm with a short reach, so that the strand is grasped twice."""
    config = PlannerConfig(pull_reach_m=0.026)
    field = Field(30.0, Planner(config), parted=request.param)
    plan, answer = field.ask(0.012)
    assert plan is not None, answer
    assert field.arm(plan).code == ""
    return config, field.to_the_end()


def test_a_pull_goes_on_segment_by_segment_grasps_anew_and_ends_at_the_length_that_was_asked_for(pulled):
    _, field = pulled
    assert field.ended == (FINISHED, ""), field.events[-1]
    last = field.plans[-1].pull
    assert (last.stop, last.last, last.grip) == (PullStop.REACHED, True, None)
    assert 12.0 - 1.96e3 * last.tail.deviation_m <= field.tail_mm <= 12.5 + 1.96e3 * last.tail.deviation_m
    grasps = [event for event in field.events if event.phase is Phase.GRASP]
    assert len(grasps) == 2
    assert [plan.pull.segment for plan in field.plans] == list(range(1, len(field.plans) + 1))
    assert {event.arming_id for event in field.events} == {"a1"}
    longest = [plan.pull.longest_m for plan in field.plans]
    assert longest == sorted(longest, reverse=True), (
        "what was measured once bounds all that is taken for the tail after"
    )


def test_the_tail_is_told_in_each_frame_with_an_interval_that_holds_it(pulled):
    _, field = pulled
    told = [tail for tail in field.tails if tail.status is Status.OK]
    assert len(told) == len(field.tails) > 40
    lengths = [tail.tail.length_m for tail in told]
    assert max(np.diff(lengths)) < 5e-4
    assert {tail.segment for tail in told} == {plan.pull.segment for plan in field.plans}
    assert {Phase.GRASP, Phase.PULL, Phase.RELEASE, None} & {tail.phase for tail in told}


def test_a_replay_of_the_planner_says_the_same_byte_for_byte(pulled):
    config, field = pulled
    replayed = list(replay(lambda: Planner(config), field.steps.entries))
    assert {str(topic_of(one.key)) for one in replayed} >= {str(PLAN), str(TAIL)}
    assert all(one.same for one in replayed), [one.key for one in replayed if not one.same]


def pulling(**changes):
    """In the midst of the first pull."""
    field = Field(30.0)
    plan, answer = field.ask(0.012)
    assert plan is not None, answer
    assert field.arm(plan, **changes).code == ""
    field.run(60.0, lambda: any(event.phase is Phase.GRASP for event in field.events))
    assert field.events[-1].phase is Phase.GRASP
    return field


def stopped(field):
    """Why the planner ended a pull."""
    field.to_the_end()
    assert field.ended == (FINISHED, ""), field.events[-1]
    return field.plans[-1].pull.stop


def test_thread_that_does_not_run_is_let_go():
    field = pulling()
    field.gives = 0.0
    assert stopped(field) is PullStop.TENSION
    travelled = [tail.travelled_m for tail in field.tails if tail.travelled_m is not None]
    assert max(travelled) < 0.008, "by no more than what tissue gives and what is unsure of it"


def test_a_thread_or_a_free_end_that_is_not_seen_any_more_holds():
    field = pulling()
    field.blind = True
    began_mm = field.tail_mm
    assert field.to_the_end(30.0).ended == (HELD, "segment")
    assert began_mm - field.tail_mm < 1.5, "the segment ended as soon as that was seen"
    assert {one.phase for one in field.plans[-1].waypoints} == {Phase.RELEASE}, "they let go meanwhile"
    field = pulling()
    field.run(20.0, lambda: field.ended[0] is RESTS)
    field.hides_end = True
    field.to_the_end(40.0)
    assert field.ended == (HELD, "segment")
    assert field.tails[-1].stop is PullStop.END_UNSEEN
    assert 10.0 < field.tail_mm < 13.0, "it is pulled while it surely is no shorter than 2 mm below what was asked"


def test_what_is_seen_again_in_time_is_pulled_on_and_bounds_hold_for_all_segments():
    field = pulling(bounds=PullBounds(0.015, 100.0, 0.06))
    field.run(20.0, lambda: field.ended[0] is RESTS)
    field.blind = True
    field.run(3.0)
    field.blind = False
    field.to_the_end(40.0)
    assert field.ended == (HELD, "pull_length")
    # what a hold leaves in the jaws they let go of when somebody asks, without a thread or bounds
    field.blind = True
    field.run(0.5)
    plan, _ = field.ask(None, None, name="g2")
    assert plan.pull.stop is PullStop.LET_GO
    assert field.arm(plan, name="a2").code == ""
    assert field.to_the_end(20.0).ended == (FINISHED, "")
    assert field.steps.last is not None


def test_a_tail_that_lies_beside_the_standing_strand_is_not_grasped_with_it():
    thread = threaded(parted=True)
    assert first(thread=thread).status is Status.OK
    tail = bench.known(bench.straight(ENTRY_MM + np.array((32, 7, 0)), ENTRY_MM - np.array((6, 0, 0))), 0.1, 0.1, 0.3)
    assert (
        "another strand" in first(thread=dataclasses.replace(thread, strands=(thread.as_strand, tail.as_strand))).reason
    )


def test_a_strand_that_is_not_seen_when_it_is_to_be_grasped_anew_is_waited_for():
    thread = threaded(parted=True)
    meant, tail = thread.strands
    let_go = first(thread=thread)
    let_go = dataclasses.replace(let_go, pull=dataclasses.replace(let_go.pull, grip=None))
    arm = ArmView(BASE, compose(BASE, psm.forward(np.array([0.0, 0, 0.1, 0, 0, 0]))), lambda T: np.ones(len(T), bool))

    def then(*strands):
        seen = dataclasses.replace(bench.failed(), strands=strands)
        return go_on(let_go, seen, arm, PlannerConfig(), Around(NOTHING_SEEN))

    assert then(tail) is None
    again: Any = then(meant, tail)
    assert (again.status, again.pull.segment, again.pull.stop) == (Status.OK, 2, None)


def test_a_strand_whose_other_side_is_not_seen_is_not_pulled():
    thread = threaded()
    s = thread.unseen[0, 1] + 0.01
    points = 1e3 * curve_of(thread).points(np.linspace(s, 1.0, 40))
    alone = dataclasses.replace(bench.known(bench.polyline(*points), 0.1, 0.1, 0.3), stamp=thread.stamp)
    plan = first(thread=alone)
    assert "no place is seen at which the thread passes through tissue" in plan.reason
