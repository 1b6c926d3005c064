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

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from jaxtyping import Bool, Float64

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
from benchmarks.scenes import Scene, reconstructed, rendered
from benchmarks.tables import CONSOLE, Row, print_rows, write_json
from schemas.messages import (
    CommandHeader,
    GraspGoal,
    GraspPlan,
    Phase,
    Policy,
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
MM = 1e-3


@dataclass(frozen=True)
class Options:
    """Which scenes, and which errors."""

    scenes: Path | None = None
    """Folder of path-traced pairs with truth."""
    only: str = ""
    """Scenes whose name contains this."""
    goals: int = 5
    tool_error: tuple[float, ...] = (0.0, 1.0, 2.0, 3.0, 4.0)
    """Deviations of each axis of the tool tip, in mm."""
    hand_eye: float = 1.5
    """The most by which the registration is off, in mm."""
    calibrations: int = 0
    """Drawn for each scene; 0: the true one."""
    seed: int = 1
    json: Path = Path("out/promises.json")


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
    options = tyro.cli(Options, description=__doc__)
    print_rows(*bound(options))
    if options.scenes is None:
        return
    paths = sorted(path for path in options.scenes.glob("*.json") if options.only in path.stem)
    if not paths:
        raise SystemExit(f"no scene under {options.scenes} has a name that contains {options.only!r}")
    found = [one for path in paths for one in of_scene(rendered(path), options)]
    write_json(options.json, [asdict(one) for one in found])
    if not found:
        raise SystemExit("there is no plan for any goal")
    print_found(found)


def bound(options: Options) -> tuple[str, list[Row]]:
    """Of thread whose place is known, for each opening: rates by size, and the skill of the best promises."""
    shift_m = shifts_m(np.random.default_rng(options.seed), BOUND_DRAWS, options.hand_eye)
    config = PlannerConfig()
    depth_m = max(config.depths_m)
    mean = np.array([0.0, FINGER_M - depth_m]) + shift_m[:, :2]
    spreads = [np.broadcast_to((MM * size) ** 2 * np.eye(2), (BOUND_DRAWS, 2, 2)) for size in options.tool_error]
    rows: list[Row] = []
    for open_deg in config.opens_deg:
        rates = np.array([wedge_probability(mean, spread, np.radians(open_deg)) for spread in spreads])
        by_size, base = rates.mean(axis=1), float(rates.mean())
        sizes = {f"{size:g} mm": f"{rate:.1%}" for size, rate in zip(options.tool_error, by_size, strict=True)}
        names = "knowing the size", "and the registration"
        skills = (skill(float(np.mean(known * (1.0 - known))), base) for known in (by_size, rates))
        rows.append({"open": f"{open_deg:g}°"} | sizes | dict(zip(names, skills, strict=True)))
    return f"Thread known exactly, {depth_m / MM:g} mm deep: held, best skill", rows


def shifts_m(rng: np.random.Generator, count: int, most_mm: float) -> Float64[np.ndarray, "n 3"]:
    """Errors of a registration: in any direction, of any length up to the most."""
    way = rng.normal(size=(count, 3))
    return MM * rng.uniform(0.0, most_mm, (count, 1)) * way / np.linalg.norm(way, axis=1, keepdims=True)


def of_scene(scene: Scene, options: Options) -> Iterator[Promise]:
    """All plans of one scene."""
    seen, truth_mm = reconstructed(scene), scene.threads[0].points
    rng = np.random.default_rng([options.seed, *scene.name.encode()])
    drawn = [
        with_other_calibration(seen.observations, truth_mm, errors)
        for errors in drawn_errors(rng, options.calibrations)
    ] or [(seen.reconstruction, truth_mm)]
    for thread, true_mm in drawn:
        yield from plans_of(scene.name, thread, MM * true_mm, rng, options)


def with_other_calibration(
    observations: ThreadObservations, truth: Float64[np.ndarray, "n 3"], errors: Float64[np.ndarray, "8"]
) -> tuple[ThreadReconstruction, Float64[np.ndarray, "n 3"]]:
    """The thread as a wrong calibration has it, and the true points where a robot has them that was found with it."""
    stated = replace(wrongly(observations, errors), calibration_covariance=usual_covariance())
    thread = METHODS[DEFAULT_METHOD](stated)
    R, t = hand_eye(observations.camera, errors, float(np.median(truth[:, 2])))
    return thread, (truth - t) @ R


def plans_of(
    scene: str,
    thread: ThreadReconstruction,
    truth_m: Float64[np.ndarray, "n 3"],
    rng: np.random.Generator,
    options: Options,
) -> Iterator[Promise]:
    """A plan for each goal and size of error, and how often it holds."""
    if thread.status is not Status.OK:
        return
    for number, s in enumerate(seen_places(thread, options.goals)):
        shift_m = shifts_m(rng, REGISTRATIONS, options.hand_eye)
        unit = rng.normal(size=(REGISTRATIONS, TOOLS, 3))
        for size_mm in options.tool_error:
            tool_m, registration_m = MM * size_mm, MM * options.hand_eye
            config = PlannerConfig(least_probability=0.0, tool_error_m=tool_m, hand_eye_error_m=registration_m)
            goal = GraspGoal(CommandHeader("g", 0, "benchmark"), "psm1", Policy.CAPTURE_SLIDE_GRASP, s, None, None)
            plan = plan_grasp(goal, thread, simulated_arm(), config)
            if plan.status is Status.OK:
                off_m = shift_m[:, None] + MM * size_mm * unit
                share = [float(np.mean([holds(plan, truth_m, off) for off in some])) for some in off_m]
                yield Promise(scene, number, size_mm, plan.probability, plan.slide_m, tuple(share))


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
    print_rows(
        f"{len(found)} plans, {held.shape[1] * TOOLS} draws of each; {base:.1%} hold",
        [{"promise": name, "Brier score": brier, "skill": skill(brier, base)} for name, brier in scores.items()],
    )
    print_rows("By the tool's error", [_bin(f"{one:g} mm", size == one, promised, share) for one in rate])
    place = np.clip(np.searchsorted(EDGES, promised, side="right") - 1, 0, len(EDGES) - 2)
    print_rows(
        "Promised and held",
        [_bin(f"{EDGES[k]:g} to {EDGES[k + 1]:g}", place == k, promised, share) for k in np.unique(place)],
    )
    # in order of what was promised, so many at a time
    order = np.argsort(promised, kind="stable")
    parts = np.array_split(order, max(1, len(order) // BIN))
    off = [float(share[part].mean() - promised[part].mean()) for part in parts]
    worst = max(off, key=abs)
    CONSOLE.print(
        f"in bins of {len(parts[0])} promises at most {worst:+.1%} off, {np.mean(share - promised):+.1%} in all"
    )


def _bin(
    name: str, here: Bool[np.ndarray, "n"], promised: Float64[np.ndarray, "n"], share: Float64[np.ndarray, "n"]
) -> Row:
    told, was = promised[here].mean(), share[here].mean()
    shares = {"mean promise": f"{told:.1%}", "held": f"{was:.1%}", "off": f"{was - told:+.1%}"}
    return {"": name, "plans": int(here.sum())} | shares


def simulated_arm() -> ArmView:
    """The demo's first arm, with its tool where it starts."""
    T_camera_base = SIMULATED_BASES["psm1"]
    T_base_camera = inverse(T_camera_base)
    reaches = reaches_of(psm.LARGE_NEEDLE_DRIVER, PlannerConfig().least_dexterity)
    at_rest = psm.forward(np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    return ArmView(T_camera_base, compose(T_camera_base, at_rest), lambda T: reaches(compose(T_base_camera, T)))


if __name__ == "__main__":
    main()
