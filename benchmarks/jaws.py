"""How deep planned jaws truly press into tissue, what plans say of it, and what is refused.

    .venv/bin/python -m benchmarks.jaws

Scenes of `shared.scene`, whose tissue is known; the thread is given as it is, or moved along its viewing rays towards
or away from the camera, as a reconstruction that is wrong would have it. Goals for a direct grasp at several places are
planned for by a simulated arm, against the surface that perception makes of the images. The truth is what the planner
says of the same poses when it is given the true surface.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from agents.perception.surface import tissue_surface
from agents.planner.agent import reaches_of
from agents.planner.captures import ArmView
from agents.planner.config import PlannerConfig
from agents.planner.plan import plan_grasp
from agents.planner.standing import SeenTissue
from agents.planner.tissue import tissue_of
from benchmarks.surface import CONFIGS, DISTANCES_MM, FIRST_SEED, STAMP, at_cells
from schemas.messages import (
    CommandHeader,
    GraspGoal,
    GraspPlan,
    Policy,
    ReliabilityRegions,
    Status,
    ThreadReconstruction,
    TissueSurface,
)
from shared.kinematics import psm
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rigid_transforms import compose, inverse
from shared.scene.__main__ import ENDOSCOPE, make_scene
from shared.scene.render import Scene, render, render_backdrop

PLACES = (0.15, 0.3, 0.5, 0.7, 0.85)
MOVED_MM = (0.0, -4.0, -2.0, 2.0, 4.0, 6.0)
"""Of the thread that is planned on, away from the camera."""
NOTHING, CERTAIN_MM = np.zeros(0), 1e-6
CONSOLE = Console(width=140)


@dataclass(frozen=True)
class Planned:
    """One goal: whether there was a plan without tissue, and with it, and what it says of the tissue, in millimetres.

    Fields:
        true_mm: the clearance of the same poses from the true tissue; None where the planner had others for it.
    """

    moved_mm: float
    without: bool
    accepted: bool
    tilted: bool
    known_share: float
    stated_mm: float | None
    deviation_mm: float | None
    true_mm: float | None


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=20, help="how many scenes")
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="of the first of them")
    parser.add_argument("--json", type=Path, default=Path("out/jaws.json"), help="where the figures go")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    found = [one for seed in range(arguments.seed, arguments.seed + arguments.scenes) for one in of_scene(seed)]
    print_found(found)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps([asdict(one) for one in found], indent=1) + "\n")


def of_scene(seed: int) -> Iterator[Planned]:
    """All goals of one scene, for the thread as it is and moved."""
    config, distance = CONFIGS[seed % 4], DISTANCES_MM[seed // 4 % 5]
    scene = make_scene(config, "tissue", seed, distance_mm=distance)
    pair = render(scene)
    surface = tissue_surface(STAMP, ENDOSCOPE, pair.left_bgr, pair.right_bgr, pair.coverage_left > 0)
    depth = at_cells(surface, render_backdrop(ENDOSCOPE, "tissue", distance, seed).depth_left_mm)
    known = np.ones(depth.shape, bool)
    true = TissueSurface(STAMP, ENDOSCOPE, surface.u_px, surface.v_px, depth, known, np.full(depth.shape, CERTAIN_MM))
    seen, truth = (SeenTissue(tissue_of(one), STAMP, "") for one in (surface, true))
    for moved_mm in MOVED_MM:
        thread = thread_of(scene, moved_mm)
        for s in PLACES:
            yield planned(thread, s, moved_mm, seen, truth)


def planned(thread: ThreadReconstruction, s: float, moved_mm: float, seen: SeenTissue, truth: SeenTissue) -> Planned:
    """What becomes of one goal."""
    goal = GraspGoal(CommandHeader("g", 0, "benchmark"), "psm1", Policy.DIRECT, s, None, None)
    # no depth is too deep for the truth, so that it tells of the same poses
    any_depth = replace(PlannerConfig(), press_m=1.0)
    without = plan_grasp(goal, thread, simulated_arm(), PlannerConfig())
    plan = plan_grasp(goal, thread, simulated_arm(), PlannerConfig(), seen)
    tissue = plan.tissue
    true = plan_grasp(goal, thread, simulated_arm(), any_depth, truth).tissue if same_way(without, plan) else None
    return Planned(
        moved_mm=moved_mm,
        without=without.status is Status.OK,
        accepted=plan.status is Status.OK,
        tilted=plan.status is Status.OK and not same_way(without, plan),
        known_share=tissue.known_share if tissue else 0.0,
        stated_mm=_mm(tissue.clearance_m) if tissue else None,
        deviation_mm=_mm(tissue.deviation_m) if tissue else None,
        true_mm=_mm(true.clearance_m) if true else None,
    )


def same_way(one: GraspPlan, other: GraspPlan) -> bool:
    """Whether two plans hold the tool alike."""
    if len(one.waypoints) != len(other.waypoints) or not one.waypoints:
        return False
    return bool(np.allclose(one.waypoints[1].T_camera_tool, other.waypoints[1].T_camera_tool))


def thread_of(scene: Scene, moved_mm: float) -> ThreadReconstruction:
    """The thread of a scene as if it had been reconstructed, so far away from where it is."""
    points = scene.thread.control_points
    return ThreadReconstruction(
        stamp=STAMP,
        camera=scene.camera,
        status=Status.OK,
        reason="",
        method="as drawn",
        degree=scene.thread.degree,
        knots=scene.thread.knots,
        control_points_camera=points * (1.0 + moved_mm / np.linalg.norm(points, axis=1, keepdims=True)),
        regions=ReliabilityRegions(NOTHING, np.zeros((0, 3)), np.zeros((0, 2)), NOTHING, NOTHING),
        confidence_s=np.array([0.0, 1.0]),
        confidence=np.ones(2),
    )


def simulated_arm() -> ArmView:
    """The demo's first arm, with its tool where it starts."""
    T_camera_base = SIMULATED_BASES["psm1"]
    T_base_camera = inverse(T_camera_base)
    reaches = reaches_of(psm.LARGE_NEEDLE_DRIVER, PlannerConfig().least_dexterity)
    at_rest = psm.forward(np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    return ArmView(T_camera_base, compose(T_camera_base, at_rest), lambda T: reaches(compose(T_base_camera, T)))


def print_found(found: list[Planned]) -> None:
    """A row for each way in which the thread was moved."""
    table = Table(title="Direct grasps, jaws against tissue", title_justify="left")
    columns = (
        *("thread moved mm", "goals", "planned without tissue", "accepted", "of these tilted", "way known"),
        *("truly pressed in mm: median", "95 %", "most", "stated − true mm: median abs", "within 2 σ"),
    )
    for column in columns:
        table.add_column(column, justify="right")
    for moved_mm in sorted(MOVED_MM):
        own = [one for one in found if one.moved_mm == moved_mm]
        open_ones = [one for one in own if one.without]
        accepted = [one for one in open_ones if one.accepted]
        compared = [one for one in accepted if one.true_mm is not None and one.stated_mm is not None]
        pressed = -np.array([one.true_mm for one in compared], np.float64)
        off = np.array([one.stated_mm for one in compared], np.float64) + pressed
        sure = 2.0 * np.array([one.deviation_mm for one in compared], np.float64)
        shares = [np.percentile(pressed, share) if len(pressed) else np.nan for share in (50, 95, 100)]
        table.add_row(
            f"{moved_mm:+.0f}",
            str(len(own)),
            str(len(open_ones)),
            f"{len(accepted)} ({len(accepted) / max(len(open_ones), 1):.0%})",
            str(sum(one.tilted for one in accepted)),
            f"{np.mean([one.known_share for one in accepted]) if accepted else np.nan:.1%}",
            *(f"{share:.1f}" for share in shares),
            f"{np.median(np.abs(off)) if len(off) else np.nan:.2f}",
            f"{np.mean(np.abs(off) <= sure) if len(off) else np.nan:.0%}",
        )
    CONSOLE.print(table)


def _mm(length_m: float | None) -> float | None:
    return None if length_m is None else 1e3 * length_m


if __name__ == "__main__":
    main()
