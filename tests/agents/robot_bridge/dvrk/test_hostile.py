"""Hostile plans and commands, fewer than benchmarks/robot.py has of them; and that its judge sees what is unsafe."""

import numpy as np
import pytest

from agents.robot_bridge.limits import MotionLimits
from benchmarks.robot_hostile import hostile
from benchmarks.robot_hostile_cases import CASES
from benchmarks.robot_world import World
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER


def test_of_random_and_hostile_plans_and_commands_none_is_unsafe():
    found = hostile(3 * len(CASES), seed=4)
    assert found["set points"] > 500
    assert (found["unsafe"], found["wrongly accepted"], found["failed steps"]) == (0, 0, 0), found


@pytest.mark.parametrize("rule", ["speed", "limits", "nobody", "owners", "state"])
def test_a_set_point_that_no_bridge_should_send_is_found(rule):
    world = World(MotionLimits(), 0.0)
    world.oracle.heartbeat(world.now_ns * 1e-9)
    here = np.array(world.console.verdict()["position"][:6])
    match rule:
        case "speed":
            here[3] += 1.5
        case "limits":
            here = np.array(LARGE_NEEDLE_DRIVER.limits[:, 1]) + 0.1
        case "nobody":
            world.tick(200)
        case "owners":
            world.oracle.stranger(world.now_ns * 1e-9 - 0.5)
        case _:
            world.console.request("fault")
    world.backend.move(here, 0.0)
    assert rule in world.oracle.verdict()["rules"]
