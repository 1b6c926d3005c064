"""How well each segmenter finds the thread in raw images, and how fast: scenes, thread-free frames and times.

    .venv/bin/python -m benchmarks.perception --data ../shared/data

Every render is run without masks, as `suturegrasp reconstruct` would run it, with each segmenter that is made for
tissue. Prints a table of the scenes, false threads and times for each segmenter, and the table of goals; writes JSON.
Recall and precision are those of centrelines within 2 px, over both images.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console

from agents.cli.reconstruct.pipeline import PipelineResult, reconstruct_pair
from agents.perception.segmenter_names import NETWORK
from agents.reconstruction.method_names import DEFAULT_METHOD
from benchmarks.centreline_share import shares
from benchmarks.measures import figures
from benchmarks.perception_empty import false_threads
from benchmarks.perception_pictures import save_finding
from benchmarks.perception_tables import Row, print_goals, print_scenes
from benchmarks.perception_times import times_ms
from benchmarks.scenes import CLEAR, CROSSING, OCCLUSION, Scene, scenes
from benchmarks.segmenters import COMPARED, ON_TISSUE
from benchmarks.variations import NONE, Run
from shared.camera import project
from shared.runtime.process import keep_freed_memory

"""`threshold` is for plain grounds."""


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of scenes")
    parser.add_argument("--segmenters", nargs="+", choices=ON_TISSUE, default=[NETWORK])
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
    result = reconstruct_pair(
        scene.images, scene.calibration, masks=None, segmenter=segmenter, method=DEFAULT_METHOD, segmenters=COMPARED
    )
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
