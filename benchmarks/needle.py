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

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64
from rich.console import Console
from rich.table import Table

from agents.needle.agent import Needle
from agents.perception.agent import Perception, PerceptionConfig
from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, curve_of
from agents.planner.goal import goal_on_thread
from agents.planner.needle import needle_around
from agents.reconstruction.agent import Reconstruction
from schemas.messages import (
    CommandHeader,
    FrameStamp,
    GraspGoal,
    Image,
    ImageEncoding,
    NeedleObservations,
    NeedlePose,
    Policy,
    Status,
    StereoCalibration,
    StereoFrame,
    ThreadObservations,
)
from schemas.topics import CALIBRATION, FRAMES, NEEDLE_SEEN, OBSERVATIONS, THREAD
from shared.calibration.identity import calibration_id
from shared.clock import processor_s
from shared.images import encode_image
from shared.runtime.agent import Received, outputs_in

CONSOLE = Console(width=140)
BOUNDS_MM, PLANE_DEG = (0.5, 2.0), 5.0
"""Of the tip's and the swage's error, median and worst, and of the plane's median: the goals."""
FROM_SWAGE_MM = 15.0


@dataclass(frozen=True)
class Row:
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


def rows(folder: Path) -> Iterator[Row]:
    """One for each pair with a needle in a folder."""
    for truth in sorted(folder.glob("*_needle.npy")):
        yield _row(truth.with_name(truth.name.removesuffix("_needle.npy")))


def observed(path: Path) -> tuple[NeedleObservations | None, ThreadObservations | None]:
    """What perception sees of needle and thread in a pair that was written as `path`_left.png and so on."""
    about = json.loads(path.with_name(f"{path.name}.json").read_text(encoding="utf-8"))
    K, T = np.array(about["K"]), np.eye(4)
    T[0, 3] = -about["baseline_mm"]
    none = np.zeros(0)
    camera = StereoCalibration(about["width"], about["height"], K, K, none, none, T, 1e-3)
    stamp = FrameStamp(1, 1, 1, calibration_id(camera))
    perception = Perception(PerceptionConfig(needle=True))
    outputs_in(perception.step(Received(CALIBRATION, "", 0, camera)))
    frame = StereoFrame(stamp, _image(path, "left"), _image(path, "right"))
    said = outputs_in(perception.step(Received(FRAMES, "", 0, frame)))
    by_topic = {output.topic: output.message for output in said}
    return by_topic.get(NEEDLE_SEEN), by_topic.get(OBSERVATIONS)


def _image(path: Path, side: str) -> Image:
    return encode_image(np.asarray(cv2.imread(f"{path}_{side}.png")), ImageEncoding.RAW)


def _row(path: Path) -> Row:
    truth = np.load(path.with_name(f"{path.name}_needle.npy")).astype(np.float64)
    count = len(truth)
    swage, point = truth[2:8, 4:] > 0, truth[int(0.9 * count) : int(0.95 * count), 4:] > 0
    both = bool(swage.all() and point.all())
    seen, thread = observed(path)
    if seen is None:
        return Row(path.name, "perception looks for none", both)
    began_s = processor_s()
    (output,) = outputs_in(Needle().step(Received(NEEDLE_SEEN, "", 0, seen)))
    pose, step_ms = output.message, 1e3 * (processor_s() - began_s)
    if pose.status is not Status.OK:
        return Row(path.name, pose.reason.partition(":")[0], both, step_ms=step_ms)
    row = _measured(path.name, both, truth[:, :3], pose, step_ms)
    return replace(row, goal_mm=None if thread is None else _goal_mm(path, truth[0, :3], pose, thread))


def _goal_mm(
    path: Path, swage: Float64[np.ndarray, "3"], pose: NeedlePose, observations: ThreadObservations
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
    true = np.load(path.with_name(f"{path.name}.npy")).astype(np.float64)[:, :3]
    if np.linalg.norm(true[0] - swage) > np.linalg.norm(true[-1] - swage):
        true = true[::-1]
    along_mm = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(true, axis=0), axis=1))]
    there = np.array([np.interp(FROM_SWAGE_MM, along_mm, true[:, i]) for i in range(3)])
    return float(np.linalg.norm(1e3 * curve.points(np.array([s]))[0] - there))


def _measured(name: str, both: bool, truth: Float64[np.ndarray, "n 3"], pose: NeedlePose, step_ms: float) -> Row:
    normal = np.linalg.svd(truth - truth.mean(axis=0))[2][2]
    z = np.zeros(3) if pose.T_camera_needle is None else pose.T_camera_needle[:3, 2]
    off, deviations = list[float](), list[float]()
    for angle, place in ((0.0, truth[0]), (pose.arc_rad, truth[-1])):
        error = pose.at(np.array([angle]))[0] - place
        off.append(float(np.linalg.norm(error)))
        deviations.append(float(np.sqrt(error @ np.linalg.solve(pose.covariance_at(angle), error))))
    plane_deg = float(np.degrees(np.arccos(min(1.0, abs(float(normal @ z))))))
    return Row(name, "", both, off[0], off[1], plane_deg, (deviations[0], deviations[1]), step_ms)


def report(found: list[Row]) -> Table:
    """A row for what all pairs came to, and for those with both ends in view."""
    table = Table(
        title=f"needle: swage and point {BOUNDS_MM[0]} mm median, {BOUNDS_MM[1]} worst; plane {PLANE_DEG} deg"
    )
    for column in (
        "pairs",
        "",
        "told",
        "swage mm",
        "point mm",
        "plane deg",
        f"{FROM_SWAGE_MM:g} mm on, mm",
        "within 95 %",
        "ms",
    ):
        table.add_column(column)
    for name, chosen in (("both ends in view", [row for row in found if row.both_in_view]), ("all", found)):
        told = [row for row in chosen if not row.reason]
        cells = [
            "-" if not told else f"{np.median(values):.2f} / {max(values):.2f}"
            for values in (
                [row.swage_mm or 0.0 for row in told],
                [row.point_mm or 0.0 for row in told],
                [row.plane_deg or 0.0 for row in told],
            )
        ]
        goals = [row.goal_mm for row in told if row.goal_mm is not None]
        cells.append(f"{np.median(goals):.2f} / {max(goals):.2f} ({len(goals)})" if goals else "-")
        # of a normal distribution in space 95 % lie within so many deviations
        inside = [one < 2.80 for row in told for one in row.deviations_off]
        within = f"{np.mean(inside):.0%}" if inside else "-"
        ms = f"{np.median([row.step_ms for row in chosen]):.0f}" if chosen else "-"
        table.add_row(str(len(chosen)), name, str(len(told)), *cells, within, ms)
    return table


def main() -> None:
    """Print what came of each pair, and of all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    found = list(rows(parser.parse_args().folder))
    for row in found:
        errors = (row.swage_mm, row.point_mm, row.plane_deg)
        said = row.reason or "swage {:.2f} mm, point {:.2f} mm, plane {:.1f} deg".format(*errors)
        CONSOLE.print(f"{row.name:28} {'both ends' if row.both_in_view else '':10} {said}")
    CONSOLE.print(report(found))
    for reason, count in Counter(row.reason for row in found if row.reason).most_common():
        CONSOLE.print(f"{count:3} refused: {reason}")


if __name__ == "__main__":
    main()
