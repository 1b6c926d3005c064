"""How well perception finds the thread in raw images, and how fast: scenes, thread-free frames and times.

    .venv/bin/python -m benchmarks.perception --data ../shared/data

Every render is run without masks, as `suturegrasp reconstruct` would run it. Prints a table of the scenes, false
threads and times, and the table of goals; writes JSON. Recall and precision are those of centrelines within 2 px, over
both images. For times the same pair is seen again and again, each time some pixels on, as a thread moves; they are the
least of some runs, by the clock on the wall and as time of the processor.
"""

import argparse
import json
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial import KDTree

from agents.cli.reconstruct.pipeline import PipelineResult, reconstruct_pair
from agents.perception.agent import Perception, PerceptionConfig
from agents.perception.centrelines import thread_centrelines
from agents.perception.following.pair import FollowedPair, follow_pair
from agents.perception.instances import as_sent
from agents.perception.observe import observe
from agents.perception.search import Looked, look_everywhere, look_near
from agents.perception.segmenter_names import NETWORK
from agents.reconstruction.method_names import DEFAULT_METHOD
from benchmarks.measures import Goal, figures, topology_is_right
from benchmarks.scenes import CLEAR, CROSSING, NONE, OCCLUSION, Pair, Run, Scene, scenes
from benchmarks.tables import coverage_of, shown, topology_of
from benchmarks.thread_free import thread_free
from schemas.messages import (
    Centrelines,
    FrameStamp,
    ImageEncoding,
    RectifiedStereo,
    Status,
    StereoFrame,
    ThreadObservations,
)
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS
from shared.camera import project
from shared.clock import Stopwatch, processor_s
from shared.curve_distance import distances_to_polyline
from shared.images import encode_image
from shared.runtime.agent import Received, outputs_in
from shared.runtime.process import keep_freed_memory

Row = dict[str, Any]
Counts = dict[str, dict[str, int]]

LEAST_ALL, LEAST_WORST = 0.98, 0.93
CLEAR_MEDIAN_MM, WORST_MM = 0.10, 0.60
CROSSING_MM, CROSSING_FRECHET_MM = 0.50, 4.0
INSIDE, LEAST_INSIDE = (0.93, 0.98), 0.80
FALSE_PER_FRAME = 1e-3
FIRST_MS, NEAR_MS = 80.0, 20.0
TIMES = {
    "first": "first frame, both images to centrelines",
    "near": "around the last thread, both images to centrelines",
    "pixels near": "the same where it is not followed",
    "step first": "the agent's step for a first frame, raw images to message",
    "step near": "the agent's step around the last thread, raw images to message",
}


def print_scenes(console: Console, segmenter: str, rows: list[Row]) -> None:
    """One row for each scene."""
    title = f"{segmenter}: centrelines within 2 px; off: of those, rms across the thread, and as perception says"
    table = Table(title=title, title_justify="left")
    for column in ("scene", "kind", "status"):
        table.add_column(column, no_wrap=True)
    numbers = ("recall", "precision", "off px", "said px", "mean mm", "seen mm", "frechet", "in ellipse")
    for column in (*numbers, "topology", "first ms", "near ms", "tracked"):
        table.add_column(column, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(
            *(row["scene"], row["group"].removesuffix(" render"), row["status"]),
            *(f"{share:.1%}" for share in (recall(row), precision(row))),
            *(shown(row[name]) for name in ("off px", "said px", "mean", "mean seen", "frechet")),
            *(coverage_of(row), topology_of(row)),
            *(shown_ms(row, name) for name in ("first", "near", "tracked")),
        )
    console.print(table)
    for row in rows:
        if row["reason"]:
            console.print(f"  {row['scene']}: {row['reason']}")


def print_goals(console: Console, segmenter: str, rows: list[Row], empty: Counts | None) -> None:
    """The table of goals of one segmenter."""
    table = Table("what", "goal", "here", "", title=f"goals, {segmenter}", title_justify="left")
    of_scenes = [*_shares(rows), *_curves(rows), *_believed(rows)] if rows else []
    found = [*of_scenes, *_empty(empty), *_times(rows)]
    for goal in found:
        verdict = {True: "[green]met[/]", False: "[red]not met[/]", None: ""}[goal.met]
        table.add_row(goal.what, goal.goal, goal.figure, verdict)
    console.print(table)


def recall(row: Row) -> float:
    """The share of the thread's true centreline in both images that was found."""
    return row["found"] / max(row["true"], 1)


def precision(row: Row) -> float:
    """The share of what was found in both images that lies on the thread."""
    return row["right"] / max(row["given"], 1)


def shown_ms(row: Row, name: str) -> str:
    """A time of a row, where it was measured."""
    value = row.get("times_ms", {}).get(name)
    return "-" if value is None else f"{value:.0f}" if name == "tracked" else f"{value:.1f}"


def _shares(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    shares: tuple[tuple[str, str, str, Callable[[Row], float]], ...] = (
        ("recall", "found", "true", recall),
        ("precision", "right", "given", precision),
    )
    for name, part, whole, of in shares:
        share = sum(row[part] for row in rows) / max(sum(row[whole] for row in rows), 1)
        worst = min(rows, key=of)
        goal = f"≥ {LEAST_ALL:.0%}"
        result.append(Goal(f"centreline within 2 px, {name}, all scenes", "", goal, f"{share:.2%}", share >= LEAST_ALL))
        figure = f"{of(worst):.1%} ({worst['scene']})"
        what = f"centreline within 2 px, {name}, worst scene"
        result.append(Goal(what, "", f"≥ {LEAST_WORST:.0%}", figure, of(worst) >= LEAST_WORST))
    failed = sum(row["status"] != "ok" for row in rows)
    result.append(Goal("scenes without a curve", "", "0", f"{failed} of {len(rows)}", failed == 0))
    return result


def _curves(rows: list[Row]) -> list[Goal]:
    result: list[Goal] = []
    if clear := _known([row for row in rows if row["group"] == CLEAR], "mean"):
        median = statistics.median(row["mean"] for row in clear)
        what = "mean curve error, median of scenes without crossings or occlusion, mm"
        result.append(Goal(what, "", f"≤ {CLEAR_MEDIAN_MM:g}", f"{median:.3f}", median <= CLEAR_MEDIAN_MM))
    if seen := _known(rows, "mean seen"):
        result.append(_worst("mean curve error of visible parts, worst scene, mm", seen, "mean seen", WORST_MM))
    if crossing := _known([row for row in rows if row["group"] == CROSSING], "mean"):
        right = sum(topology_is_right(row) for row in crossing)
        result += [
            _worst("scenes with crossings: mean error, worst, mm", crossing, "mean", CROSSING_MM),
            _worst("scenes with crossings: Fréchet, worst, mm", crossing, "frechet", CROSSING_FRECHET_MM),
            Goal(
                "scenes with crossings: topology right",
                "",
                "all",
                f"{right} of {len(crossing)}",
                right == len(crossing),
            ),
        ]
    return result


def _known(rows: list[Row], measure: str) -> list[Row]:
    return [row for row in rows if row[measure] is not None]


def _worst(what: str, rows: list[Row], measure: str, limit: float) -> Goal:
    worst = max(rows, key=lambda row: row[measure])
    return Goal(what, "", f"≤ {limit:g}", f"{worst[measure]:.3f} ({worst['scene']})", worst[measure] <= limit)


def _believed(rows: list[Row]) -> list[Goal]:
    counted = {
        row["scene"]: [sum(column) for column in zip(*row["coverage"].values(), strict=True)]
        for row in rows
        if row["coverage"]
    }
    if not counted:
        return []
    share = sum(inside for inside, _ in counted.values()) / sum(places for _, places in counted.values())
    worst = min(counted, key=lambda scene: counted[scene][0] / counted[scene][1])
    least = counted[worst][0] / counted[worst][1]
    low, high = INSIDE
    return [
        Goal("95 % ellipse, all scenes", "", f"{low:.0%} to {high:.0%}", f"{share:.1%}", low <= share <= high),
        Goal("95 % ellipse, worst scene", "", f"≥ {LEAST_INSIDE:.0%}", f"{least:.1%} ({worst})", least >= LEAST_INSIDE),
    ]


def _empty(empty: Counts | None) -> list[Goal]:
    if empty is None:
        return []
    every = {
        name: sum(of_kind[name] for of_kind in empty.values()) for name in ("frames", "perception", "reconstruction")
    }
    met = every["perception"] <= FALSE_PER_FRAME * max(every["frames"], 1 / FALSE_PER_FRAME)
    result = [Goal("false threads in thread-free frames", "", "≤ 1 of 1000", _said(every), met)]
    return result + [Goal(f"of these, in {kind}", "", "", _said(of_kind), None) for kind, of_kind in empty.items()]


def _said(counts: dict[str, int]) -> str:
    return f"{counts['perception']} of {counts['frames']}, {counts['reconstruction']} of them with a curve"


def _times(rows: list[Row]) -> list[Goal]:
    limits = {"first": FIRST_MS, "near": NEAR_MS}
    result: list[Goal] = []
    for name, what in TIMES.items():
        wall, processor = (
            [row["times_ms"][key] for row in rows if key in row.get("times_ms", {})] for key in (name, name + " cpu")
        )
        if not wall:
            continue
        median, limit = statistics.median(wall), limits.get(name)
        figure = f"{median:.1f}, of the processor {statistics.median(processor):.1f}"
        goal = "" if limit is None else f"≤ {limit:g}"
        result.append(Goal(f"time, median, ms: {what}", "", goal, figure, None if limit is None else median <= limit))
    return result


STEP_PX = (3, 2)
"""Columns and rows by which the thread moves from frame to frame."""
FRAMES_TRACKED, REPEATS = 4, 3
RATE_HZ = 30.0

Result = TypeVar("Result")


def times_ms(scene: Scene, camera: RectifiedStereo, segmenter: str) -> dict[str, float]:
    """Milliseconds of one scene whose images are rectified; those whose names end in `cpu` are of the processor.

    `first` leads from the whole of both images to centrelines, `near` does so around the last thread, followed where
    it can be; `pixels near` where it may not be followed. `step first` and `step near` are what the agent takes in all
    for a frame of raw images, from message to message, with masks, judgement and surface. `tracked` counts the frames
    that were looked at near the last thread alone, `followed` those of them in which it was followed.
    """
    found: dict[str, float] = {}
    looked, found["first"], found["first cpu"] = _least(lambda: _first(scene.images, segmenter))
    first = _observed(0, camera, scene.images, looked)
    near, followed = _tracked(scene.images, first)
    pixels, _ = _tracked(scene.images, replace(first, trail_left=None, trail_right=None))
    found |= {"tracked": float(len(near)), "followed": float(followed)}
    return found | _medians("near", near) | _medians("pixels near", pixels) | _of_agent(scene, segmenter)


def _tracked(images: Pair, last: ThreadObservations) -> tuple[list[tuple[float, float]], int]:
    """Times of frames around the last thread, as long as they do without a look at the whole; how many were followed.

    Thread is followed only where the first observations say by what.
    """
    times: list[tuple[float, float]] = []
    followed, may_follow = 0, last.trail_left is not None
    for number in range(1, FRAMES_TRACKED + 1):
        now, before = moved(images, number), last
        seen, *took = _least(lambda now=now, before=before, number=number: _near(now, before, number))
        if seen is None:
            break
        times.append((took[0], took[1]))
        if isinstance(seen, FollowedPair):
            last, followed = as_sent(seen.observed), followed + 1
        else:
            last = _observed(number, before.camera, now, seen)
            last = last if may_follow else replace(last, trail_left=None, trail_right=None)
    return times, followed


def moved(images: Pair, frames: int) -> Pair:
    """Both images after some frames of a steady motion; what leaves on one side comes in on the other."""
    by = STEP_PX[1] * frames, STEP_PX[0] * frames
    return np.roll(images[0], by, axis=(0, 1)), np.roll(images[1], by, axis=(0, 1))


def _first(images: Pair, segmenter: str) -> Looked:
    looked = look_everywhere(images, 0, segmenter)
    _lines(images, looked)
    return looked


def _near(images: Pair, last: ThreadObservations, number: int) -> FollowedPair | Looked | None:
    if (followed := follow_pair(_stamp(number), last.camera, images, last)) is not None:
        return followed
    looked = look_near(images, last, number)
    if looked is not None:
        _lines(images, looked)
    return looked


def _lines(images: Pair, looked: Looked) -> None:
    """One eye after the other, as `observe` does."""
    for image, coverage in zip(images, looked.coverage, strict=True):
        thread_centrelines(image, coverage)


def _observed(number: int, camera: RectifiedStereo, images: Pair, looked: Looked) -> ThreadObservations:
    seen = observe(
        _stamp(number), camera, *images, *looked.coverage, looked.segmenter, looked.judgements or (), matching=False
    )
    return replace(as_sent(seen), looked_sequence=looked.looked_sequence, is_bright=looked.is_bright)


def _of_agent(scene: Scene, segmenter: str) -> dict[str, float]:
    agent = Perception(PerceptionConfig(segmenter=segmenter))
    list(agent.step(Received(CALIBRATION, str(CALIBRATION), 1, scene.calibration)))
    first: list[tuple[float, float]] = []
    near: list[tuple[float, float]] = []
    for number in range(FRAMES_TRACKED + 1):
        left, right = (encode_image(image, ImageEncoding.RAW) for image in moved(scene.images, number))
        frame = StereoFrame(_stamp(number), left, right)
        outputs, *times = _timed(lambda frame=frame: outputs_in(agent.step(Received(FRAMES, str(FRAMES), 1, frame))))
        seen = next(out.message for out in outputs if out.topic is OBSERVATIONS)
        (first if seen.looked_sequence == number else near).append((times[0], times[1]))
    return _medians("step first", first) | _medians("step near", near)


def _medians(name: str, times: list[tuple[float, float]]) -> dict[str, float]:
    if not times:
        return {}
    ms, cpu_ms = np.median(times, axis=0)
    return {name: float(ms), name + " cpu": float(cpu_ms)}


def _stamp(number: int) -> FrameStamp:
    at_ns = round(1e9 * number / RATE_HZ)
    return FrameStamp(number, at_ns, at_ns, "")


def _timed(function: Callable[[], Result]) -> tuple[Result, float, float]:
    watch, before_s = Stopwatch("all"), processor_s()
    with watch.step("all"):
        result = function()
    return result, watch.ms["all"], 1e3 * (processor_s() - before_s)


def _least(function: Callable[[], Result]) -> tuple[Result, float, float]:
    results = [_timed(function) for _ in range(REPEATS)]
    return results[0][0], min(ms for _, ms, _ in results), min(cpu_ms for _, _, cpu_ms in results)


NEAR_PX = 2.0
"""What lies within that of the other counts as the same."""


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
    near_found = np.asarray(KDTree(points).query(places)[0]) <= NEAR_PX
    # what is hidden lies between what is seen: a polyline through the seen parts alone would bridge it
    apart = distances_to_polyline(points, truth_px)
    near_seen = np.asarray(KDTree(truth_px[visible]).query(points)[0]) <= NEAR_PX
    return Shares(
        found=int(near_found.sum()),
        true=len(places),
        right=int(near_seen.sum()),
        given=len(points),
        apart_px=apart[near_seen],
        deviation_px=lines.deviation_px[near_seen],
    )


RIGHT, MISSED, FALSE = (0, 255, 0), (0, 0, 255), (0, 255, 255)
"""Blue first: green, red and yellow."""


def save_finding(path: Path, scene: Scene, result: PipelineResult) -> None:
    """Write both images side by side: right centrelines green, false ones yellow, missed truth red."""
    assert scene.truth is not None and scene.visible is not None
    seen = result.observations
    lines = seen.centrelines_left, seen.centrelines_right
    truth = project(seen.camera, scene.truth)
    drawn = [drawn_over(*eye) for eye in zip(result.images, lines, truth, scene.visible.T, strict=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.hstack(drawn))


def save_false(path: Path, result: PipelineResult) -> None:
    """Write both images of a scene without thread side by side, with what was taken for thread in yellow."""
    seen, nowhere = result.observations, np.zeros((0, 2))
    lines = seen.centrelines_left, seen.centrelines_right
    drawn = [
        drawn_over(image, of_eye, nowhere, np.zeros(0, bool))
        for image, of_eye in zip(result.images, lines, strict=True)
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.hstack(drawn))


def drawn_over(
    image: UInt8[np.ndarray, "h w 3"],
    lines: Centrelines,
    truth_px: Float64[np.ndarray, "m 2"],
    visible: Bool[np.ndarray, "m"],
) -> UInt8[np.ndarray, "h w 3"]:
    """One image with the places that were found in it, and those of the visible truth that were missed."""
    drawn = image.copy()
    for points, colour in zip(told_apart(lines, truth_px, visible), (RIGHT, FALSE, MISSED), strict=True):
        _dots(drawn, points, colour)
    return drawn


def told_apart(
    lines: Centrelines, truth_px: Float64[np.ndarray, "m 2"], visible: Bool[np.ndarray, "m"]
) -> tuple[Float64[np.ndarray, "r 2"], Float64[np.ndarray, "f 2"], Float64[np.ndarray, "k 2"]]:
    """What was found in one image: right and false places of it, and those of the visible truth that were missed."""
    points, true = lines.point_px, truth_px[visible]
    if not (len(points) and len(true)):
        return np.zeros((0, 2)), points, true
    missed = np.asarray(KDTree(points).query(true)[0]) > NEAR_PX
    false = np.asarray(KDTree(true).query(points)[0]) > NEAR_PX
    return points[~false], points[false], true[missed]


def _dots(image: UInt8[np.ndarray, "h w 3"], points: Float64[np.ndarray, "n 2"], colour: tuple[int, int, int]) -> None:
    at = np.rint(points).astype(np.int64)
    inside = ((at >= 0) & (at < image.shape[1::-1])).all(axis=1)
    image[at[inside, 1], at[inside, 0]] = colour


def false_threads(
    frames: int, segmenter: str, seed: int = 0, folders: Sequence[Path] = (), pictures: Path | None = None
) -> Counts:
    """How often perception, and reconstruction after it, takes something for thread, by kind of scene.

    Args:
        pictures: folder for a picture of each false thread.
    """
    counts: Counts = {}
    every = thread_free(frames, seed, folders)
    for number, one in enumerate(track(every, f"thread-free frames, {segmenter}", frames, transient=True)):
        result = reconstruct_pair(one.images, one.calibration, masks=None, segmenter=segmenter, method=DEFAULT_METHOD)
        of_kind = counts.setdefault(one.kind, {"frames": 0, "perception": 0, "reconstruction": 0})
        of_kind["frames"] += 1
        of_kind["perception"] += result.observations.status is Status.OK
        of_kind["reconstruction"] += result.reconstruction.status is Status.OK
        if pictures is not None and result.observations.status is Status.OK:
            save_false(pictures / f"{segmenter} {one.kind} {number}.png", result)
    return counts


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of scenes")
    parser.add_argument("--segmenters", nargs="+", default=[NETWORK])
    parser.add_argument("--only", default="", help="run only scenes whose name contains this")
    parser.add_argument("--empty", type=int, default=50, help="thread-free frames that are rendered and looked at")
    parser.add_argument(
        "--thread-free",
        type=Path,
        nargs="+",
        default=[],
        metavar="DIR",
        help="folders of path-traced scenes, of which those without thread are looked at too",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the thread-free frames")
    parser.add_argument("--no-scenes", action="store_true", help="look at thread-free frames alone")
    parser.add_argument("--no-times", action="store_true", help="measure no times, which takes the longest")
    parser.add_argument("--json", type=Path, default=Path("out/perception.json"), help="where the figures go")
    parser.add_argument("--pictures", type=Path, help="folder for a picture of what was found, missed and false")
    arguments = parser.parse_args()
    chosen = [
        load
        for name, group, load in scenes(arguments.data)
        if group in (CLEAR, CROSSING, OCCLUSION) and arguments.only in name and not arguments.no_scenes
    ]
    if not (chosen or arguments.no_scenes):
        parser.error(f"no render under {arguments.data} has a name that contains {arguments.only!r}")
    measured: dict[str, dict[str, Any]] = {}
    for segmenter in arguments.segmenters:
        rows = [row_of(load(), segmenter, not arguments.no_times, arguments.pictures) for load in chosen]
        empty = (
            false_threads(arguments.empty, segmenter, arguments.seed, arguments.thread_free, arguments.pictures)
            if arguments.empty
            else None
        )
        measured[segmenter] = {"rows": rows, "thread-free": empty}
    console = Console(width=180)
    for segmenter, found in measured.items() if chosen else ():
        print_scenes(console, segmenter, found["rows"])
    for segmenter, found in measured.items():
        print_goals(console, segmenter, found["rows"], found["thread-free"])
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps(measured, indent=1) + "\n")


def row_of(scene: Scene, segmenter: str, timed: bool, pictures: Path | None) -> Row:
    """The figures of one scene."""
    run = Run(scene, None, NONE, scene.calibration)
    result = reconstruct_pair(scene.images, scene.calibration, masks=None, segmenter=segmenter, method=DEFAULT_METHOD)
    row = figures(run, result) | shares_of(scene, result)
    if timed and segmenter == NETWORK:
        # as in an agent's process
        cv2.setNumThreads(1)
        keep_freed_memory()
        row["times_ms"] = times_ms(scene, result.observations.camera, segmenter)
    if pictures is not None:
        save_finding(pictures / f"{segmenter} {scene.name}.png", scene, result)
    return row


def shares_of(scene: Scene, result: PipelineResult) -> dict[str, Any]:
    """Counts of both images, and how far what is right lies off: signed mean, rms, and within its deviation."""
    assert scene.truth is not None and scene.visible is not None
    seen = result.observations
    both = [
        shares(lines, truth_px, visible)
        for lines, truth_px, visible in zip(
            (seen.centrelines_left, seen.centrelines_right),
            project(seen.camera, scene.truth),
            scene.visible.T,
            strict=True,
        )
    ]
    apart = np.concatenate([part.apart_px for part in both])
    deviation = np.concatenate([part.deviation_px for part in both])
    return {
        "found": sum(part.found for part in both),
        "true": sum(part.true for part in both),
        "right": sum(part.right for part in both),
        "given": sum(part.given for part in both),
        "off px": float(np.sqrt(np.mean(apart**2))) if len(apart) else None,
        "said px": float(np.sqrt(np.mean(deviation**2))) if len(deviation) else None,
    }


if __name__ == "__main__":
    main()
