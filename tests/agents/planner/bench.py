"""Threads made by hand before a camera of 960x540, 60 mm away, in millimetres unless said otherwise."""

import dataclasses
from typing import Any

import numpy as np

from agents.planner.captures import ArmView
from agents.planner.config import PlannerConfig
from agents.planner.plan import plan_grasp
from agents.planner.tissue import tissue_of
from agents.planner.tissue_clearance import NOTHING_SEEN, SeenTissue
from schemas.codec import decode, encode
from schemas.messages import (
    CommandHeader,
    FrameStamp,
    GraspGoal,
    GraspPlan,
    Policy,
    RectifiedStereo,
    ReliabilityRegions,
    Status,
    ThreadReconstruction,
    TissueSurface,
)

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)
CAPTURED_NS = 1_760_000_000_000_000_000
NONE = np.zeros(0)
NO_REGIONS = ReliabilityRegions(NONE, np.zeros((0, 3)), np.zeros((0, 2)), NONE, NONE)


def thread(control_points, confidence=(1.0, 1.0), unseen=(), camera=CAMERA, degree=3):
    """A reconstruction over uniform knots; `confidence` is evenly spaced along it."""
    m = len(control_points)
    knots = np.concatenate((np.zeros(degree), np.linspace(0, 1, m - degree + 1), np.ones(degree)))
    return ThreadReconstruction(
        stamp=FrameStamp(7, CAPTURED_NS, CAPTURED_NS, "bench"),
        camera=camera,
        status=Status.OK,
        reason="",
        method="by hand",
        degree=degree,
        knots=knots,
        control_points_camera=np.asarray(control_points, dtype=np.float64),
        regions=NO_REGIONS,
        confidence_s=np.linspace(0, 1, len(confidence)),
        confidence=np.asarray(confidence, dtype=np.float64),
        unseen=np.asarray(unseen, dtype=np.float64).reshape(-1, 2),
    )


def polyline(*corners, **rest):
    """A thread of straight parts, as a spline of degree one."""
    return thread(corners, degree=1, **rest)


def failed(reason="too few observations"):
    good = straight()
    return dataclasses.replace(
        good,
        status=Status.FAILED,
        reason=reason,
        knots=NONE,
        control_points_camera=np.zeros((0, 3)),
        confidence_s=NONE,
        confidence=NONE,
    )


def straight(start=(-20, 0, 60), end=(20, 0, 60), **rest):
    """A straight thread of constant speed."""
    return polyline(start, end, **rest)


def known(thread, *deviations_mm):
    """The same thread, with how well it is known: on each axis, or on all of them alike."""
    covariance = np.tile(np.diag(np.broadcast_to(deviations_mm, 3)) ** 2, (9, 1, 1))
    return dataclasses.replace(thread, posterior_s=np.linspace(0, 1, 9), posterior_covariance=covariance)


X_MM = np.linspace(-40, 40, 33)


def near_middle(width_mm):
    """1 in the middle of a bent thread, falling off to 0 as far to either side, for each of its control points."""
    return np.maximum(1 - (X_MM / width_mm) ** 2, 0)[:, None] ** 2


def bent(moved_mm=(0.0, 0.0, 0.0), deviations_mm=(0.05, 0.05, 0.3), late_ms=0):
    """A bent thread 88 mm away, moved as a whole or by control points, seen so long after the others."""
    moved = known(thread(np.column_stack((X_MM, 6 * np.sin(X_MM / 13), 88 + 0 * X_MM)) + moved_mm), *deviations_mm)
    at_ns = CAPTURED_NS + late_ms * 1_000_000
    return dataclasses.replace(moved, stamp=FrameStamp(7, at_ns, at_ns, "bench"))


def in_unit(reconstruction, metres_per_unit):
    """The same thread with its lengths in another unit."""
    factor = (reconstruction.camera.metres_per_unit or 1e-3) / (metres_per_unit or 1.0)
    camera = reconstruction.camera
    return dataclasses.replace(
        reconstruction,
        camera=dataclasses.replace(camera, baseline=camera.baseline * factor, metres_per_unit=metres_per_unit),
        control_points_camera=reconstruction.control_points_camera * factor,
    )


def goal(
    s=None,
    pixel=None,
    point_camera=None,
    policy=Policy.CAPTURE_SLIDE_GRASP,
    arm="psm1",
    name="g1",
    from_swage_m=None,
):
    def array(value):
        return None if value is None else np.array(value, dtype=np.float64)

    header = CommandHeader(name, CAPTURED_NS + 10**9, "bench")
    return GraspGoal(header, arm, policy, s, array(pixel), array(point_camera), from_swage_m=from_swage_m)


def arm(base_camera=(0.05, -0.1, 0.0), tool=None, reachable=None):
    """An arm whose base stands there, with its axes those of the camera, and which reaches everything by default."""
    T_camera_base = np.eye(4)
    T_camera_base[:3, 3] = base_camera
    return ArmView(
        T_camera_base,
        np.eye(4) if tool is None else tool,
        reachable or (lambda T_camera_tool: np.ones(len(T_camera_tool), dtype=bool)),
    )


def plan(s=0.5, thread=None, view=None, config=None, policy=Policy.CAPTURE_SLIDE_GRASP, **rest: Any) -> Any:
    """The plan for a goal on a thread, by default along x. Whatever becomes of it can be sent."""
    tissue = rest.pop("tissue", NOTHING_SEEN)
    asked, view, config = goal(s, policy=policy), view or arm(), config or PlannerConfig()
    made = plan_grasp(asked, thread or straight(), view, config, tissue, **rest)
    assert encode(decode(GraspPlan, encode(made))) == encode(made)
    return made


def direct(*given, **rest: Any) -> Any:
    """The same of a direct grasp."""
    return plan(*given, policy=Policy.DIRECT, **rest)


def surface(depth_mm: Any, known=None, deviation_mm=0.1, camera=CAMERA):
    """Tissue as perception tells it: depth as a function of the pixel (u, v), or one everywhere."""
    u, v = 24.0 * np.arange(40) + 11.5, 24.0 * np.arange(22) + 11.5
    at = np.meshgrid(u, v)
    told: Any = depth_mm(*at) if callable(depth_mm) else depth_mm
    depth = np.broadcast_to(np.asarray(told, np.float64), at[0].shape)
    valid = np.ones(depth.shape, bool) if known is None else np.asarray(known(*at))
    stamp = FrameStamp(6, CAPTURED_NS, CAPTURED_NS, "bench")
    return TissueSurface(stamp, camera, u, v, np.where(valid, depth, 0.0), valid, np.where(valid, deviation_mm, 0.0))


def tissue(*args, **rest):
    """The same as the planner has it."""
    seen = surface(*args, **rest)
    return SeenTissue(tissue_of(seen), seen.stamp, "")
