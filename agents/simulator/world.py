"""The field and the arms in it: which jaw holds the thread, and where it has taken it.

Grasps by geometry alone: fast, and validated against contact physics (docs/simulator.md).

How far tools are from where they are measured: by hand-eye calibration for good, and anew for each plan.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from agents.simulator.field import MM, Field, carried, s_of, settled
from agents.simulator.judgement import (
    Grip,
    MeasuredArm,
    Outcome,
    code,
    first_grip,
    followed,
    never_closed,
    sentence,
    slid_m,
    touching_rad,
)
from schemas.messages import Verdict
from shared.rigid_transforms import apply, inverse, transform

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


class GeometricPhysics:
    """A thread that goes where a jaw takes it, and is caught where it runs between the fingers as they close."""

    def __init__(self, field: Field) -> None:
        self._drawn = field
        self.lay()

    @property
    def field(self) -> Field:
        """The field as it is."""
        return self._world.field

    @property
    def held_sample(self) -> int | None:
        """Which sample of the thread the jaw that leads it holds, None where none does."""
        return held_sample(self._world)

    def lay(self) -> None:
        """Lay the thread as it was drawn; arms are followed from where they are seen next."""
        self._world = World(self._drawn, self._drawn, {})

    def follow(self, arm: MeasuredArm) -> Outcome:
        """What becomes of the arm's grasp when it has been measured there."""
        self._world = moved(self._world, arm.name, arm.plan_id, arm.T_camera_tool, arm.jaw_rad)
        grip = self._world.arms[arm.name].grip
        return _outcome(grip, self._world.field) if grip.verdict else _outcome(never_closed(grip), self.field, False)

    def carry(self) -> None:
        """Have the thread follow the jaw that leads it."""
        self._world = thread_carried(self._world)


def _outcome(grip: Grip, field: Field, settled: bool = True) -> Outcome:
    verdict = grip.verdict or Verdict.MISSED
    caught = grip.sample if verdict is Verdict.HELD else None
    s_caught = None if caught is None else s_of(caught)
    return Outcome(settled, verdict, code(grip), sentence(grip, field), s_caught, slid_m(grip, field))


_HAND_EYE = 77
"""Keeps this draw apart from those for plans."""


@dataclass(frozen=True)
class ToolError:
    """How far an arm's tool is from where it is measured, while it carries out its n-th plan."""

    plan_id: str
    plans: int
    offset_camera: Float64[np.ndarray, "3"]


def hand_eye_error(
    seed: int, arm: str, most_mm: float, most_deg: float, about_camera: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "4 4"]:
    """What takes measured poses of an arm's tool to the true ones, in the camera's frame.

    A shift of 0 to `most_mm` and a turn of 0 to `most_deg` about a point, each evenly drawn and in any direction.
    """
    rng = np.random.default_rng([seed, zlib.crc32(arm.encode()), _HAND_EYE, _HAND_EYE])
    ways = rng.normal(size=(2, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    shift_m, turn_rad = rng.uniform(0.0, (MM * most_mm, np.radians(most_deg)))
    R = Rotation.from_rotvec(turn_rad * ways[1]).as_matrix()
    return transform(R, about_camera - R @ about_camera + shift_m * ways[0])


def tool_error(seed: int, arm: str, plan_id: str, plans: int, deviation_mm: float) -> ToolError:
    """The error of an arm's tool in its next plan, after so many."""
    rng = np.random.default_rng([seed, zlib.crc32(arm.encode()), plans])
    return ToolError(plan_id, plans + 1, rng.normal(0.0, MM * deviation_mm, 3))
