"""The field and the arms in it: which jaw holds the thread, and where it has taken it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from agents.simulator.field import Field, carried, settled
from agents.simulator.judgement import Grip, first_grip, followed, touching_rad
from schemas.messages import Verdict
from shared.rigid_transforms import apply, inverse

LET_GO_RAD = 0.05
"""So far above the opening at which they touched the thread, the fingers have let go of it."""


@dataclass(frozen=True)
class Hold:
    """Where a jaw holds the thread: a sample of it, a point in the tool frame, and the opening at which it lets go."""

    sample: int
    point_tool: Float64[np.ndarray, "3"]
    let_go_rad: float


@dataclass(frozen=True)
class SimulatedArm:
    """One arm: the grasp it is in, where its tool really is, and what it holds."""

    plan_id: str
    grip: Grip
    T_camera_tool: Float64[np.ndarray, "4 4"]
    hold: Hold | None = None


@dataclass(frozen=True)
class World:
    """Thread, tissue and arms.

    Fields:
        loose: the field as it was when the thread was last taken; `field`: as it is.
        holders: the arms that hold the thread, the one that has held it longest first.
        led_to: where the first of them had taken it when it was last carried; None before that.
    """

    loose: Field
    field: Field
    arms: Mapping[str, SimulatedArm]
    holders: tuple[str, ...] = ()
    led_to: Float64[np.ndarray, "3"] | None = None


def moved(world: World, name: str, plan_id: str, T_camera_tool: Float64[np.ndarray, "4 4"], jaw_rad: float) -> World:
    """The world when an arm has been measured there; the thread follows when `thread_carried` is asked."""
    arm = world.arms.get(name)
    if arm is None or arm.plan_id != plan_id:
        hold = None if arm is None else arm.hold
        arm = SimulatedArm(plan_id, first_grip(T_camera_tool, jaw_rad), T_camera_tool, hold)
    arm = replace(arm, T_camera_tool=T_camera_tool)
    if arm.hold is not None:
        world = with_arm(world, name, arm)
        return _let_go(world, name) if jaw_rad > arm.hold.let_go_rad else world
    grip = followed(arm.grip, T_camera_tool, jaw_rad, world.field)
    caught = grip.verdict is Verdict.HELD and arm.grip.verdict is None
    world = with_arm(world, name, replace(arm, grip=grip))
    return _take(world, name) if caught else world


def thread_carried(world: World) -> World:
    """The world with the thread where the jaw that has held it longest has taken it."""
    if not world.holders:
        return world
    arm = world.arms[world.holders[0]]
    assert arm.hold is not None  # noqa: S101 - holders hold
    to_camera = apply(arm.T_camera_tool, arm.hold.point_tool[None])[0]
    if world.led_to is not None and np.array_equal(world.led_to, to_camera):
        # an arm that stands still takes the thread nowhere
        return world
    return replace(world, field=carried(world.loose, arm.hold.sample, to_camera), led_to=to_camera)


def held_sample(world: World) -> int | None:
    """Which sample of the thread the jaw that leads it holds, None where none does."""
    hold = world.arms[world.holders[0]].hold if world.holders else None
    return None if hold is None else hold.sample


def with_arm(world: World, name: str, arm: SimulatedArm) -> World:
    """The world with one arm replaced."""
    return replace(world, arms={**world.arms, name: arm})


def _take(world: World, name: str) -> World:
    arm = world.arms[name]
    assert arm.grip.sample is not None  # noqa: S101 - a thread is held somewhere
    x, y, z = apply(inverse(arm.T_camera_tool), world.field.points[[arm.grip.sample]])[0]
    # closing fingers meet in their middle, so that is where they take the thread
    middle = np.array([x, 0.0, np.hypot(y, z)])
    let_go_rad = touching_rad(float(middle[2]), world.field) + LET_GO_RAD
    world = with_arm(world, name, replace(arm, hold=Hold(arm.grip.sample, middle, let_go_rad)))
    return replace(world, holders=(*world.holders, name))


def _let_go(world: World, name: str) -> World:
    """The thread falls; where another jaw holds it too, that one carries it on from where it is."""
    world = thread_carried(world)
    leads, hold = world.holders[0] == name, world.arms[name].hold
    assert hold is not None  # noqa: S101 - only a jaw that holds lets go
    others = tuple(other for other in world.holders if other != name)
    world = replace(with_arm(world, name, replace(world.arms[name], hold=None)), holders=others)
    if not leads:
        return world
    left = settled(world.field, hold.sample) if not others else world.field
    world = replace(world, loose=left, field=left, led_to=None)
    return _taken_over(world, others[0]) if others else world


def _taken_over(world: World, name: str) -> World:
    arm = world.arms[name]
    assert arm.hold is not None  # noqa: S101 - holders hold
    point_tool = apply(inverse(arm.T_camera_tool), world.field.points[[arm.hold.sample]])[0]
    return with_arm(world, name, replace(arm, hold=replace(arm.hold, point_tool=point_tool)))
