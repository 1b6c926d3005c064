"""What plans promise against how often they hold, and how much better than the base rate any promise could be.

    .venv/bin/python -m benchmarks.promises [--scenes out/sweep/images]

First, without any scene: thread whose place is known exactly, grasped as deep as can be, with the errors that an
evaluation draws. How often that holds at each size of the tool's error bounds the Brier skill of a sweep, for how a
tool errs in one trial nobody can know.

Then, for each path-traced pair with truth (`suturegrasp scenes render`, or an evaluation's images): perception,
reconstruction, and a plan for each of some goals and sizes of the tool's error. Then the errors that an evaluation
draws (tool normal, registration of any length up to the most) are drawn many times for that one plan, and the rule of
the geometric judge says which of them hold. So a plan's share is known to some per cent, where an evaluation has one
outcome, and three Brier skills can be told apart: of what was promised, of the best promise that knows nothing but the
size of the error, and of the best that knows where thread and registration truly are, and only not how the tool will
err. Prints all three and the reliability of the promises. With `--calibrations N` each pair is seen with N calibrations
that are wrong by as much as those without a stated covariance may be, and so is the robot (benchmarks.calibrations).
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64
from rich.console import Console
from rich.table import Table

from agents.camera.scene_source import calibration_of
from agents.cli.reconstruct.pipeline import PipelineResult, reconstruct_pair
from agents.planner.agent import reaches_of
from agents.planner.captures import ArmView
from agents.planner.config import PlannerConfig
from agents.planner.plan import plan_grasp
from agents.planner.wedge import wedge_probability
from agents.reconstruction.method_names import DEFAULT_METHOD
from agents.reconstruction.methods import METHODS
from agents.simulated_trials.look import seen_places
from agents.simulated_trials.results import EDGES
from agents.simulator.fingers import between
from agents.simulator.judgement import GIVE_M
from benchmarks.calibrations import drawn_errors, hand_eye, wrongly
from schemas.messages import (
    CommandHeader,
    GraspGoal,
    GraspPlan,
    Phase,
    Policy,
    RectifiedStereo,
    Status,
    ThreadObservations,
    ThreadReconstruction,
)
from shared.calibration.uncertainty import usual_covariance
from shared.kinematics import psm
from shared.kinematics.psm import FINGER_M
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rigid_transforms import apply, compose, inverse

REGISTRATIONS, TOOLS = 8, 25
BOUND_DRAWS, BIN = 4000, 200
NEAR_M = 0.025
"""Of the capture: thread farther away is out of reach of all errors."""
CONSOLE = Console(width=140)
MM = 1e-3


@dataclass(frozen=True)
class Promise:
    """One plan: what it promises, and the share that holds for each drawn registration."""

    scene: str
    goal: int
    tool_error_mm: float
    promised: float
    slide_m: float
    held: tuple[float, ...]


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=Path, help="folder of path-traced pairs with truth")
    parser.add_argument("--only", default="", help="scenes whose name contains this")
    parser.add_argument("--goals", type=int, default=5)
    parser.add_argument("--tool-error", type=float, nargs="+", default=[0.0, 1.0, 2.0, 3.0, 4.0], help="in mm")
    parser.add_argument("--hand-eye", type=float, default=1.5, help="the most, in mm")
    parser.add_argument("--calibrations", type=int, default=0, help="drawn for each scene; 0: the true one")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, default=Path("out/promises.json"), help="where the figures go")
    arguments = parser.parse_args()
    print_bound(arguments.tool_error, arguments.hand_eye, arguments.seed)
    if arguments.scenes is None:
        return
    names = sorted(path for path in arguments.scenes.glob("*.json") if arguments.only in path.stem)
    if not names:
        parser.error(f"no scene under {arguments.scenes} has a name that contains {arguments.only!r}")
    found = [
        one
        for path in names
        for one in of_scene(
            path, arguments.goals, arguments.tool_error, arguments.hand_eye, arguments.seed, arguments.calibrations
        )
    ]
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps([asdict(one) for one in found]) + "\n")
    if not found:
        parser.error("there is no plan for any goal")
    print_found(found)


def print_bound(sizes_mm: list[float], hand_eye_mm: float, seed: int) -> None:
    """Of thread whose place is known, for each opening: rates by size, and the skill of the best promises."""
    rng = np.random.default_rng(seed)
    way = rng.normal(size=(BOUND_DRAWS, 3))
    way *= rng.uniform(0.0, MM * hand_eye_mm, (BOUND_DRAWS, 1)) / np.linalg.norm(way, axis=1, keepdims=True)
    config = PlannerConfig()
    depth_m = max(config.depths_m)
    table = Table(title=f"Thread known exactly, {depth_m / MM:g} mm deep: held, best skill", title_justify="left")
    for column in ("open", *(f"{size:g} mm" for size in sizes_mm), "knowing the size", "and the registration"):
        table.add_column(column, justify="right")
    mean = np.array([0.0, FINGER_M - depth_m]) + way[:, :2]
    for open_deg in config.opens_deg:
        spreads = [np.broadcast_to((MM * size) ** 2 * np.eye(2), (BOUND_DRAWS, 2, 2)) for size in sizes_mm]
        rates = np.array([wedge_probability(mean, spread, np.radians(open_deg)) for spread in spreads])
        by_size, base = rates.mean(axis=1), float(rates.mean())
        skills = [skill(float(np.mean(known * (1.0 - known))), base) for known in (by_size, rates)]
        table.add_row(f"{open_deg:g}°", *(f"{rate:.1%}" for rate in by_size), *(f"{one:.3f}" for one in skills))
    CONSOLE.print(table)


def of_scene(
    path: Path, goals: int, sizes_mm: list[float], hand_eye_mm: float, seed: int, calibrations: int = 0
) -> Iterator[Promise]:
    """All plans of one scene."""
    seen, truth_m = seen_scene(path)
    rng = np.random.default_rng([seed, *path.stem.encode()])
    known = seen.reconstruction, truth_m
    drawn = [
        with_other_calibration(seen.observations, truth_m, errors) for errors in drawn_errors(rng, calibrations)
    ] or [known]
    for thread, true in drawn:
        yield from plans_of(path.stem, thread, true, rng, goals, sizes_mm, hand_eye_mm)


def with_other_calibration(
    observations: ThreadObservations, truth_m: Float64[np.ndarray, "n 3"], errors: Float64[np.ndarray, "8"]
) -> tuple[ThreadReconstruction, Float64[np.ndarray, "n 3"]]:
    """The thread as a wrong calibration has it, and the true points where a robot has them that was found with it."""
    stated = replace(wrongly(observations, errors), calibration_covariance=usual_covariance())
    thread = METHODS[DEFAULT_METHOD](stated)
    R, t = hand_eye(observations.camera, errors, float(np.median(truth_m[:, 2])))
    return thread, (truth_m - t) @ R


def plans_of(
    scene: str,
    thread: ThreadReconstruction,
    truth_m: Float64[np.ndarray, "n 3"],
    rng: np.random.Generator,
    goals: int,
    sizes_mm: list[float],
    hand_eye_mm: float,
) -> Iterator[Promise]:
    """A plan for each goal and size of error, and how often it holds."""
    if thread.status is not Status.OK:
        return
    for number, s in enumerate(seen_places(thread, goals)):
        way = rng.normal(size=(REGISTRATIONS, 3))
        length = rng.uniform(0.0, MM * hand_eye_mm, (REGISTRATIONS, 1))
        shift_m = length * way / np.linalg.norm(way, axis=1, keepdims=True)
        unit = rng.normal(size=(REGISTRATIONS, TOOLS, 3))
        for size_mm in sizes_mm:
            config = PlannerConfig(least_probability=0.0, tool_error_m=MM * size_mm, hand_eye_error_m=MM * hand_eye_mm)
            goal = GraspGoal(CommandHeader("g", 0, "benchmark"), "psm1", Policy.CAPTURE_SLIDE_GRASP, s, None, None)
            plan = plan_grasp(goal, thread, simulated_arm(), config)
            if plan.status is Status.OK:
                off_m = shift_m[:, None] + MM * size_mm * unit
                share = [float(np.mean([holds(plan, truth_m, off) for off in some])) for some in off_m]
                yield Promise(scene, number, size_mm, plan.probability, plan.slide_m, tuple(share))


def seen_scene(path: Path) -> tuple[PipelineResult, Float64[np.ndarray, "n 3"]]:
    """What perception and reconstruction make of a pair, and the true points, in metres."""
    about = json.loads(path.read_text())
    K = np.array(about["K"])
    size = about["width"], about["height"]
    camera = RectifiedStereo(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], MM * about["baseline_mm"], 1.0)
    left, right = (cv2.imread(str(path.with_name(f"{path.stem}_{side}.png"))) for side in ("left", "right"))
    assert left is not None and right is not None
    pair = np.asarray(left, np.uint8), np.asarray(right, np.uint8)
    seen = reconstruct_pair(pair, calibration_of(camera), masks=None, segmenter=None, method=DEFAULT_METHOD)
    return seen, MM * np.load(path.with_suffix(".npy"))[:, :3]


def holds(plan: GraspPlan, truth_m: Float64[np.ndarray, "n 3"], off_m: Float64[np.ndarray, "3"]) -> bool:
    """Whether fingers that are off by so much hold the true thread, as the geometric judge has it."""
    opened = max(waypoint.jaw_rad for waypoint in plan.waypoints)
    captured = next(waypoint for waypoint in plan.waypoints if waypoint.phase is Phase.CAPTURE)
    slid = [(waypoint, waypoint.jaw_rad, GIVE_M) for waypoint in plan.waypoints if waypoint.phase is Phase.SLIDE]
    sample = None
    for waypoint, opening, give in ((captured, opened, 0.0), *slid):
        points_tool = apply(inverse(waypoint.T_camera_tool), truth_m - off_m)
        sample = between(points_tool, opening, give, sample)
        if sample is None:
            return False
    return True


def skill(brier: float, base: float) -> float:
    """Of a score against that of always promising the base rate."""
    return 1.0 - brier / (base * (1.0 - base)) if 0.0 < base < 1.0 else float("nan")


def print_found(found: list[Promise]) -> None:
    """Skills, rates of each size, and the reliability of the promises."""
    promised = np.array([one.promised for one in found])
    held = np.array([one.held for one in found])
    size = np.array([one.tool_error_mm for one in found])
    share, base = held.mean(axis=1), float(held.mean())
    rate = {one: float(share[size == one].mean()) for one in np.unique(size)}
    by_size = np.array([rate[one] for one in size])
    # a share of so many draws is itself uncertain: p (1 - p) is too small by that
    knowing = float(np.mean(held * (1.0 - held))) * TOOLS / (TOOLS - 1)
    scores = {
        "what plans promise": float(np.mean(promised**2 - 2.0 * promised * share + share)),
        "the best that knows the size of the tool's error alone": float(np.mean(by_size * (1.0 - by_size))),
        "the best that knows all but how the tool errs": knowing,
    }
    table = Table(
        title=f"{len(found)} plans, {held.shape[1] * TOOLS} draws of each; {base:.1%} hold", title_justify="left"
    )
    for column in ("promise", "Brier score", "skill"):
        table.add_column(column)
    for name, brier in scores.items():
        table.add_row(name, f"{brier:.4f}", f"{skill(brier, base):.3f}")
    CONSOLE.print(table)
    sizes = Table(title="By the tool's error", title_justify="left")
    for column in ("mm", "plans", "mean promise", "held"):
        sizes.add_column(column)
    for one, here in rate.items():
        sizes.add_row(f"{one:g}", str((size == one).sum()), f"{promised[size == one].mean():.1%}", f"{here:.1%}")
    CONSOLE.print(sizes)
    bins = Table(title="Promised and held", title_justify="left")
    for column in ("promised", "plans", "mean promise", "held", "off"):
        bins.add_column(column)
    place = np.clip(np.searchsorted(EDGES, promised, side="right") - 1, 0, len(EDGES) - 2)
    for number in np.unique(place):
        here = place == number
        told, was = float(promised[here].mean()), float(share[here].mean())
        span = f"{EDGES[number]:g} to {EDGES[number + 1]:g}"
        bins.add_row(span, str(here.sum()), f"{told:.1%}", f"{was:.1%}", f"{was - told:+.1%}")
    CONSOLE.print(bins)
    # in order of what was promised, so many at a time
    order = np.argsort(promised, kind="stable")
    parts = np.array_split(order, max(1, len(order) // BIN))
    off = [float(share[part].mean() - promised[part].mean()) for part in parts]
    worst = max(off, key=abs)
    CONSOLE.print(
        f"in bins of {len(parts[0])} promises at most {worst:+.1%} off, {np.mean(share - promised):+.1%} in all"
    )


def simulated_arm() -> ArmView:
    """The demo's first arm, with its tool where it starts."""
    T_camera_base = SIMULATED_BASES["psm1"]
    T_base_camera = inverse(T_camera_base)
    reaches = reaches_of(psm.LARGE_NEEDLE_DRIVER, PlannerConfig().least_dexterity)
    at_rest = psm.forward(np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    return ArmView(T_camera_base, compose(T_camera_base, at_rest), lambda T: reaches(compose(T_base_camera, T)))


if __name__ == "__main__":
    main()
