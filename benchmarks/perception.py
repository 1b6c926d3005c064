"""How well perception finds the thread in raw images, and how fast: scenes, thread-free frames and times.

    .venv/bin/python -m benchmarks.perception --data ../shared/data

Every render is run without masks, as `suturegrasp reconstruct` would run it. Prints a table of the scenes, false
threads and times, and the table of goals; writes JSON. Recall and precision are those of centrelines within 2 px, over
both images. Times are those of the agent's step, raw images to message: of a first frame, and around the last thread
of the same pair some pixels on, as a thread moves.
"""

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from jaxtyping import Bool, Float64
from rich.progress import track

from agents.cli.reconstruct.pipeline import Pair, PipelineResult
from agents.perception.agent import Perception, PerceptionConfig
from agents.perception.segmenter_names import NETWORK
from benchmarks.curve_verdicts import near
from benchmarks.measures import coverage_of, figures, topology_is_right, topology_of
from benchmarks.pictures import GREEN, RED, YELLOW, dotted, save
from benchmarks.scenes import CLEAR, CROSSING, SHOWN_RENDERS, Run, Scene, TrueThread, reconstructed, scenes
from benchmarks.tables import CONSOLE, Goal, Row, print_goals, print_rows, share, write_json
from benchmarks.thread_free import thread_free
from schemas.messages import Centrelines, FrameStamp, ImageEncoding, Status, StereoFrame
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS
from shared.camera import project
from shared.clock import processor_s
from shared.curve_distance import distances_to_polyline
from shared.images import encode_image
from shared.runtime.agent import Received, outputs_in
from shared.runtime.process import keep_freed_memory

Counts = dict[str, dict[str, int]]

LEAST_ALL, LEAST_WORST = 0.98, 0.93
CLEAR_MEDIAN_MM, WORST_MM = 0.10, 0.60
CROSSING_MM, CROSSING_FRECHET_MM = 0.50, 4.0
INSIDE, LEAST_INSIDE = (0.93, 0.98), 0.80
FALSE_PER_FRAME = 1e-3
NEAR_PX = 2.0
"""What lies within that of the other counts as the same."""
STEP_PX = (3, 2)
"""Columns and rows by which the thread moves from frame to frame."""
FRAMES_TRACKED, RATE_HZ = 4, 30.0


@dataclass(frozen=True)
class Options:
    """What is looked at, and where the figures go."""

    data: Path = Path("../shared/data")
    """Folder of scenes."""
    segmenters: tuple[str, ...] = (NETWORK,)
    only: str = ""
    """Scenes whose name contains this."""
    empty: int = 50
    """Thread-free frames that are rendered and looked at."""
    thread_free: tuple[Path, ...] = ()
    """Folders of path-traced scenes, of which those without thread are looked at too."""
    seed: int = 0
    """Of the thread-free frames."""
    scenes: bool = True
    """Look at scenes with thread, too."""
    times: bool = True
    """Measure times, too."""
    json: Path = Path("out/perception.json")
    pictures: Path | None = None
    """Folder for a picture of what was found, missed and false."""


def main() -> None:
    """Run the benchmark from the command line."""
    options = tyro.cli(Options, description=__doc__)
    chosen = [
        load
        for name, group, load in scenes(options.data)
        if group in SHOWN_RENDERS and options.only in name and options.scenes
    ]
    if not (chosen or not options.scenes):
        raise SystemExit(f"no render under {options.data} has a name that contains {options.only!r}")
    measured: dict[str, Row] = {}
    for segmenter in options.segmenters:
        rows = [row_of(load(), segmenter, options.times, options.pictures) for load in chosen]
        empty = (
            false_threads(options.empty, segmenter, options.seed, options.thread_free, options.pictures)
            if options.empty
            else None
        )
        measured[segmenter] = {"rows": rows, "thread-free": empty}
        print_scenes(segmenter, rows)
        of_scenes = [*_shares(rows), *_curves(rows), *_believed(rows)] if rows else []
        print_goals(f"goals, {segmenter}", [*of_scenes, *_empty(empty), *_times(rows)])
    write_json(options.json, measured)


def row_of(scene: Scene, segmenter: str, timed: bool = False, pictures: Path | None = None) -> Row:
    """The figures of one scene."""
    result = reconstructed(scene, segmenter=segmenter)
    row = found_row(scene, result)
    if timed:
        row["times_ms"] = times_ms(scene, segmenter)
    if pictures is not None:
        save_finding(pictures / f"{segmenter} {scene.name}.png", scene, result)
    return row


def found_row(scene: Scene, result: PipelineResult) -> Row:
    """The figures of a scene that was reconstructed without masks, by its first thread."""
    return figures(Run(scene), result) | shares_of(scene.threads[0], result)


def print_scenes(segmenter: str, rows: list[Row]) -> None:
    """One row for each scene."""
    table = [
        {name: row[name] for name in ("scene", "group", "status")}
        | {"recall": f"{recall(row):.1%}", "precision": f"{precision(row):.1%}"}
        | {name: row[name] for name in ("off px", "said px", "mean", "mean seen", "frechet")}
        | {"in ellipse": share(*coverage_of(row)), "topology": topology_of(row)}
        | {f"{name} ms": ms for name, ms in row.get("times_ms", {}).items()}
        for row in rows
    ]
    print_rows(f"{segmenter}: centrelines within 2 px; off: of those, rms across the thread, and as said", table)
    for row in rows:
        if row["reason"]:
            CONSOLE.print(f"  {row['scene']}: {row['reason']}")


def recall(row: Row) -> float:
    """The share of the thread's true centreline in both images that was found."""
    return row["found"] / max(row["true"], 1)


def precision(row: Row) -> float:
    """The share of what was found in both images that lies on the thread."""
    return row["right"] / max(row["given"], 1)


def _shares(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    shares: tuple[tuple[str, str, str, Callable[[Row], float]], ...] = (
        ("recall", "found", "true", recall),
        ("precision", "right", "given", precision),
    )
    for name, part, whole, of in shares:
        every = sum(row[part] for row in rows) / max(sum(row[whole] for row in rows), 1)
        worst = min(rows, key=of)
        what = f"centreline within 2 px, {name}, "
        result += [
            Goal(what + "all scenes", f"{every:.2%}", f"≥ {LEAST_ALL:.0%}", every >= LEAST_ALL),
            Goal(
                what + "worst scene",
                f"{of(worst):.1%} ({worst['scene']})",
                f"≥ {LEAST_WORST:.0%}",
                of(worst) >= LEAST_WORST,
            ),
        ]
    failed = sum(row["status"] != "ok" for row in rows)
    return [*result, Goal("scenes without a curve", f"{failed} of {len(rows)}", "0", failed == 0)]


def _curves(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    if clear := _known([row for row in rows if row["group"] == CLEAR], "mean"):
        median = statistics.median(row["mean"] for row in clear)
        what = "mean curve error, median of scenes without crossings or occlusion, mm"
        result.append(Goal(what, f"{median:.3f}", f"≤ {CLEAR_MEDIAN_MM:g}", median <= CLEAR_MEDIAN_MM))
    if seen := _known(rows, "mean seen"):
        result.append(_worst("mean curve error of visible parts, worst scene, mm", seen, "mean seen", WORST_MM))
    if crossing := _known([row for row in rows if row["group"] == CROSSING], "mean"):
        right, what = sum(topology_is_right(row) for row in crossing), "scenes with crossings: "
        result += [
            _worst(what + "mean error, worst, mm", crossing, "mean", CROSSING_MM),
            _worst(what + "Fréchet, worst, mm", crossing, "frechet", CROSSING_FRECHET_MM),
            Goal(what + "topology right", f"{right} of {len(crossing)}", "all", right == len(crossing)),
        ]
    return result


def _known(rows: list[Row], measure: str) -> list[Row]:
    return [row for row in rows if row[measure] is not None]


def _worst(what: str, rows: list[Row], measure: str, limit: float) -> Goal:
    worst = max(rows, key=lambda row: row[measure])
    return Goal(what, f"{worst[measure]:.3f} ({worst['scene']})", f"≤ {limit:g}", worst[measure] <= limit)


def _believed(rows: list[Row]) -> list[Goal]:
    counted = {row["scene"]: coverage_of(row) for row in rows if row["coverage"]}
    if not counted:
        return []
    inside, places = np.sum(list(counted.values()), axis=0)
    every = inside / places
    worst = min(counted, key=lambda scene: counted[scene][0] / counted[scene][1])
    least = counted[worst][0] / counted[worst][1]
    low, high = INSIDE
    return [
        Goal("95 % ellipse, all scenes", f"{every:.1%}", f"{low:.0%} to {high:.0%}", bool(low <= every <= high)),
        Goal("95 % ellipse, worst scene", f"{least:.1%} ({worst})", f"≥ {LEAST_INSIDE:.0%}", least >= LEAST_INSIDE),
    ]


def _empty(empty: Counts | None) -> list[Goal]:
    if empty is None:
        return []
    every = {
        name: sum(of_kind[name] for of_kind in empty.values()) for name in ("frames", "perception", "reconstruction")
    }
    met = every["perception"] <= FALSE_PER_FRAME * max(every["frames"], 1 / FALSE_PER_FRAME)
    result = [Goal("false threads in thread-free frames", _said(every), "≤ 1 of 1000", met)]
    return result + [Goal(f"of these, in {kind}", _said(of_kind)) for kind, of_kind in empty.items()]


def _said(counts: dict[str, int]) -> str:
    return f"{counts['perception']} of {counts['frames']}, {counts['reconstruction']} of them with a curve"


def _times(rows: list[Row]) -> list[Goal]:
    what = {"first": "a first frame", "near": "a frame around the last thread"}
    found = {name: [row["times_ms"][name] for row in rows if name in row.get("times_ms", {})] for name in what}
    return [
        Goal(f"time of the processor, median, ms: {what[name]}", f"{statistics.median(ms):.1f}")
        for name, ms in found.items()
        if ms
    ]


def times_ms(scene: Scene, segmenter: str) -> dict[str, float]:
    """Median milliseconds of the processor of the agent's steps: for first frames, and near the last thread."""
    # as in an agent's process
    cv2.setNumThreads(1)
    keep_freed_memory()
    agent = Perception(PerceptionConfig(segmenter=segmenter))
    list(agent.step(Received(CALIBRATION, str(CALIBRATION), 1, scene.calibration)))
    taken: dict[str, list[float]] = {"first": [], "near": []}
    for number in range(FRAMES_TRACKED + 1):
        left, right = (encode_image(image, ImageEncoding.RAW) for image in moved(scene.images, number))
        at_ns, begun_s = round(1e9 * number / RATE_HZ), processor_s()
        frame = StereoFrame(FrameStamp(number, at_ns, at_ns, ""), left, right)
        outputs = outputs_in(agent.step(Received(FRAMES, str(FRAMES), 1, frame)))
        took_ms = 1e3 * (processor_s() - begun_s)
        seen = next(out.message for out in outputs if out.topic is OBSERVATIONS)
        taken["first" if seen.looked_sequence == number else "near"].append(took_ms)
    return {name: statistics.median(ms) for name, ms in taken.items() if ms}


def moved(images: Pair, frames: int) -> Pair:
    """Both images after some frames of a steady motion; what leaves on one side comes in on the other."""
    by = STEP_PX[1] * frames, STEP_PX[0] * frames
    return np.roll(images[0], by, axis=(0, 1)), np.roll(images[1], by, axis=(0, 1))


@dataclass(frozen=True)
class Shares:
    """Counts of places about a pixel apart, whose shares are recall and precision.

    Fields:
        found, true: places on the true centreline that the image shows; those near what was found, and all.
        right, given: places that were found; those near the true centreline, and all.
        apart_px: how far each right place lies from the true centreline, to its left or right.
        deviation_px: how far it may lie off, as perception says.
    """

    found: int
    true: int
    right: int
    given: int
    apart_px: Float64[np.ndarray, "n"]
    deviation_px: Float64[np.ndarray, "n"]


def shares(lines: Centrelines, truth_px: Float64[np.ndarray, "m 2"], visible: Bool[np.ndarray, "m"]) -> Shares:
    """Centrelines of one image against the projected truth, of which the visible part counts.

    Args:
        truth_px: evenly spaced along the thread, less than a pixel apart.
    """
    step = np.linalg.norm(np.diff(truth_px, axis=0, prepend=truth_px[:1]), axis=1)
    # a place for each pixel of the way, so that a thread that comes towards the camera does not count for more
    whole = np.floor(np.cumsum(step))
    places = truth_px[(np.diff(whole, prepend=-1) > 0) & visible]
    points = lines.point_px
    if len(points) == 0 or len(places) == 0:
        return Shares(0, len(places), 0, len(points), np.zeros(0), np.zeros(0))
    # what is hidden lies between what is seen: a polyline through the seen parts alone would bridge it
    apart = distances_to_polyline(points, truth_px)
    near_seen = near(points, truth_px[visible], NEAR_PX)
    return Shares(
        found=int(near(places, points, NEAR_PX).sum()),
        true=len(places),
        right=int(near_seen.sum()),
        given=len(points),
        apart_px=apart[near_seen],
        deviation_px=lines.deviation_px[near_seen],
    )


def shares_of(true: TrueThread, result: PipelineResult) -> Row:
    """Counts of both images, and how far what is right lies off, rms, and may lie off, as perception says."""
    seen = result.observations
    lines, truth = (seen.centrelines_left, seen.centrelines_right), project(seen.camera, true.points)
    both = [shares(*of_eye) for of_eye in zip(lines, truth, true.visible.T, strict=True)]
    counts: Row = {name: sum(getattr(part, name) for part in both) for name in ("found", "true", "right", "given")}
    for name, of in (("off px", "apart_px"), ("said px", "deviation_px")):
        values = np.concatenate([getattr(part, of) for part in both])
        counts[name] = float(np.sqrt(np.mean(values**2))) if len(values) else None
    return counts


def save_finding(path: Path, scene: Scene, result: PipelineResult) -> None:
    """Write both images side by side: right centrelines green, false ones yellow, missed truth red."""
    seen, drawn = result.observations, []
    truths = (
        [px[eye] for px, eye in zip(project(seen.camera, true.points), true.visible.T, strict=True)]
        if (true := next(iter(scene.threads), None))
        else [np.zeros((0, 2))] * 2
    )
    for image, lines, true_px in zip(
        result.images, (seen.centrelines_left, seen.centrelines_right), truths, strict=True
    ):
        right, missed = near(lines.point_px, true_px, NEAR_PX), ~near(true_px, lines.point_px, NEAR_PX)
        layers = (lines.point_px[right], GREEN), (lines.point_px[~right], YELLOW), (true_px[missed], RED)
        drawn.append(dotted(image, *layers))
    save(path, *drawn)


def false_threads(
    frames: int, segmenter: str, seed: int = 0, folders: Sequence[Path] = (), pictures: Path | None = None
) -> Counts:
    """How often perception, and reconstruction after it, takes something for thread, by kind of scene.

    Args:
        pictures: folder for a picture of each false thread.
    """
    counts: Counts = {}
    every = thread_free(frames, seed, folders)
    for scene in track(every, f"thread-free frames, {segmenter}", frames, transient=True):
        result = reconstructed(scene, segmenter=segmenter)
        of_kind = counts.setdefault(scene.group, {"frames": 0, "perception": 0, "reconstruction": 0})
        of_kind["frames"] += 1
        of_kind["perception"] += result.observations.status is Status.OK
        of_kind["reconstruction"] += result.reconstruction.status is Status.OK
        if pictures is not None and result.observations.status is Status.OK:
            save_finding(pictures / f"{segmenter} {scene.group} {scene.name}.png", scene, result)
    return counts


if __name__ == "__main__":
    main()
