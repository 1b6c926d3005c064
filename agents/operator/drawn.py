"""What the page draws besides the thread, as plain numbers: a plan's way, the tool, the tissue, observations.

Everything is projected into the rectified left image (pixels) and told in the camera frame too (mm), for the view in
space. Rounded to what can be seen.

The thread as the page draws it, as plain numbers: evenly spaced places with their confidence, and crossings.

Places are projected into the rectified left image (pixels) and told in the camera frame too (mm), for the view in
space.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from agents.operator.wire import compact, packed
from schemas.messages import (
    GraspPlan,
    PullBounds,
    RectifiedStereo,
    RobotState,
    Status,
    ThreadObservations,
    ThreadReconstruction,
    TissueSurface,
    ToolCorrection,
    Waypoint,
)
from shared import splines
from shared.along_thread import confidence_at, nearly_even, unseen_at
from shared.camera import backproject, project
from shared.kinematics.psm import finger_tips
from shared.rigid_transforms import apply, exp_so3, log_so3

PLACES = 201
"""Along the thread: a place every few pixels."""
CHORDS = 600
"""At least so many make up the length of a thread, to 0.01 %: it is drawn with every frame, and shared.arc_length takes
seven times as long."""
MM = 1e3
FARTHEST_PX = 20_000.0


@dataclass(frozen=True)
class DrawnThread:
    """The thread of one frame as evenly spaced places.

    Fields:
        px: of the rectified left image; along: s of each.
        points_mm: in the camera frame; in the calibration's own unit where nobody knows what that is.
        confidence: NaN where none is stated.
        unseen: not both images show it.
        to_mm: what takes the calibration's unit to mm; None where it is unknown.
        found: the how many-th that was found anew; s names places on those of the same number alone.
    """

    frame: int
    capture_ns: int
    camera: RectifiedStereo
    px: Float64[np.ndarray, "n 2"]
    points_mm: Float64[np.ndarray, "n 3"]
    along: Float64[np.ndarray, "n"]
    confidence: Float64[np.ndarray, "n"]
    unseen: Bool[np.ndarray, "n"]
    length_mm: float
    to_mm: float | None
    crossings: tuple[dict[str, Any], ...]
    elsewhere: tuple[tuple[float, float], ...] = ()
    found: int = 0

    @cached_property
    def told(self) -> str:
        """For every page the same, as JSON."""
        return compact(self.document())

    def document(self) -> dict[str, Any]:
        """For the page; what there is of each place is packed."""
        known = np.where(np.isfinite(self.confidence), self.confidence, -1.0)
        return {
            "frame": self.frame,
            "capture_ms": self.capture_ns * 1e-6,
            "px": packed(self.px),
            "mm": packed(self.points_mm),
            "confidence": packed(known),
            "unseen": packed(self.unseen.astype(float)),
            "length_mm": round(self.length_mm, 2),
            "unit_known": self.to_mm is not None,
            "crossings": list(self.crossings),
            "elsewhere": [list(leads) for leads in self.elsewhere],
        }


def millimetres(camera: RectifiedStereo) -> float | None:
    """What takes the calibration's unit to mm."""
    return None if camera.metres_per_unit is None else MM * camera.metres_per_unit


def draw_thread(thread: ThreadReconstruction) -> DrawnThread | None:
    """The thread of a reconstruction; None where it failed, or is no curve before the camera."""
    if thread.status is Status.FAILED:
        return None
    knots, control, degree = thread.knots, thread.control_points_camera, thread.degree
    with np.errstate(all="ignore"):
        spans = max(1, len(np.unique(knots)) - 1)
        parameters, length = nearly_even(knots, control, degree, PLACES, -(-CHORDS // spans))
        points = splines.evaluate(knots, control, degree, parameters)
        if not (np.isfinite(points).all() and np.isfinite(length) and (points[:, 2] > 0).all()):
            return None
        px, _ = project(thread.camera, points)
    along, to_mm = np.linspace(0.0, 1.0, PLACES), millimetres(thread.camera)
    crossings = tuple(
        {
            "px": [round(float(v), 1) for v in crossing.point_px],
            "s": [round(crossing.s_first, 3), round(crossing.s_second, 3)],
            "over": crossing.over.name.lower(),
        }
        for crossing in thread.crossings
    )
    return DrawnThread(
        frame=thread.stamp.sequence,
        capture_ns=min(thread.stamp.capture_left_ns, thread.stamp.capture_right_ns),
        camera=thread.camera,
        px=np.clip(px, -FARTHEST_PX, FARTHEST_PX),
        points_mm=points * (to_mm or 1.0),
        along=along,
        confidence=confidence_at(thread, along),
        unseen=unseen_at(thread, along),
        length_mm=length * (to_mm or 1.0),
        to_mm=to_mm,
        crossings=crossings,
        elsewhere=()
        if thread.course is None
        else tuple((round(float(a), 3), round(float(b), 3)) for a, b in thread.course.elsewhere),
    )


STEPS_MM, TURN_DEG = 0.6, 4.0
"""A plan's way is told so densely that lines between its poses look like the way itself."""
MOST_STEPS = 160
SURFACE_CELLS = 1100
OBSERVED_MOST = 120
OUTLINE_MOST = 200
BETTER_ELSEWHERE = "another capture is better"
"""What the planner has against a capture that would do."""


def draw_plan(plan: GraspPlan, camera: RectifiedStereo) -> dict[str, Any]:
    """A plan: what it promises, its way pose by pose, and what else was considered."""
    told: dict[str, Any] = {
        "id": plan.plan_id,
        "arm": plan.arm,
        "goal_id": plan.goal_id,
        "ok": plan.status is Status.OK,
        "reason": plan.reason,
        "pull": plan.pull.sentence if plan.pull is not None else "",
        "continues": plan.continues,
        "bounds": "" if plan.pull is None or plan.pull.bounds is None else bounds_words(plan.pull.bounds),
        "policy": plan.policy.name.lower().replace("_", "-"),
        "s_goal": plan.s_goal,
        "s_capture": plan.s_capture,
        "probability": round(plan.probability, 4),
        "slide_mm": round(MM * plan.slide_m, 2),
        "attempt": plan.attempt,
        "attempts": plan.attempts,
        "model": plan.policy_model,
        "alternatives": [
            {
                "s": round(each.s_capture, 4),
                "probability": round(each.probability, 4),
                "reason": each.reason,
                "possible": each.reason in ("", BETTER_ELSEWHERE),
            }
            for each in plan.alternatives
        ],
        "way": [],
    }
    if plan.tissue is not None and plan.tissue.clearance_m is not None:
        told["clearance_mm"] = round(MM * plan.tissue.clearance_m, 1)
    if plan.tissue is not None and plan.tissue.unchecked:
        told["unchecked"] = plan.tissue.unchecked
    if plan.thread is not None and plan.thread.clearance_m is not None:
        told["thread_mm"] = round(MM * plan.thread.clearance_m, 1)
    if plan.thread is not None and plan.thread.obstructed:
        told["obstructed"] = plan.thread.obstructed
    if plan.waypoints and camera.metres_per_unit is not None:
        told["way"] = way_of(plan.waypoints, camera)
    return told


def bounds_words(bounds: PullBounds) -> str:
    """What a pull is armed for."""
    length, radius = f"{MM * bounds.length_m:.0f} mm", f"{MM * bounds.radius_m:.0f} mm"
    return f"at most {length} in {bounds.time_s:.0f} s, within {radius} of where the strand goes into the tissue"


def way_of(waypoints: Sequence[Waypoint], camera: RectifiedStereo) -> list[dict[str, Any]]:
    """Both fingers along a plan's way, evenly in distance and turn, with the phase and the share of the way before."""
    poses = np.array([waypoint.T_camera_tool for waypoint in waypoints])
    jaws = np.array([waypoint.jaw_rad for waypoint in waypoints])
    weights = _weights(poses, jaws)
    spread = min(1.0, MOST_STEPS / max(1.0, float(np.ceil(weights).sum())))
    counts = np.maximum(1, np.ceil(weights * spread)).astype(int) if len(weights) else np.zeros(0, int)
    told = [_posed(poses[0], float(jaws[0]), waypoints[0], camera)]
    for i, count in enumerate(counts.tolist()):
        turn = log_so3(poses[i, :3, :3].T @ poses[i + 1, :3, :3])
        for share in np.linspace(0.0, 1.0, count + 1)[1:].tolist():
            pose = np.eye(4)
            pose[:3, :3] = poses[i, :3, :3] @ exp_so3(share * turn)
            pose[:3, 3] = (1 - share) * poses[i, :3, 3] + share * poses[i + 1, :3, 3]
            jaw = (1 - share) * jaws[i] + share * jaws[i + 1]
            told.append(_posed(pose, float(jaw), waypoints[i + 1], camera))
    return told


def _weights(poses: Float64[np.ndarray, "n 4 4"], jaws: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "m"]:
    """How many steps each leg of a way deserves."""
    moved = MM * np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / STEPS_MM
    R = poses[:, :3, :3]
    turned = np.degrees(np.linalg.norm(log_so3(np.swapaxes(R[:-1], 1, 2) @ R[1:]), axis=-1)) / TURN_DEG
    return np.maximum(np.maximum(moved, turned), np.abs(np.degrees(np.diff(jaws))) / TURN_DEG)


def _posed(pose: Float64[np.ndarray, "4 4"], jaw: float, waypoint: Waypoint, camera: RectifiedStereo) -> dict[str, Any]:
    return {"phase": waypoint.phase.name.lower(), "s": waypoint.s, **_fingers(pose, jaw, camera)}


def _fingers(pose: Float64[np.ndarray, "4 4"], jaw: float, camera: RectifiedStereo) -> dict[str, Any]:
    """Tip, pin and tip of a jaw; empty where a part of it is not before the camera."""
    tips = finger_tips(jaw)
    points = apply(pose, np.stack((tips[0], np.zeros(3), tips[1])))
    return _line(points, camera)


def _line(points_m: Float64[np.ndarray, "n 3"], camera: RectifiedStereo) -> dict[str, Any]:
    if camera.metres_per_unit is None or not (points_m[:, 2] > 0).all():
        return {"px": [], "mm": []}
    px, _ = project(camera, points_m / camera.metres_per_unit)
    return {"px": np.clip(px, -FARTHEST_PX, FARTHEST_PX).round(1).tolist(), "mm": (MM * points_m).round(2).tolist()}


def draw_tool(state: RobotState, camera: RectifiedStereo) -> dict[str, Any]:
    """The jaw where the bridge takes it to be, and what the arm is doing."""
    pose = state.T_camera_base @ state.T_base_tool
    return {
        "arm": state.arm,
        "mode": state.mode.name.lower(),
        "plan_id": state.plan_id,
        "at_ms": state.measured_ns * 1e-6,
        "jaw_deg": round(float(np.degrees(state.jaw_rad)), 1),
        **_fingers(pose, state.jaw_rad, camera),
        "shaft": _line(apply(pose, np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.0091]])), camera)["px"],
    }


def draw_correction(correction: ToolCorrection | None) -> dict[str, Any]:
    """Where the images show the tool, and how far that is from where registration and joints have it."""
    if correction is None:
        return {}
    outline = correction.found_left_px[:: max(1, len(correction.found_left_px) // OUTLINE_MOST)]
    told: dict[str, Any] = {"tracking": correction.status.name.lower(), "reason": correction.reason}
    if correction.T_correction is not None:
        told["off_mm"] = round(MM * correction.tip_off_m, 2)
        told["sure_mm"] = round(MM * correction.tip_deviation_m, 2)
    return told | {"outline": np.clip(outline, -FARTHEST_PX, FARTHEST_PX).round(1).tolist()}


def draw_surface(surface: TissueSurface) -> list[list[float]]:
    """Places of the tissue in the camera frame, mm, thinned to a grid that a page can turn."""
    to_mm = millimetres(surface.camera) or 1.0
    step = max(1, int(np.ceil(np.sqrt(surface.depth.size / SURFACE_CELLS))))
    depth, valid = surface.depth[::step, ::step], surface.valid[::step, ::step]
    v, u = np.meshgrid(surface.v_px[::step], surface.u_px[::step], indexing="ij")
    points = backproject(surface.camera, np.column_stack((u[valid], v[valid])), depth[valid])
    return (points * to_mm).round(1).tolist()


def draw_observations(observations: ThreadObservations) -> dict[str, Any]:
    """What perception saw: observations and centreline in the left image."""
    points = observations.points_camera
    px = project(observations.camera, points)[0] if len(points) else np.zeros((0, 2))
    line = observations.centrelines_left
    every = max(1, len(line.point_px) // OBSERVED_MOST)
    return {
        "frame": observations.stamp.sequence,
        "px": np.clip(px[:OBSERVED_MOST], -FARTHEST_PX, FARTHEST_PX).round(1).tolist(),
        "centreline": line.point_px[::every].round(1).tolist(),
    }
