"""How often the input judge is right: no alarm on undamaged pairs, and every damage found at its size.

    python -m benchmarks.judging [--data ../shared/data] [--also DIR ...] [--scenes N] [--workers N] [--json PATH]

Damages are done to the images as the camera gives them. `found` counts the pairs of which one of the codes that fit
the damage was said; `faults` those that were refused. A pair tells nothing of a damage that it cannot show: a plain
ground has no texture, so the published scenes count in a table of their own. `--also` names folders with more
undamaged pairs, as `suturegrasp scenes render` writes them, of which the alarms are counted.
"""

import argparse
import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import cv2

from agents.camera.image_files import read_pair
from agents.diagnostics.doctor.image_answers import answers_about
from agents.perception.judging.answers import Answer
from benchmarks.judging_damages import Pair, damages
from benchmarks.scenes import REAL, RENDERS, SIM, scenes
from schemas.messages import Severity, StereoCalibration
from shared.calibration import read_calibration

Named = tuple[str, str, Pair, StereoCalibration]
"""Kind, name, images and calibration."""
KINDS = TEXTURED, PLAIN, STORZ = "renders", "published", "laparoscope"
ALSO = "others"


def undamaged(data: Path) -> Iterator[Named]:
    """Every pair of the shared data."""
    for name, group, load in scenes(data):
        if group in (SIM, REAL) or (group in RENDERS and not group.startswith("hidden")):
            scene = load()
            yield PLAIN if group in (SIM, REAL) else TEXTURED, name, scene.images, scene.calibration
    for left in sorted((data / "storz_calibration").glob("*left.images.*.png")):
        pair = read_pair(left, left.with_name(left.name.replace("left", "right")))
        size = pair[0].shape[1], pair[0].shape[0]
        yield STORZ, left.stem, pair, read_calibration(left.parent, unit="mm", image_size=size).calibration


def codes_of(answers: list[Answer]) -> dict[str, Severity]:
    """What was said to be wrong."""
    return {answer.wrong.code: answer.wrong.severity for answer in answers if answer.wrong is not None}


def main() -> None:
    """Print false alarms, then how many of each damage were found."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--also", type=Path, nargs="*", default=[], help="folders of undamaged pairs")
    parser.add_argument("--scenes", type=int, default=0, help="every so many of them, to be quick; 0 takes all")
    parser.add_argument("--workers", type=int, default=2, help="processes, each of which takes a core")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    # a fresh interpreter for each, since OpenCV's threads do not outlive a fork
    pool = ProcessPoolExecutor(options.workers, get_context("spawn"), _load, (options.data, max(options.scenes, 1)))
    with pool:
        clean = _clean(pool, options.also)
        found = _found(pool)
    if options.json:
        options.json.write_text(json.dumps({"undamaged": clean, "damaged": found}, indent=1))


_pairs: list[Named] = []
"""Of a worker: what it was started with."""
_step: list[int] = []


def _load(data: Path, step: int) -> None:
    cv2.setNumThreads(1)
    _pairs.extend(undamaged(data))
    _step.append(step)


def _clean(pool: ProcessPoolExecutor, also: list[Path]) -> dict[str, dict[str, list[str]]]:
    """Every alarm on an undamaged pair, and how often nothing could be told."""
    print(
        "| undamaged pairs | pairs | false alarms | of which faults | answers | not told by the images |\n"
        "|---|---|---|---|---|---|"
    )
    said: dict[str, dict[str, list[str]]] = {}
    others = [path for folder in also for path in sorted(folder.glob("*.json"))]
    looked_at: list[tuple[str, dict[str, list[Answer]]]] = list(zip(KINDS, pool.map(_answers_of, KINDS), strict=True))
    if others:
        looked_at.append((ALSO, dict(zip(map(str, others), pool.map(_answers_of_render, others), strict=True))))
    for kind, answers in looked_at:
        said[kind] = {
            name: [f"{c} ({s.name})" for c, s in codes_of(a).items()] for name, a in answers.items() if codes_of(a)
        }
        alarms = [alarm for alarms in said[kind].values() for alarm in alarms]
        of_all = [answer for some in answers.values() for answer in some]
        untold = sum(not answer.is_known for answer in of_all)
        faults = sum("FAULT" in alarm for alarm in alarms)
        print(f"| {kind} | {len(answers)} | {len(alarms)} | {faults} | {len(of_all)} | {untold} |", flush=True)
    for kind in said.values():
        for name, alarms in kind.items():
            print(f"  false alarm on {name}: {', '.join(alarms)}")
    return said


def _answers_of(kind: str) -> dict[str, list[Answer]]:
    return {name: answers_about(images, calibration) for k, name, images, calibration in _pairs if k == kind}


def _answers_of_render(path: Path) -> list[Answer]:
    images = read_pair(path.with_name(f"{path.stem}_left.png"), path.with_name(f"{path.stem}_right.png"))
    size = images[0].shape[1], images[0].shape[0]
    return answers_about(images, read_calibration(path, unit=None, image_size=size).calibration)


def _found(pool: ProcessPoolExecutor) -> list[dict[str, str | int]]:
    """Of each damage, how many pairs it was found in, by kind."""
    print("\n| damage | size | " + " | ".join(f"{kind}: found / refused / pairs" for kind in KINDS) + " |")
    print("|---|---|---|---|---|")
    table: list[dict[str, str | int]] = []
    every = list(damages())
    for damage, counts in zip(every, pool.map(_counts_of, range(len(every))), strict=True):
        row: dict[str, str | int] = {"damage": damage.name, "size": damage.size}
        for kind, (found, refused, number) in counts.items():
            row |= {f"{kind} found": found, f"{kind} refused": refused, f"{kind} pairs": number}
        table.append(row)
        cells = " | ".join(" / ".join(map(str, counts[kind])) for kind in KINDS)
        print(f"| {damage.name} | {damage.size} | {cells} |", flush=True)
    return table


def _counts_of(number: int) -> dict[str, tuple[int, int, int]]:
    """Of the damage of that number, by kind: found, refused, and of how many pairs."""
    damage, counts = list(damages())[number], {}
    for kind in KINDS:
        some = [(images, calibration) for k, _, images, calibration in _pairs[:: _step[0]] if k == kind]
        said = [
            codes_of(answers_about(damage.do(images, some[(i + 1) % len(some)][0]), calibration))
            for i, (images, calibration) in enumerate(some)
        ]
        found = sum(bool(damage.codes & codes.keys()) for codes in said)
        counts[kind] = (found, sum(Severity.FAULT in codes.values() for codes in said), len(some))
    return counts


if __name__ == "__main__":
    main()
