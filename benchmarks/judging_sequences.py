"""How often what only frames in turn tell is told: an eye that stands still, and one that is late.

    python -m benchmarks.judging_sequences [--data ../shared/data] [--json PATH]

Each of the shared renders is looked at through a window that sways over it, for two seconds, with noise of its own in
each frame: so a camera that is held by hand shows it. `found` counts the sequences of which the code was said that
fits, `unknown` those that were said to tell nothing, `wrong` those of which anything else was said to be wrong.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from agents.camera.image_files import read_pair
from agents.perception.judging.answers import Answer
from agents.perception.judging.sequence import about_sequence
from schemas.messages import FrameStamp

FRAMES, PERIOD_NS = 60, 33_333_333
WINDOW = 270, 480
"""Height and width of what is seen of an image half as large as it comes."""
NOISE = 2.0

Frames = list[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Trial:
    """Frames in turn with something done to them.

    Fields:
        code: what is to be said; empty where nothing is wrong.
        sway_px: how far the view moves from frame to frame, in the middle of all.
        late: frames by which the right eye is late.
        held: eyes that stand still for so many frames.
        apart_ms: between the stamps of both eyes.
    """

    name: str
    code: str
    sway_px: float
    late: int = 0
    held: tuple[tuple[int, ...], int] = ((), 0)
    apart_ms: float = 0.0


TRIALS = (
    Trial("nothing, the view sways by 4 px a frame", "", 4.0),
    Trial("nothing, 1 px a frame", "", 1.0),
    Trial("nothing, the view stands still", "", 0.0),
    *(Trial(f"right eye {n} late, 4 px a frame", "unsynchronised", 4.0, n) for n in (1, 2, 4, -1)),
    *(Trial(f"right eye {n} late, 1 px a frame", "unsynchronised", 1.0, n) for n in (1, 2)),
    Trial("stamps 20 ms apart", "", 4.0, apart_ms=20.0),
    Trial("stamps 50 ms apart", "unsynchronised", 4.0, apart_ms=50.0),
    Trial("right eye repeats a picture 3 times", "", 4.0, held=((1,), 3)),
    Trial("right eye repeats a picture 6 times", "frozen", 4.0, held=((1,), 6)),
    Trial("both eyes repeat a picture 6 times", "frozen", 4.0, held=((0, 1), 6)),
)


def frames(images: tuple[np.ndarray, np.ndarray], trial: Trial, seed: int) -> Frames:
    """What a camera shows that sways before the images, with what is wrong with it."""
    rng = np.random.default_rng(seed)
    half = [cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for image in images]
    large = [cv2.copyMakeBorder(image, 60, 60, 100, 100, cv2.BORDER_REFLECT) for image in half]
    step = rng.normal(0, 1, (FRAMES + 8, 2)) * rng.uniform(0, 2, (FRAMES + 8, 1))
    step *= trial.sway_px / np.median(np.linalg.norm(step, axis=1))
    path = _reflected(np.cumsum(step, axis=0), np.array([80.0, 45.0]))

    def eye(which: int, k: int) -> np.ndarray:
        u, v = path[k + 4] + (100.0, 60.0)
        centre = u + (WINDOW[1] - 1) / 2, v + (WINDOW[0] - 1) / 2
        seen = cv2.getRectSubPix(large[which], (WINDOW[1], WINDOW[0]), centre)
        return np.asarray(cv2.add(seen, rng.normal(0, NOISE, seen.shape), dtype=cv2.CV_8U))

    pairs = [(eye(0, k), eye(1, k - trial.late)) for k in range(FRAMES)]
    eyes, times = trial.held
    middle = FRAMES // 2
    for k in range(middle + 1, middle + 1 + times):
        left, right = (pairs[middle if i in eyes else k][i] for i in (0, 1))
        pairs[k] = left, right
    return pairs


def _reflected(path: np.ndarray, most: np.ndarray) -> np.ndarray:
    """The path, turned back at its borders."""
    return np.abs((path + most) % (4 * most) - 2 * most) - most


def stamps(trial: Trial) -> list[FrameStamp]:
    """Of the frames."""
    apart = round(1e6 * trial.apart_ms)
    return [FrameStamp(k, PERIOD_NS * k, PERIOD_NS * k + apart, "") for k in range(FRAMES)]


def verdict(answers: list[Answer], code: str) -> str:
    """What was said: `found`, `unknown`, `wrong` or `well`."""
    said = {answer.wrong.code for answer in answers if answer.wrong is not None}
    if said - {code}:
        return "wrong"
    if code and code in said:
        return "found"
    return "well" if all(answer.is_known for answer in answers) else "unknown"


def rows(data: Path) -> Iterator[dict[str, str | int]]:
    """What was said of each trial, by how many sequences."""
    paths = sorted((data / "renders").glob("*_left.png"))
    scenes = [path for path in paths if not path.stem.endswith(("mask_left", "tool_left"))]
    pairs = [read_pair(path, path.with_name(path.name.replace("_left", "_right"))) for path in scenes]
    for trial in TRIALS:
        said = [
            verdict(about_sequence(frames(pair, trial, seed), stamps(trial)), trial.code)
            for seed, pair in enumerate(pairs)
        ]
        counts = {word: said.count(word) for word in ("found", "well", "unknown", "wrong")}
        yield {"trial": trial.name, "sequences": len(said), **counts}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    table: list[dict[str, str | int]] = []
    for row in rows(options.data):
        if not table:
            print("| " + " | ".join(row) + " |\n" + "|---" * len(row) + "|")
        print("| " + " | ".join(str(cell) for cell in row.values()) + " |", flush=True)
        table.append(row)
    if options.json:
        options.json.write_text(json.dumps(table, indent=1))


if __name__ == "__main__":
    main()
