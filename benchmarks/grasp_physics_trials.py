"""Random grasps for comparing judges of them: fields, goals, plans, motions and errors of the tool."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from agents.planner.agent import reaches_of
from agents.planner.captures import ArmView
from agents.planner.config import PlannerConfig
from agents.planner.plan import plan_grasp
from agents.planner.standing import SeenTissue
from agents.planner.tissue import tissue_of
from agents.robot_bridge.limits import MotionLimits, Setup
from agents.robot_bridge.motion import plan_motion
from agents.robot_bridge.refusals import Refusal
from agents.robot_bridge.simulated import SIMULATED_START
from agents.simulator.agent import ENDOSCOPE
from agents.simulator.field import MM, Field, field_of
from schemas.messages import (
    CommandHeader,
    FrameStamp,
    GraspGoal,
    GraspPlan,
    Policy,
    ReliabilityRegions,
    Status,
    ThreadReconstruction,
    TissueSurface,
)
from shared.kinematics import psm
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rigid_transforms import compose, inverse
from shared.scene.surface import Surface, meet_rays, ray_tangents

CONFIGS = ("easy", "medium", "hard", "singularity", "crossing")
DISTANCES_MM = (80.0, 95.0, 110.0)
STAMP = FrameStamp(1, 1, 1, "benchmark")
PERIOD_S = 0.01
CELL_PX = 12
ERROR_BINS_MM = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)


@dataclass(frozen=True)
class Trial:
    """One grasp, as an arm carries it out.

    Fields:
        T_camera_tool, jaw_rad: where the tool truly is at every hundredth of a second.
        error_mm: of the tool, by which that differs from where it was sent.
    """

    config: str
    seed: int
    goal: int
    policy: Policy
    T_camera_tool: Float64[np.ndarray, "n 4 4"]
    jaw_rad: Float64[np.ndarray, "n"]
    error_mm: Float64[np.ndarray, "3"]


def drawn_field(config: str, seed: int) -> Field:
    """A random field of a configuration."""
    in_mm = replace(ENDOSCOPE, baseline=ENDOSCOPE.baseline / MM, metres_per_unit=MM)
    return field_of(in_mm, config, "tissue", DISTANCES_MM[seed % len(DISTANCES_MM)], seed)


def trials_of(field: Field, config: str, seed: int, goals: int) -> list[Trial]:
    """Goals anywhere along a thread that is known as it lies, half of them with a slide, with errors of 0 to 4 mm."""
    rng = np.random.default_rng([seed, CONFIGS.index(config), 11])
    seen = SeenTissue(tissue_of(true_surface(field.surface)), STAMP, "")
    found: list[Trial] = []
    for goal in range(goals):
        policy = (Policy.DIRECT, Policy.CAPTURE_SLIDE_GRASP)[goal % 2]
        s, way = float(rng.uniform(0.05, 0.95)), rng.normal(size=3)
        error_mm = rng.uniform(0.0, ERROR_BINS_MM[-1]) * way / np.linalg.norm(way)
        motion = carried_out(planned(field, s, policy, seen))
        if motion is not None:
            T_camera_tool, jaw_rad = motion
            T_camera_tool[:, :3, 3] += MM * error_mm
            found.append(Trial(config, seed, goal, policy, T_camera_tool, jaw_rad, error_mm))
    return found


def planned(field: Field, s: float, policy: Policy, seen: SeenTissue) -> GraspPlan:
    """The plan for a goal on the thread as it truly lies; for a slide it is doubted around the goal."""
    goal = GraspGoal(CommandHeader("g", 0, "benchmark"), "psm1", policy, s, None, None)
    at = np.linspace(0.0, 1.0, 41)
    near = (np.abs(at - s) < 0.12) & (policy is Policy.CAPTURE_SLIDE_GRASP)
    nothing = np.zeros(0)
    thread = ThreadReconstruction(
        stamp=STAMP,
        camera=ENDOSCOPE,
        status=Status.OK,
        reason="",
        method="as it lies",
        degree=3,
        knots=field.knots,
        control_points_camera=field.control_points,
        regions=ReliabilityRegions(nothing, np.zeros((0, 3)), np.zeros((0, 2)), nothing, nothing),
        confidence_s=at,
        confidence=np.where(near, 0.7, 1.0),
    )
    return plan_grasp(goal, thread, waiting_arm(), PlannerConfig(), seen)


def carried_out(plan: GraspPlan) -> tuple[Float64[np.ndarray, "n 4 4"], Float64[np.ndarray, "n"]] | None:
    """Poses of the tool and openings of the jaw as the bridge has them, None where there is no plan or no motion."""
    if plan.status is not Status.OK:
        return None
    T_camera_base = SIMULATED_BASES["psm1"]
    setup = Setup(LARGE_NEEDLE_DRIVER, T_camera_base, MotionLimits(), PERIOD_S)
    motion = plan_motion(plan.waypoints, np.array(SIMULATED_START), 0.0, setup)
    if isinstance(motion, Refusal):
        return None
    poses = np.stack([compose(T_camera_base, LARGE_NEEDLE_DRIVER.forward(joints)) for joints in motion.joints])
    return poses, motion.jaw_rad


def waiting_arm() -> ArmView:
    """The demo's first arm, with its tool where it starts."""
    T_camera_base = SIMULATED_BASES["psm1"]
    T_base_camera = inverse(T_camera_base)
    reaches = reaches_of(psm.LARGE_NEEDLE_DRIVER, PlannerConfig().least_dexterity)
    at_rest = psm.forward(np.array(SIMULATED_START))
    return ArmView(T_camera_base, compose(T_camera_base, at_rest), lambda T: reaches(compose(T_base_camera, T)))


def true_surface(surface: Surface) -> TissueSurface:
    """The tissue as perception would tell it if it made no mistake."""
    p, q = ray_tangents(ENDOSCOPE)
    p, q = p[::CELL_PX, ::CELL_PX], q[::CELL_PX, ::CELL_PX]
    depth = MM * meet_rays(surface, p, q, 0.0).astype(np.float64)
    u, v = (np.arange(0.0, size, CELL_PX) for size in (ENDOSCOPE.image_width, ENDOSCOPE.image_height))
    return TissueSurface(STAMP, ENDOSCOPE, u, v, depth, np.ones(depth.shape, bool), np.full(depth.shape, 1e-4))
