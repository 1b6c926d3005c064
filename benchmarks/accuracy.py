"""How accurate a reconstruction method is on every scene of a data folder, beside published figures and goals.

    .venv/bin/python -m benchmarks.accuracy --data ../shared/data

Each scene is run without masks, as `suturegrasp reconstruct` would run it, and with the best masks that are known;
renders also with binary masks and with calibrations that are a little wrong. Prints a table per kind of scene and the
table of goals, writes JSON, and compares with the committed baseline of the same method. Times are those of one core
of whatever machine this is.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import tyro

from agents.cli.reconstruct.pipeline import PipelineResult
from agents.reconstruction.method_names import DEFAULT_METHOD
from agents.reconstruction.methods import METHODS
from agents.viewer.picture import draw_picture
from benchmarks.accuracy_goals import failures, goals, spread, time_goals
from benchmarks.measures import REPROJECTION, coverage_of, figures, topology_of
from benchmarks.scenes import Scene, reconstructed, runs, scenes
from benchmarks.tables import CONSOLE, Row, print_goals, print_rows, share, shown, write_json

BASELINES = Path(__file__).parent / "baselines"
COLUMNS = ("mean", "bound", "pixel bound", "mean seen", "bound seen", "frechet", *REPROJECTION)
KEY = ("group", "scene", "masks", "calibration")
"""What tells a run from all others."""


@dataclass(frozen=True)
class Options:
    """Which runs, and where their figures go."""

    data: Path = Path("../shared/data")
    """Folder of scenes."""
    method: str = DEFAULT_METHOD
    only: str = ""
    """Scenes whose name contains this."""
    groups: tuple[str, ...] = ("",)
    """Groups whose name contains one of these."""
    masks: tuple[Literal["none", "true", "binary", "grey<200", "grey<250"], ...] = ()
    """Runs with these masks alone."""
    json: Path = Path("out/accuracy.json")
    pictures: Path | None = None
    """Folder for a picture of each run."""
    brief: bool = False
    """Print the table of goals alone."""
    bless: bool = False
    """Make these figures the committed baseline."""


def main() -> None:
    """Run the benchmark from the command line."""
    options = tyro.cli(Options, description=__doc__)
    if options.method not in METHODS:
        raise SystemExit(f"there is no method {options.method}; there are {', '.join(sorted(METHODS))}")
    chosen = [
        load
        for name, group, load in scenes(options.data)
        if options.only in name and any(wanted in group for wanted in options.groups)
    ]
    if not chosen:
        raise SystemExit(f"no scene under {options.data} has a name that contains {options.only!r}")
    cv2.setNumThreads(1)
    rows = [row for load in chosen for row in rows_of(load(), options)]
    for group in () if options.brief else dict.fromkeys(row["group"] for row in rows):
        print_group(group, [row for row in rows if row["group"] == group])
    print_goals(f"goals, method {options.method}", goals(rows) + time_goals(options.method, rows))
    write_json(options.json, {"method": options.method, "rows": rows})
    baseline = BASELINES / f"accuracy_{options.method}.json"
    now = [{name: row[name] for name in (*KEY, "status", "mean")} for row in rows]
    if options.bless:
        baseline.write_text("[\n" + ",\n".join(json.dumps(row, ensure_ascii=False) for row in now) + "\n]\n")
    elif baseline.is_file():
        compare(json.loads(baseline.read_text()), now)


def rows_of(scene: Scene, options: Options) -> list[Row]:
    """The figures of every run of a scene."""
    rows: list[Row] = []
    for run in runs(scene):
        if options.masks and run.masks_are not in options.masks:
            continue
        result = reconstructed(run.scene, run.masks, method=options.method)
        rows.append(figures(run, result))
        if options.pictures:
            name = f"{scene.group} {scene.name} masks {run.masks_are} {run.calibration_is}".strip()
            save_picture(options.pictures / f"{name}.png", result)
    return rows


def save_picture(path: Path, result: PipelineResult) -> None:
    """Write what a person would see of this run."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), draw_picture(*result.images, result.observations, result.reconstruction))


def print_group(group: str, rows: list[Row]) -> None:
    """One table of a kind of scene, and its sums for each kind of masks and calibration."""
    columns = [name for name in COLUMNS if any(row[name] is not None for row in rows)]
    table = [
        {name: row[name] for name in ("scene", "masks", "calibration", "status")}
        | {"topology": topology_of(row)}
        | {name: row[name] for name in columns}
        | {"in ellipse": share(*coverage_of(row)), "ms": sum(row["timings_ms"].values())}
        for row in rows
    ]
    print_rows(f"{group}: lengths in the calibration's unit, reprojection in px", table)
    for row in rows:
        if row["reason"]:
            CONSOLE.print(f"  {named(row)}: {row['reason']}")
    for kind in dict.fromkeys((row["masks"], row["calibration"]) for row in rows):
        CONSOLE.print(f"  {summed(*kind, [row for row in rows if (row['masks'], row['calibration']) == kind])}")
    CONSOLE.print()


def summed(masks: str, calibration: str, rows: list[Row]) -> str:
    """Failures, and median and worst of each measure."""
    parts = [f"masks {masks}{', calibration off: ' + calibration if calibration else ''}"]
    parts.append(f"{len(rows)} scenes, {failures(rows)} failed")
    for name in ("mean", "bound", "pixel bound", *REPROJECTION):
        if any(row[name] is not None for row in rows):
            parts.append(f"{name} {spread(row[name] for row in rows)}")
    return "; ".join(parts)


def compare(before: list[Row], now: list[Row]) -> None:
    """Print which runs changed their status, or their mean error by more than a tenth, against the baseline."""
    known = {tuple(row[name] for name in KEY): row for row in before}
    for row in now:
        old = known.get(tuple(row[name] for name in KEY), row)
        was, is_now = old["mean"], row["mean"]
        moved = was is not None and is_now is not None and abs(is_now - was) > 0.1 * was
        if old["status"] != row["status"] or moved:
            CONSOLE.print(f"changed: {named(row)}: {old['status']} {shown(was)} -> {row['status']} {shown(is_now)}")


def named(row: Row) -> str:
    """A run in words."""
    return f"{row['group']} {row['scene']} masks {row['masks']} {row['calibration']}".strip()


if __name__ == "__main__":
    main()
