"""How well the needle's pose is known, on path-traced scenes with their truth.

    .venv/bin/suturegrasp scenes render --config needle --background chicken paper --with tools --count 10 --seed S \
        --output DIR
    .venv/bin/suturegrasp scenes render --config needle --background pad phantom --with meshes \
        --meshes ../shared/data/instruments --samples 16 --count 10 --seed S --output DIR
    .venv/bin/python -m benchmarks.needle DIR

Each pair goes through perception and the needle agent as the first one of a session. An end is in view where both eyes
see it, of the point all but its last twentieth, which comes to nothing. Of needles that are refused the reason counts.
Where the thread is reconstructed too, the planner is asked for the place 15 mm of thread from the swage.
"""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from jaxtyping import Float64

from agents.needle.agent import Needle
from agents.perception.agent import Perception, PerceptionConfig
from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, curve_of
from agents.planner.goal import goal_on_thread
from agents.planner.needle import needle_around
from agents.reconstruction.agent import Reconstruction
from benchmarks.scenes import Scene, rendered
from benchmarks.tables import CONSOLE, Row, print_rows
from schemas.messages import (
    CommandHeader,
    FrameStamp,
    GraspGoal,
    ImageEncoding,
    NeedleObservations,
    NeedlePose,
    Policy,
    Status,
    StereoFrame,
    ThreadObservations,
)
from schemas.topics import CALIBRATION, FRAMES, NEEDLE_SEEN, OBSERVATIONS, THREAD
from shared.calibration.identity import calibration_id
from shared.clock import processor_s
from shared.images import encode_image
from shared.runtime.agent import Received, outputs_in

BOUNDS_MM, PLANE_DEG = (0.5, 2.0), 5.0
"""Of the tip's and the swage's error, median and worst, and of the plane's median: the goals."""
FROM_SWAGE_MM = 15.0


@dataclass(frozen=True)
class Options:
    """Which scenes."""

    folder: Annotated[Path, tyro.conf.Positional]


@dataclass(frozen=True)
class Found:
    """What one pair came to; errors are None where the needle was refused.

    Fields:
        both_in_view: whether both eyes see swage and point.
        deviations_off: errors of swage and point in standard deviations as they are stated.
        goal_mm: how far from the place FROM_SWAGE_MM along the true thread the planner takes it to be; None where it
            takes it to be nowhere.
    """

    name: str
    reason: str
    both_in_view: bool
    swage_mm: float | None = None
    point_mm: float | None = None
    plane_deg: float | None = None
    deviations_off: tuple[float, float] = (0.0, 0.0)
    step_ms: float = 0.0
    goal_mm: float | None = None


def main() -> None:
    """Print what came of each pair, and of all."""
    options = tyro.cli(Options, description=__doc__)
    found = [judged(path) for path in sorted(options.folder.glob("*_needle.npy"))]
    for one in found:
        errors = (one.swage_mm, one.point_mm, one.plane_deg)
        said = one.reason or "swage {:.2f} mm, point {:.2f} mm, plane {:.1f} deg".format(*errors)
        CONSOLE.print(f"{one.name:28} {'both ends' if one.both_in_view else '':10} {said}")
    goals = f"goals: swage and point {BOUNDS_MM[0]} mm median, {BOUNDS_MM[1]} worst; plane {PLANE_DEG} deg"
    both = [one for one in found if one.both_in_view]
    print_rows(f"needles; {goals}", [summed("both ends in view", both), summed("all", found)])
    for reason, count in Counter(one.reason for one in found if one.reason).most_common():
        CONSOLE.print(f"{count:3} refused: {reason}")


def observed(scene: Scene) -> tuple[NeedleObservations | None, ThreadObservations | None]:
    """What perception sees of needle and thread in a pair, as the first one of a session."""
    # as on a rig, whose calibration states no covariance
    camera = replace(scene.calibration, covariance=None)
    perception = Perception(PerceptionConfig(needle=True))
    outputs_in(perception.step(Received(CALIBRATION, "", 0, camera)))
    left, right = (encode_image(image, ImageEncoding.RAW) for image in scene.images)
    frame = StereoFrame(FrameStamp(1, 1, 1, calibration_id(camera)), left, right)
    by_topic = {out.topic: out.message for out in outputs_in(perception.step(Received(FRAMES, "", 0, frame)))}
    return by_topic.get(NEEDLE_SEEN), by_topic.get(OBSERVATIONS)


def judged(path: Path) -> Found:
    """What a pair comes to, by the table of its true needle."""
    truth = np.load(path).astype(np.float64)
    count, scene = len(truth), rendered(path.with_name(f"{path.stem.removesuffix('_needle')}.json"))
    swage, point = truth[2:8, 4:] > 0, truth[int(0.9 * count) : int(0.95 * count), 4:] > 0
    both = bool(swage.all() and point.all())
    seen, thread = observed(scene)
    if seen is None:
        return Found(scene.name, "perception looks for none", both)
    began_s = processor_s()
    (output,) = outputs_in(Needle().step(Received(NEEDLE_SEEN, "", 0, seen)))
    pose, step_ms = output.message, 1e3 * (processor_s() - began_s)
    if pose.status is not Status.OK:
        return Found(scene.name, pose.reason.partition(":")[0], both, step_ms=step_ms)
    found = _measured(scene.name, both, truth[:, :3], pose, step_ms)
    goal_mm = None if thread is None else _goal_mm(scene.threads[0].points, truth[0, :3], pose, thread)
    return replace(found, goal_mm=goal_mm)


def _goal_mm(
    true: Float64[np.ndarray, "n 3"],
    swage: Float64[np.ndarray, "3"],
    pose: NeedlePose,
    observations: ThreadObservations,
) -> float | None:
    """How far a goal FROM_SWAGE_MM along the thread is planned from where it truly is."""
    said = outputs_in(Reconstruction("refined").step(Received(OBSERVATIONS, "", 0, observations)))
    thread = next(output.message for output in said if output.topic is THREAD)
    goal = GraspGoal(
        CommandHeader("a", 1, "benchmark"), "psm1", Policy.DIRECT, None, None, None, from_swage_m=1e-3 * FROM_SWAGE_MM
    )
    try:
        curve = curve_of(thread)
        s = goal_on_thread(goal, curve, PlannerConfig(), needle_around(pose, thread, 1))
    except NoGraspError:
        return None
    if np.linalg.norm(true[0] - swage) > np.linalg.norm(true[-1] - swage):
        true = true[::-1]
    along_mm = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(true, axis=0), axis=1))]
    there = np.array([np.interp(FROM_SWAGE_MM, along_mm, true[:, i]) for i in range(3)])
    return float(np.linalg.norm(1e3 * curve.points(np.array([s]))[0] - there))


def _measured(name: str, both: bool, truth: Float64[np.ndarray, "n 3"], pose: NeedlePose, step_ms: float) -> Found:
    normal = np.linalg.svd(truth - truth.mean(axis=0))[2][2]
    z = np.zeros(3) if pose.T_camera_needle is None else pose.T_camera_needle[:3, 2]
    off, deviations = list[float](), list[float]()
    for angle, place in ((0.0, truth[0]), (pose.arc_rad, truth[-1])):
        error = pose.at(np.array([angle]))[0] - place
        off.append(float(np.linalg.norm(error)))
        deviations.append(float(np.sqrt(error @ np.linalg.solve(pose.covariance_at(angle), error))))
    plane_deg = float(np.degrees(np.arccos(min(1.0, abs(float(normal @ z))))))
    return Found(name, "", both, off[0], off[1], plane_deg, (deviations[0], deviations[1]), step_ms)


def summed(name: str, some: list[Found]) -> Row:
    """What some pairs came to; errors are median / worst."""
    told = [one for one in some if not one.reason]
    goals = [one.goal_mm for one in told if one.goal_mm is not None]
    # of a normal distribution in space 95 % lie within so many deviations
    inside = [off < 2.80 for one in told for off in one.deviations_off]
    return {
        "": name,
        "pairs": len(some),
        "told": len(told),
        "swage mm": _spread([one.swage_mm or 0.0 for one in told]),
        "point mm": _spread([one.point_mm or 0.0 for one in told]),
        "plane deg": _spread([one.plane_deg or 0.0 for one in told]),
        f"{FROM_SWAGE_MM:g} mm on, mm": f"{_spread(goals)} ({len(goals)})",
        "within 95 %": f"{np.mean(inside):.0%}" if inside else "-",
        "ms": f"{np.median([one.step_ms for one in some]):.0f}" if some else "-",
    }


def _spread(values: list[float]) -> str:
    return f"{np.median(values):.2f} / {max(values):.2f}" if values else "-"


if __name__ == "__main__":
    main()
