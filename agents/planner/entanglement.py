"""Whether the instrument keeps clear of the thread outside of the grasp: on the approach, the slide and the lift.

Shaft, wrist and fingers are capsules, followed along the way in steps of a millimetre. The thread that runs through the
jaws cannot be kept clear of, so at each pose the places within `grasp_arc_m` along the thread of where the jaws are do
not count; all others do, where they were seen to lie before the grasp. So do a needle and another strand, where one is
known.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from agents.planner.config import PlannerConfig
from agents.planner.curve import ThreadCurve
from agents.planner.jaws import Capsules, clearances, instrument_at
from agents.planner.needle import NeedleAround
from schemas.messages import Phase, ThreadClearance, Waypoint

POINTS, STEP_M, MM_PER_M = 400, 0.001, 1e3


def thread_clearance(
    curve: ThreadCurve,
    waypoints: Sequence[Waypoint],
    T_camera_base: Float64[np.ndarray, "4 4"],
    config: PlannerConfig,
    needle: NeedleAround | None = None,
    beside: Float64[np.ndarray, "k 3"] | None = None,
) -> ThreadClearance:
    """How the instrument stands to the thread, to a needle and to places of another strand, on the way of a plan."""
    poses, jaw_rad, at_s, phases = _way(waypoints)
    s = np.linspace(0.0, 1.0, POINTS)
    points = curve.points(s)
    instrument = instrument_at(poses, jaw_rad, T_camera_base)
    off = clearances(instrument, points) - config.thread_radius_m
    grasped = np.abs(s - at_s[:, None]) * curve.length_m < config.grasp_arc_m
    off = np.where(grasped, np.inf, off)
    k, n = np.unravel_index(int(np.argmin(off)), off.shape)
    least = float(off[k, n])
    if not np.isfinite(least):
        return ThreadClearance("")
    phase = phases[k]
    obstructed = ""
    if least < config.thread_clear_m:
        near = f"comes within {MM_PER_M * least:.1f} mm of" if least > 0 else "touches"
        obstructed = (
            f"the instrument {near} the thread at s = {s[n]:.2f}, outside of the grasp, in the phase "
            f"{phase.name.lower()}: it may catch there or pull it along"
        )
    stands = ThreadClearance(obstructed, least, points[n], phase, float(s[n]))
    if beside is not None and len(beside) and not stands.obstructed:
        what = "another strand", "it may catch there or pull it along"
        stands = _past(stands, instrument, beside, config.thread_radius_m, phases, config, what)
    if needle is not None and not stands.obstructed:
        what = "where the needle may be", "it may turn the needle"
        stands = _past(stands, instrument, needle.points_camera, needle.reach_m, phases, config, what)
    return stands


def _past(
    stands: ThreadClearance,
    instrument: Capsules,
    points: Float64[np.ndarray, "k 3"],
    reach_m: float | Float64[np.ndarray, "k"],
    phases: list[Phase],
    config: PlannerConfig,
    what: tuple[str, str],
) -> ThreadClearance:
    """The same, where the instrument keeps clear of these places; `what` they are, and what may come of it."""
    off = clearances(instrument, points) - reach_m
    k, n = np.unravel_index(int(np.argmin(off)), off.shape)
    least = float(off[k, n])
    if least >= config.thread_clear_m:
        return stands
    near = f"comes within {MM_PER_M * least:.1f} mm of" if least > 0 else "touches"
    obstructed = f"the instrument {near} {what[0]}, in the phase {phases[k].name.lower()}: {what[1]}"
    return replace(stands, obstructed=obstructed, clearance_m=least, place_camera=points[n])


def _way(
    waypoints: Sequence[Waypoint],
) -> tuple[Float64[np.ndarray, "k 4 4"], Float64[np.ndarray, "k"], Float64[np.ndarray, "k"], list[Phase]]:
    """Poses no farther apart than a step, with the jaw's angle, where along the thread, and the phase."""
    on_thread = [waypoint.s for waypoint in waypoints if waypoint.s is not None]
    places = [waypoint.s for waypoint in waypoints]
    first, last = on_thread[0], on_thread[-1]
    filled = [place if place is not None else (first if i == 0 else last) for i, place in enumerate(places)]
    poses, jaw, at, phases = [waypoints[0].T_camera_tool], [waypoints[0].jaw_rad], [filled[0]], [waypoints[0].phase]
    for (before, s_before), (after, s_after) in pairwise(zip(waypoints, filled, strict=True)):
        start, end = before.T_camera_tool, after.T_camera_tool
        count = max(1, int(np.ceil(np.linalg.norm(end[:3, 3] - start[:3, 3]) / STEP_M)))
        for share in np.arange(1, count + 1) / count:
            pose = end.copy()
            pose[:3, 3] = start[:3, 3] + share * (end[:3, 3] - start[:3, 3])
            poses.append(pose)
            jaw.append(before.jaw_rad + share * (after.jaw_rad - before.jaw_rad))
            at.append(s_before + share * (s_after - s_before))
            phases.append(after.phase)
    return np.stack(poses), np.array(jaw), np.array(at), phases
