"""Plans that an arm may be armed with, drawn at random, and one set out on."""

from typing import Any, NamedTuple

import numpy as np

from schemas.messages import GraspPlan, Outcome, Phase, Policy, Status, Waypoint
from shared.rigid_transforms import exp_so3, transform
from tests.rigs.robot.world import RIG_ARM, SECOND_NS, World


class Found(NamedTuple):
    """What a hostile case came to: its kind, whether its plan or command was accepted, and whether that was allowed."""

    kind: str
    accepted: bool
    allowed: bool


def waypoints(rng: np.random.Generator, count: int | None = None) -> tuple[Waypoint, ...]:
    """Somewhere before the camera, near to each other, in the order of the phases."""
    count = int(rng.integers(1, 8)) if count is None else count
    place, turn = rng.uniform((-0.04, -0.03, 0.06), (0.04, 0.03, 0.1)), rng.normal(size=3) * (0.3, 0.3, 1.5)
    phases = sorted(rng.integers(1, 6, count))
    points = list[Waypoint]()
    for phase in phases:
        T = transform(exp_so3(turn), place)
        points.append(Waypoint(T, float(rng.uniform(-0.5, 1.3)), Phase(int(phase)), None))
        place, turn = place + rng.normal(size=3) * 0.006, turn + rng.normal(size=3) * 0.2
    return tuple(points)


def any_plan(world: World, rng: np.random.Generator, **changes: Any) -> GraspPlan:
    captured_ns = world.now_ns - int(rng.integers(0, SECOND_NS))
    values: dict[str, Any] = {
        "plan_id": f"plan-{world.now_ns}-{rng.integers(1 << 30)}",
        "arm": RIG_ARM,
        "goal_id": "g",
        "stamp": world.stamp(captured_ns),
        "status": Status.OK,
        "reason": "",
        "waypoints": waypoints(rng),
        "policy": Policy.DIRECT,
        "s_goal": 0.5,
        "s_capture": 0.5,
        "probability": 0.9,
        "slide_m": 0.0,
        "alternatives": (),
    }
    return GraspPlan(**(values | changes))


def set_out(world: World, plan: GraspPlan, ticks: int) -> bool:
    """Publish and arm a plan with somebody standing by, and let it run for a while; whether it was accepted."""
    world.publish(plan)
    answer = world.arm(plan.plan_id)
    accepted = answer is not None and answer.outcome is Outcome.ACCEPTED
    world.stands_by = accepted
    world.tick(ticks if accepted else 2)
    return accepted


def in_motion(world: World, rng: np.random.Generator, most: int = 80) -> bool:
    """Set out on any plan, which may be good; whether it was accepted."""
    return set_out(world, any_plan(world, rng), int(rng.integers(1, most)))
