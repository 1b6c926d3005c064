"""How often the input judge is right: no alarm on undamaged pairs, and every damage found at its size.

    python -m benchmarks.judging [--data ../shared/data] [--scenes N] [--workers N] [--json PATH]

Damages are done to the images as the camera gives them. `found` counts the pairs of which one of the codes that fit
the damage was said; `faults` those that were refused. A pair tells nothing of a damage that it cannot show: a plain
ground has no texture, so the published scenes count in a table of their own.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np

from agents.camera.image_files import read_pair
from agents.cli.image_answers import answers_about
from agents.perception.judging.answers import Answer
from benchmarks.scenes import REAL, RENDERS, SIM, scenes
from schemas.messages import Severity, StereoCalibration
from shared.calibration import read_calibration

Pair = tuple[np.ndarray, np.ndarray]
Named = tuple[str, str, Pair, StereoCalibration]
"""Kind, name, images and calibration."""
KINDS = TEXTURED, PLAIN, STORZ = "renders", "published", "laparoscope"


@dataclass(frozen=True)
class Damage:
    """Something that goes wrong with pairs, at one size.

    Fields:
        codes: any of these is a right answer.
        do: what it makes of a pair, given a pair of another scene besides.
    """

    name: str
    size: str
    codes: frozenset[str]
    do: Callable[[Pair, Pair], Pair]


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


def moved(image: np.ndarray, M: np.ndarray) -> np.ndarray:
    """The image under an affine map, black beyond its borders."""
    return cv2.warpAffine(image, M, image.shape[1::-1], flags=cv2.INTER_CUBIC)


def shifted(image: np.ndarray, right_px: float, down_px: float) -> np.ndarray:
    """Moved by so much."""
    return moved(image, np.array([[1.0, 0.0, right_px], [0.0, 1.0, down_px]]))


def turned(image: np.ndarray, degrees: float, larger: float = 1.0) -> np.ndarray:
    """Turned clockwise about its middle, and magnified."""
    height, width = image.shape[:2]
    return moved(image, cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), -degrees, larger))


def noisy(image: np.ndarray) -> np.ndarray:
    """With noise of 2 grey levels, which a sensor adds after whatever blurs."""
    return np.asarray(cv2.add(image, _noise(image.shape), dtype=cv2.CV_8U))


@lru_cache(maxsize=4)
def _noise(shape: tuple[int, ...]) -> np.ndarray:
    return 2.0 * np.random.default_rng(0).standard_normal(shape, dtype=np.float32)


def out_of_focus(image: np.ndarray, px: float) -> np.ndarray:
    """Blurred, by a standard deviation for an image 960 px wide."""
    return noisy(cv2.GaussianBlur(image, (0, 0), px * image.shape[1] / 960))


def smeared(image: np.ndarray, px: int) -> np.ndarray:
    """Moved along the rows while it was exposed, by so much in an image 960 px wide."""
    length = max(1, round(px * image.shape[1] / 960))
    return noisy(cv2.blur(image, (length, 1)))


def woven(image: np.ndarray, px: int) -> np.ndarray:
    """Every other row of a moment when all lay further right."""
    rows = image.copy()
    rows[1::2] = np.roll(image, px, axis=1)[1::2]
    return rows


def brightened(image: np.ndarray, gain: float) -> np.ndarray:
    """As with so many times the light."""
    return noisy(np.clip(image.astype(np.float32) * gain, 0, 255).astype(np.uint8))


def of_right(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Pair, Pair], Pair]:
    """What befalls the right eye alone."""
    return lambda pair, _: (pair[0], change(pair[1]))


def of_both(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Pair, Pair], Pair]:
    """What befalls both eyes."""
    return lambda pair, _: (change(pair[0]), change(pair[1]))


def cropped(image: np.ndarray, share: float) -> np.ndarray:
    """A share cut off each side, without scaling."""
    dv, du = (round(share * side) for side in image.shape[:2])
    return np.ascontiguousarray(image[dv : image.shape[0] - dv, du : image.shape[1] - du])


def damages() -> Iterator[Damage]:
    """What is tried, from what hardly shows to what must."""
    rows = frozenset(("row_residual", "row_offset"))
    for px in (1.5, 2, 4, 10, 40):
        yield Damage("right eye lower", f"{px:g} px", rows, of_right(lambda i, px=px: shifted(i, 0, px)))
    turn = frozenset(("rotated", "row_residual"))
    for degrees in (0.2, 0.5, 2, 10, 180):
        yield Damage("right eye turned", f"{degrees:g} deg", turn, of_right(lambda i, d=degrees: turned(i, d)))
    sizes = frozenset(("sizes_differ",))
    for larger in (1.005, 1.01, 1.03, 1.2):
        yield Damage("right eye larger", f"{larger - 1:.1%}", sizes, of_right(lambda i, m=larger: turned(i, 0, m)))
    swapped = frozenset(("left_right_swapped", "mirrored", "rotated"))
    yield Damage("exchanged", "", swapped, lambda pair, _: (pair[1], pair[0]))
    yield Damage("both mirrored", "", swapped, of_both(lambda i: np.ascontiguousarray(i[:, ::-1])))
    yield Damage("both upside down", "", swapped, of_both(lambda i: np.ascontiguousarray(i[::-1, ::-1])))
    yield Damage("right eye mirrored", "", frozenset(("mirrored",)), of_right(lambda i: i[:, ::-1].copy()))
    yield Damage("right eye flipped", "", frozenset(("mirrored",)), of_right(lambda i: i[::-1].copy()))
    yield Damage("one image twice", "", frozenset(("no_disparity",)), lambda pair, _: (pair[0], pair[0]))
    yield Damage("right eye of another scene", "", frozenset(("nothing_corresponds",)), lambda p, q: (p[0], q[1]))
    yield Damage("both moved apart", "15 %", frozenset(("disparity_range", "distance_implausible")), _apart)
    for share in (0.05, 0.2):
        size = frozenset(("size",))
        yield Damage("both cropped", f"{share:.0%}", size, of_both(lambda i, s=share: cropped(i, s)))
    yield Damage("both scaled", "50 %", frozenset(("size",)), of_both(lambda i: cv2.resize(i, None, fx=0.5, fy=0.5)))
    for gain in (0.25, 0.1):
        dark = frozenset(("too_dark", "no_picture"))
        yield Damage("both too dark", f"x {gain:g}", dark, of_both(lambda i, g=gain: brightened(i, g)))
    for gain in (2, 4):
        yield Damage(
            "both too bright", f"x {gain}", frozenset(("too_bright",)), of_both(lambda i, g=gain: brightened(i, g))
        )
    differ = frozenset(("exposures_differ", "too_dark"))
    yield Damage("right eye darker", "x 0.5", differ, of_right(lambda i: brightened(i, 0.5)))
    yield Damage("right eye black", "", frozenset(("no_picture",)), of_right(np.zeros_like))
    for px in (1.5, 2, 3, 5):
        yield Damage(
            "both out of focus", f"{px:g} px", frozenset(("blurred",)), of_both(lambda i, p=px: out_of_focus(i, p))
        )
    yield Damage("right eye out of focus", "3 px", frozenset(("blurred",)), of_right(lambda i: out_of_focus(i, 3)))
    for px in (8, 15, 25):
        codes = frozenset(("smeared", "blurred"))
        yield Damage("both smeared", f"{px} px", codes, of_both(lambda i, p=px: smeared(i, p)))
    for px in (1, 2, 6):
        yield Damage("both interlaced", f"{px} px", frozenset(("interlaced",)), of_both(lambda i, p=px: woven(i, p)))


def _apart(pair: Pair, _: Pair) -> Pair:
    return shifted(pair[0], 0.075 * pair[0].shape[1], 0), shifted(pair[1], -0.075 * pair[1].shape[1], 0)


def codes_of(answers: list[Answer]) -> dict[str, Severity]:
    """What was said to be wrong."""
    return {answer.wrong.code: answer.wrong.severity for answer in answers if answer.wrong is not None}


def main() -> None:
    """Print false alarms, then how many of each damage were found."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--scenes", type=int, default=0, help="every so many of them, to be quick; 0 takes all")
    parser.add_argument("--workers", type=int, default=2, help="processes, each of which takes a core")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    # a fresh interpreter for each, since OpenCV's threads do not outlive a fork
    pool = ProcessPoolExecutor(options.workers, get_context("spawn"), _load, (options.data, max(options.scenes, 1)))
    with pool:
        clean = _clean(pool)
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


def _clean(pool: ProcessPoolExecutor) -> dict[str, dict[str, list[str]]]:
    """Every alarm on an undamaged pair, and how often nothing could be told."""
    print(
        "| undamaged pairs | pairs | false alarms | of which faults | answers | not told by the images |\n"
        "|---|---|---|---|---|---|"
    )
    said: dict[str, dict[str, list[str]]] = {}
    for kind, answers in zip(KINDS, pool.map(_answers_of, KINDS), strict=True):
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
