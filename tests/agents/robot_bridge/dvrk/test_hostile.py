"""Hostile plans and commands, fewer than benchmarks/robot.py has of them; and two arms of one console."""

import numpy as np

from schemas.messages import ExecutionKind, Outcome, Phase, Waypoint
from shared.rigid_transforms import exp_so3, transform
from tests.rigs.robot.hostile import BRISK, hostile
from tests.rigs.robot.hostile_cases import CASES
from tests.rigs.robot.hostile_plans import any_plan
from tests.rigs.robot.world import Topics, World


def test_of_random_and_hostile_plans_and_commands_none_is_unsafe():
    found = hostile(2 * len(CASES), seed=4, processes=1)
    assert found["set points"] > 200
    assert (found["unsafe"], found["wrongly accepted"], found["failed steps"]) == (0, 0, 0), found


def test_two_arms_of_one_console_move_at_once_and_neither_hears_the_others_operator():
    topics, rng = Topics(), np.random.default_rng(3)
    worlds = [World(BRISK, 0.0, arm, topics) for arm in ("psm1", "psm2")]
    for world, other, arm, side in zip(worlds, worlds[::-1], ("psm1", "psm2"), (0.012, -0.012), strict=True):
        T = [transform(exp_so3(np.array((0.1, 0, 0.3))), np.array((side, 0.001 * y, 0.08))) for y in range(3)]
        plan = any_plan(world, rng, arm=arm, waypoints=tuple(Waypoint(pose, 0.5, Phase.APPROACH, None) for pose in T))
        for one in worlds:
            one.publish(plan)
        theirs, ours = other.arm(plan.plan_id), world.arm(plan.plan_id)
        assert theirs is not None
        assert theirs.code in ("other_arm", "busy")
        assert ours is not None
        assert ours.outcome is Outcome.ACCEPTED, ours.reason
    worlds[0].stands_by = worlds[1].stands_by = True
    for _ in range(60):
        for world in worlds:
            world.tick()
    assert all(world.moves for world in worlds)
    # the operator of the second goes: the second holds, the first goes on to its end
    worlds[1].stands_by = False
    for _ in range(1200):
        for world in worlds:
            world.tick()
        worlds[1].beat(worlds[0].answer())
        if not worlds[0].moves:
            break
    assert [world.events[-1].kind for world in worlds] == [ExecutionKind.FINISHED, ExecutionKind.HELD]
    assert [world.oracle.verdict()["unsafe"] for world in worlds] == [0, 0]
    assert min(world.oracle.verdict()["set_points"] for world in worlds) > 100
