"""From a plan's waypoints to the joints of every tick, all of them checked before the first is sent.

The way is cut into legs, between which the arm rests: from where the arm is to the first waypoint, then one leg for
each phase. What comes out above a limit of speed, acceleration or jerk in any sample of a leg slows down the whole leg.

The jaws are the same after half a turn about the fingers, so both ways round are tried, always with all waypoints
alike: first the one to which the tool turns the less, and the other where that is refused.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.robot_bridge.checks import excess_speed, joints_of, start_refusal, waypoint_refusal
from agents.robot_bridge.limits import Setup
from agents.robot_bridge.path import Poses, smooth_path
from agents.robot_bridge.plans import Code, Refusal
from agents.robot_bridge.tissue import tissue_refusal
from schemas.messages import Phase, Waypoint
from shared.rigid_transforms import angle_between, inverse

MAXIMUM_WAYPOINTS = 1000
CONTACT = (Phase.CAPTURE, Phase.SLIDE, Phase.GRASP, Phase.PULL)
_LEAST_SLOWING = 1.02
"""Slowing a leg moves its samples, so that the factor that was too fast before may not quite do."""
_ROUNDING = 1e-9
_HALF_TURN = np.array((-1.0, -1.0, 1.0, 1.0))
"""Of the columns of a pose, about z."""


@dataclass(frozen=True)
class Stop:
    """A sample in which the arm rests, and the phase that ends there; None where none does."""

    sample: int
    phase: Phase | None


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The joints and the jaw of every tick; the first are where the arm was, the last are those of the last stop.

    Fields:
        turned: the jaws are half a turn about the fingers from where the waypoints have them.
    """

    period_s: float
    joints: Float64[np.ndarray, "n 6"]
    jaw_rad: Float64[np.ndarray, "n"]
    stops: tuple[Stop, ...]
    turned: bool = False

    @property
    def duration_s(self) -> float:
        """From the first tick to the last."""
        return (len(self.joints) - 1) * self.period_s

    def at(self, seconds: float) -> tuple[Float64[np.ndarray, "6"], float]:
        """Joints and jaw so long after the start."""
        last = len(self.joints) - 1
        position = min(max(seconds / self.period_s, 0.0), float(last))
        before = int(position)
        after, share = min(before + 1, last), position - before
        joints = (1 - share) * self.joints[before] + share * self.joints[after]
        return joints, float((1 - share) * self.jaw_rad[before] + share * self.jaw_rad[after])


@dataclass(frozen=True, eq=False)
class _Leg:
    """Poses from rest to rest, the first being where the leg before ended."""

    poses: Poses
    phase: Phase
    ends_phase: bool


def plan_motion(
    waypoints: Sequence[Waypoint],
    joints: Float64[np.ndarray, "6"],
    jaw_rad: float,
    setup: Setup,
    segments: int = 1,
    holds: bool = False,
) -> Trajectory | Refusal:
    """The motion from these joints through all waypoints, or why there is none.

    With more than one of `segments` it may last longer than one may, where it can be cut before contact
    (`segment_end`) into so many that may. Jaws that hold thread already are not turned round.
    """
    cap_s = setup.limits.maximum_duration_s
    if segments > 1:
        limits = dataclasses.replace(setup.limits, maximum_duration_s=cap_s * segments)
        setup = dataclasses.replace(setup, limits=limits)
    planned = _either_way_round(waypoints, joints, jaw_rad, setup, holds)
    if isinstance(planned, Refusal) or _segments(planned, cap_s) <= segments:
        return planned
    return Refusal(Code.TOO_LONG, f"the plan cannot be cut before contact into {segments} segments of {cap_s:g} s")


def segment_end(trajectory: Trajectory, cap_s: float, first: int = 0) -> int:
    """The stop at which the segment ends that begins behind stop `first`: the last one if all that is left may be one.

    Otherwise the farthest one before contact with thread that is reached within the cap; `first` - 1 where none is.
    """
    stops, period_s = trajectory.stops, trajectory.period_s
    began_s = stops[first - 1].sample * period_s if first else 0.0
    ends = [index for index in range(first, len(stops)) if stops[index].sample * period_s - began_s <= cap_s]
    if ends and ends[-1] == len(stops) - 1:
        return ends[-1]
    return next((index for index in reversed(ends) if stops[index].phase in (None, Phase.APPROACH)), first - 1)


def left_of(waypoints: tuple[Waypoint, ...], approached: bool) -> tuple[Waypoint, ...]:
    """What of a plan is left to an arm between two segments: behind the approach its end, from which contact begins."""
    if not approached:
        return waypoints
    ends = [index for index, each in enumerate(waypoints) if each.phase is Phase.APPROACH]
    return waypoints[ends[-1] if ends else 0 :]


def contact_joints(trajectory: Trajectory) -> Float64[np.ndarray, "6"]:
    """The joints at the last rest before contact with thread."""
    rests = [stop.sample for stop in trajectory.stops if stop.phase in (None, Phase.APPROACH)]
    return trajectory.joints[rests[-1] if rests else -1]


def _segments(trajectory: Trajectory, cap_s: float) -> float:
    """How many segments a motion takes; infinitely many where it cannot be cut."""
    first, count = 0, 0
    while first < len(trajectory.stops):
        end = segment_end(trajectory, cap_s, first)
        if end < first:
            return float("inf")
        first, count = end + 1, count + 1
    return count


def _either_way_round(
    waypoints: Sequence[Waypoint], joints: Float64[np.ndarray, "6"], jaw_rad: float, setup: Setup, holds: bool
) -> Trajectory | Refusal:
    """The motion with the jaws as the waypoints have them, or half a turn about the fingers from that."""
    if not 0 < len(waypoints) <= MAXIMUM_WAYPOINTS:
        possible = f"1 to {MAXIMUM_WAYPOINTS} can be followed"
        return Refusal(Code.TOO_LONG, f"the plan has {len(waypoints)} waypoints, where {possible}")
    T_camera_tool = np.stack([waypoint.T_camera_tool for waypoint in waypoints])
    jaw = setup.jaw.set_points(np.array([waypoint.jaw_rad for waypoint in waypoints]))
    phases = [waypoint.phase for waypoint in waypoints]
    if refusal := start_refusal(joints, setup.kinematics) or setup.jaw.unreachable(setup.kinematics.jaw_limit):
        return refusal
    turns = sorted((False, True), key=lambda turned: _first_turn(T_camera_tool, turned, joints, setup))
    refusals: dict[bool, Refusal] = {}
    for turned in turns[:1] if holds else turns:
        planned = _plan(T_camera_tool * _HALF_TURN if turned else T_camera_tool, jaw, phases, joints, jaw_rad, setup)
        if isinstance(planned, Trajectory):
            return dataclasses.replace(planned, turned=turned)
        refusals[turned] = planned
    return refusals.get(False) or refusals[True]


def _first_turn(
    T_camera_tool: Float64[np.ndarray, "n 4 4"], turned: bool, joints: Float64[np.ndarray, "6"], setup: Setup
) -> float:
    """How far the tool turns on its way to the first waypoint."""
    T_camera_here = setup.T_camera_base @ setup.kinematics.forward(joints)
    first = T_camera_tool[:1] * _HALF_TURN if turned else T_camera_tool[:1]
    if not np.isfinite(first).all():
        return 0.0
    return float(angle_between(T_camera_here[:3, :3], first[0, :3, :3]))


def _plan(
    T_camera_tool: Float64[np.ndarray, "n 4 4"],
    jaw: Float64[np.ndarray, "n"],
    phases: Sequence[Phase],
    joints: Float64[np.ndarray, "6"],
    jaw_rad: float,
    setup: Setup,
) -> Trajectory | Refusal:
    if refusal := waypoint_refusal(T_camera_tool, jaw, setup):
        return refusal
    here = setup.kinematics.forward(joints)[None]
    T_base_tool = np.concatenate((here, inverse(setup.T_camera_base) @ T_camera_tool))
    return _follow(_legs(Poses(T_base_tool, np.append(jaw_rad, jaw)), phases), joints, jaw_rad, setup)


def _legs(poses: Poses, phases: Sequence[Phase]) -> list[_Leg]:
    """Pose 0 is where the arm is, and pose i + 1 the waypoint of `phases[i]`."""
    ends_phase = [*(a is not b for a, b in itertools.pairwise(phases)), True]
    ends = [i for i, ends in enumerate(ends_phase) if ends or i == 0]
    return [
        _Leg(
            Poses(poses.T_base_tool[start : end + 2], poses.jaw_rad[start : end + 2]),
            phases[end],
            ends_phase[end],
        )
        for start, end in zip([0, *(end + 1 for end in ends)], ends, strict=False)
    ]


def _follow(
    legs: Sequence[_Leg], joints: Float64[np.ndarray, "6"], jaw_rad: float, setup: Setup
) -> Trajectory | Refusal:
    all_joints, all_jaw, stops = [joints[None]], [np.array([jaw_rad])], list[Stop]()
    last = 0
    for leg in legs:
        left_s = setup.limits.maximum_duration_s - last * setup.period_s
        samples = _sample(leg, all_joints[-1][-1], legs[0].poses.T_base_tool[0], left_s, setup)
        if isinstance(samples, Refusal):
            return samples
        if samples is not None:
            all_joints.append(samples[0])
            all_jaw.append(samples[1])
            last += len(samples[1])
        stops.append(Stop(last, leg.phase if leg.ends_phase else None))
    return Trajectory(setup.period_s, np.concatenate(all_joints), np.concatenate(all_jaw), tuple(stops))


def _sample(
    leg: _Leg,
    before: Float64[np.ndarray, "6"],
    here: Float64[np.ndarray, "4 4"],
    left_s: float,
    setup: Setup,
) -> tuple[Float64[np.ndarray, "n 6"], Float64[np.ndarray, "n"]] | Refusal | None:
    """Joints and jaw of every tick after the leg's start; None where it leads nowhere."""
    share = _share(leg.phase, setup)
    path, slowing = smooth_path(leg.poses, setup.limits, share), 1.0
    if path is None:
        return None
    while path.duration_s * slowing <= left_s:
        poses = path.sample(setup.period_s, slowing)
        joints = joints_of(poses, before, f"on the way to the end of {leg.phase.name}", setup)
        if isinstance(joints, Refusal):
            return joints
        excess = excess_speed(poses, joints, share, setup)
        if excess <= 1 + _ROUNDING:
            return _in_tissue(poses, here, leg, setup) or (joints[1:], poses.jaw_rad[1:])
        slowing *= max(excess, _LEAST_SLOWING)
    longest = setup.limits.maximum_duration_s
    return Refusal(Code.TOO_LONG, f"the plan would take longer than the {longest:g} s that a motion may last")


def _share(phase: Phase, setup: Setup) -> float:
    """The share of full speed in a phase."""
    if phase is Phase.PULL:
        return setup.limits.pull_share
    return setup.limits.contact_share if phase in (*CONTACT, Phase.RELEASE) else 1.0


def _in_tissue(poses: Poses, here: Float64[np.ndarray, "4 4"], leg: _Leg, setup: Setup) -> Refusal | None:
    if setup.surface is None:
        return None
    seen = Poses(setup.T_camera_base @ poses.T_base_tool, poses.jaw_rad - setup.jaw.told_rad)
    where = f"on the way to the end of {leg.phase.name}"
    return tissue_refusal(setup.surface, setup.T_camera_base @ here, seen, setup.limits, where)
