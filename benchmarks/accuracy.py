"""How accurate a reconstruction method is on every scene of a data folder, beside published figures and goals.

    .venv/bin/python -m benchmarks.accuracy --data ../shared/data

Each scene is run without masks, as `suturegrasp reconstruct` would run it, and with the best masks that are known;
renders also with binary masks and with calibrations that are a little wrong. Prints a table per kind of scene and the
table of goals, writes JSON, and compares with the committed baseline of the same method. Times are those of one core
of whatever machine this is, the least of three runs where they count.
"""

import argparse
import json
import statistics
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2

from agents.cli.reconstruct.pipeline import PipelineResult, reconstruct_pair
from agents.perception.centrelines import thread_centrelines
from agents.reconstruction.method_names import DEFAULT_METHOD
from agents.reconstruction.methods import METHODS
from agents.viewer.picture import draw_picture
from benchmarks.measures import Goal, figures, goals
from benchmarks.scenes import NONE, RENDERS, Pair, Run, runs, scenes
from benchmarks.tables import compare, print_goals, print_group
from shared.clock import Stopwatch

REPEATS = 3
BASELINES = Path(__file__).parent / "baselines"


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of scenes")
    parser.add_argument("--method", choices=sorted(METHODS), default=DEFAULT_METHOD)
    parser.add_argument("--only", default="", help="run only scenes whose name contains this")
    parser.add_argument("--groups", nargs="+", default=[""], help="run only groups whose name contains one of these")
    parser.add_argument("--masks", nargs="+", help="run only with these masks: none, true, binary, grey<200, grey<250")
    parser.add_argument("--json", type=Path, default=Path("out/accuracy.json"), help="where the figures go")
    parser.add_argument("--pictures", type=Path, help="folder for a picture of each run")
    parser.add_argument("--brief", action="store_true", help="print the table of goals alone")
    parser.add_argument("--bless", action="store_true", help="make these figures the committed baseline")
    arguments = parser.parse_args()
    chosen = [
        load
        for name, group, load in scenes(arguments.data)
        if arguments.only in name and any(wanted in group for wanted in arguments.groups)
    ]
    if not chosen:
        parser.error(f"no scene under {arguments.data} has a name that contains {arguments.only!r}")

    cv2.setNumThreads(1)
    rows: list[dict[str, Any]] = []
    for load in chosen:
        for run in runs(load()):
            if arguments.masks and run.masks_are not in arguments.masks:
                continue
            timed = run.scene.group in RENDERS and run.masks_are in ("true", NONE) and not run.calibration_is
            result = fastest(run, arguments.method, REPEATS if timed else 1)
            row = figures(run, result) | {"centrelines_ms": None}
            if timed and run.masks is not None:
                row["centrelines_ms"] = centrelines_ms(result, run.masks)
            rows.append(row)
            if arguments.pictures:
                name = f"{run.scene.group} {run.scene.name} masks {run.masks_are} {run.calibration_is}".strip()
                save_picture(arguments.pictures / f"{name}.png", result)
    for group in () if arguments.brief else dict.fromkeys(row["group"] for row in rows):
        print_group(group, [row for row in rows if row["group"] == group])
    print_goals(arguments.method, goals(rows) + time_goals(arguments.method, rows))
    save(arguments.json, arguments.method, rows)
    baseline = BASELINES / f"accuracy_{arguments.method}.json"
    if arguments.bless:
        save(baseline, arguments.method, rows)
    elif baseline.is_file():
        compare(json.loads(baseline.read_text())["rows"], rows)


def fastest(run: Run, method: str, repeats: int) -> PipelineResult:
    """The run, each step with its least time of some repetitions: other programs interrupt."""
    results = [
        reconstruct_pair(run.scene.images, run.calibration, masks=run.masks, segmenter=None, method=method)
        for _ in range(repeats)
    ]
    least = {step: min(result.timings_ms[step] for result in results) for step in results[0].timings_ms}
    return replace(results[0], timings_ms=least)


def centrelines_ms(result: PipelineResult, masks: Pair) -> float:
    """The least time of some repetitions for the centrelines of both images, which need no rectification."""
    least = float("inf")
    for _ in range(REPEATS):
        watch = Stopwatch("centrelines")
        with watch.step("centrelines"):
            for image, mask in zip(result.images, masks, strict=True):
                thread_centrelines(image, mask)
        least = min(least, watch.ms["centrelines"])
    return least


def save(path: Path, method: str, rows: list[dict[str, Any]]) -> None:
    """Write all figures as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"method": method, "rows": rows}, indent=1) + "\n")


def save_picture(path: Path, result: PipelineResult) -> None:
    """Write what a person would see of this run."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), draw_picture(*result.images, result.observations, result.reconstruction))


Row = dict[str, Any]

LIMITS_MS = {"paper": 5.0, "refined": 40.0}
"""For observations to curve, by method."""
LIMIT_WITH_CENTRELINES_MS = 60.0
"""For centrelines of both images and the curve, by method `refined`."""

OTHER_STEPS = ("rectify", "segment", "reconstruct")
"""What is left of a run leads from masks to observations."""


def time_goals(method: str, rows: list[Row]) -> list[Goal]:
    """Median times of the renders, which are 960x540, with true masks; segmentation from the runs without masks."""
    renders = [row for row in rows if row["group"] in RENDERS and not row["calibration"]]
    given = [row for row in renders if row["masks"] == "true"]
    segmented = [row for row in renders if row["masks"] == NONE]
    result: list[Goal] = []
    if segmented:
        result.append(Goal("time: segmentation, both images, ms", "-", "-", _median(_ms(segmented, "segment"))))
    if given:
        curve = _ms(given, "reconstruct")
        observed: list[float] = [
            sum(ms for step, ms in row["timings_ms"].items() if step not in OTHER_STEPS) for row in given
        ]
        both = [a + b for a, b in zip(observed, curve, strict=True)]
        with_lines = [row["centrelines_ms"] + ms for row, ms in zip(given, curve, strict=True)]
        result += [
            Goal("time: masks to observations, ms", "-", "-", _median(observed)),
            _limited(f"time: observations to curve, {method}, ms", curve, LIMITS_MS.get(method)),
            _limited(f"time: masks to curve, {method}, with judging the input and encoding, ms", both, None),
        ]
        if method == "refined":
            what = "time: centrelines of both images, and observations to curve, refined, ms"
            result.append(_limited(what, with_lines, LIMIT_WITH_CENTRELINES_MS))
    return result


def _limited(what: str, values: list[float], limit: float | None) -> Goal:
    if limit is None:
        return Goal(what, "-", "-", _median(values))
    return Goal(what, "-", f"≤ {limit:g}", _median(values), statistics.median(values) <= limit)


def _ms(rows: list[Row], step: str) -> list[float]:
    return [row["timings_ms"][step] for row in rows]


def _median(values: list[float]) -> str:
    return f"{statistics.median(values):.1f}"


if __name__ == "__main__":
    main()
