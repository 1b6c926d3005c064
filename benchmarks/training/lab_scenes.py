"""Labelled scenes of a lab: python -m benchmarks.training.lab_scenes --count 500 --seed 1 --output DIR.

Each seed makes one scene of one eye: NAME_left.png, and how much of each pixel thread, needle and instrument cover, 0
to 255, in NAME_mask_left.png, NAME_needle_left.png and NAME_instrument_left.png. Scenes that are there are left alone.
"""

import dataclasses
import sys
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import tyro
from jaxtyping import UInt8

from benchmarks.training.lab_ground import (
    FONTS,
    GROUND,
    INSTRUMENT,
    SEALED,
    TRAIN,
    Canvas,
    Image,
    Lists,
    lay,
    make_ground,
    save,
    soft,
)
from benchmarks.training.lab_instruments import Drawn, Solid, draw_instrument, load_meshes
from benchmarks.training.lab_strands import (
    Look,
    distractor,
    fray,
    free_strand,
    knot,
    lay_needle,
    lay_thread,
    needle_arc,
    stitches,
    thread_look,
)
from shared.rendering.render import SceneError

SIZES = (640, 480), (720, 576), (720, 540), (938, 528), (960, 540), (960, 720), (1024, 768), (1280, 720), (1280, 960)
SIZE_SHARES = 0.2, 0.1, 0.1, 0.1, 0.15, 0.1, 0.1, 0.1, 0.05
COUNT_SHARES = (0.25, 0.45, 0.2, 0.1), (0.3, 0.5, 0.2), (0.25, 0.3, 0.35, 0.1)
"""Of scenes with 0, 1, 2 ... threads, needles, instruments; stitches and what they hold come besides."""
THREADLESS_SHARE = 0.12
"""Of scenes without any thread."""
WORDS = "needle", "pickup", "throw", "knot", "tying", "REC", "12:04:33", "left", "cut", "frame", "demo"
LISTS = {"train": TRAIN, "sealed": SEALED}
NAMES = "left", "mask_left", "needle_left", "instrument_left"


@dataclasses.dataclass(frozen=True)
class Scene:
    """The picture and what covers it: thread, needle, instrument, each 0 to 255."""

    image: UInt8[np.ndarray, "h w 3"]
    covers: UInt8[np.ndarray, "3 h w"]


def lab_scene(seed: int, meshes: dict[str, Solid], lists: Lists = TRAIN, ground: str | None = None) -> Scene:
    """The scene that the seed makes, on a ground of GROUNDS; on one that is drawn, if it is None."""
    rng = np.random.default_rng([seed, 27])
    width, height = SIZES[int(rng.choice(len(SIZES), p=SIZE_SHARES))]
    canvas = make_ground(rng, (height, width), lists, ground)
    _fill(rng, canvas, meshes, lists)
    image = _seen(rng, canvas)
    return Scene(image, np.rint(255 * canvas.covers).astype(np.uint8))


def _fill(rng: np.random.Generator, canvas: Canvas, meshes: dict[str, Solid], lists: Lists) -> None:
    """Lay stitches, then threads, needles and instruments in random order."""
    is_threadless = rng.random() < THREADLESS_SHARE
    look = None if is_threadless else thread_look(rng, lists, canvas.ground)
    scale = canvas.light.shape[1] / 960
    width = float(np.exp(rng.uniform(np.log(1.7), np.log(11)))) * scale
    if rng.random() < 0.15:
        distractor(rng, canvas)
    if look is not None and rng.random() < 0.35:
        stitches(rng, canvas, min(width, 6 * scale), look)
    threads, needles, tools = (int(rng.choice(len(shares), p=shares)) for shares in COUNT_SHARES)
    for item in rng.permutation(["thread"] * threads + ["needle"] * needles + ["tool"] * tools):
        if look is not None and rng.random() < 0.2:
            look = thread_look(rng, lists, canvas.ground)
        if item == "thread":
            start = rng.uniform(-0.05, 1.05, 2) * canvas.light.shape[1::-1]
            _lay_free(rng, canvas, width, look, start, 0.0)
        elif item == "needle":
            _lay_needle(rng, canvas, width, look, None)
        else:
            _lay_tool(rng, canvas, meshes, lists, width, look)


def _lay_free(
    rng: np.random.Generator, canvas: Canvas, width: float, look: Look | None, start: np.ndarray, high: float
) -> None:
    """A thread from there; nothing without a look."""
    if look is None:
        return
    strand = free_strand(rng, canvas.light.shape[:2], width, start, high)
    lay_thread(rng, canvas, strand, look)
    if rng.random() < 0.3 and not strand.sinks[1]:
        fray(rng, canvas, strand.path[-1], width, look)
    if rng.random() < 0.25:
        knot(rng, canvas, strand.path[int(rng.integers(len(strand.path)))], width, look, rng.uniform(2, 15))


def _lay_needle(
    rng: np.random.Generator, canvas: Canvas, width: float, look: Look | None, middle: np.ndarray | None
) -> None:
    """A needle, in half of the cases with its thread."""
    needle = needle_arc(rng, canvas.light.shape[:2], middle)
    is_first = rng.random() < 0.5
    if is_first:
        lay_needle(rng, canvas, needle)
    if rng.random() < 0.5:
        thread = min(width, float(needle.widths[len(needle.widths) // 4]) * rng.uniform(0.5, 1))
        _lay_free(rng, canvas, thread, look, needle.path[0], float(needle.heights[0]))
    if not is_first:
        lay_needle(rng, canvas, needle)


def _lay_tool(
    rng: np.random.Generator, canvas: Canvas, meshes: dict[str, Solid], lists: Lists, width: float, look: Look | None
) -> None:
    """An instrument with nothing, a thread or a needle in its jaws."""
    shape = canvas.light.shape[:2]
    drawn = draw_instrument(rng, canvas, meshes, lists, rng.uniform(0.15, 0.85, 2) * shape[::-1])
    held = str(rng.choice(["nothing", "nothing", "thread", "needle"]))
    if drawn is None or held == "nothing":
        return
    grip = drawn.grip[0] + rng.uniform(0.05, 0.5) * (drawn.grip[1] - drawn.grip[0])
    if held == "thread":
        _lay_free(rng, canvas, width, look, grip, rng.uniform(5, 60))
    else:
        _lay_needle(rng, canvas, width, look, grip)
    _lay_near_jaw(canvas, drawn)


def _lay_near_jaw(canvas: Canvas, drawn: Drawn) -> None:
    lay(canvas, drawn.box, drawn.colour, drawn.near_jaw, INSTRUMENT)


def _seen(rng: np.random.Generator, canvas: Canvas) -> UInt8[np.ndarray, "h w 3"]:
    """The canvas through a camera and a video."""
    shape = canvas.light.shape[:2]
    image = soft(canvas.image, float(np.exp(rng.uniform(np.log(0.3), np.log(1.6)))) * shape[1] / 960)
    if rng.random() < 0.25:
        image = _shaken(rng, image)
    if rng.random() < 0.4:
        rows, columns = np.mgrid[-1 : 1 : shape[0] * 1j, -1 : 1 : shape[1] * 1j].astype(np.float32)
        image *= (1 - rng.uniform(0.1, 0.7) * np.clip(rows**2 + columns**2, 0, 1.4) / 1.4)[..., None]
    balance = rng.normal(1, 0.06, 3).astype(np.float32) * rng.uniform(0.75, 1.3)
    image = (
        255 * np.clip(image * balance / 255, 0, 1) ** rng.uniform(0.75, 1.35) + rng.choice([0, 0, 4, 12]) * rng.random()
    )
    image = _noisy(rng, image)
    if rng.random() < 0.06:
        image[1::2] = np.roll(image[1::2], int(rng.choice([-2, -1, 1, 2])), axis=1)
    if rng.random() < 0.25:
        _burn_in(rng, canvas, image)
    return _compressed(rng, np.clip(np.rint(image), 0, 255).astype(np.uint8))


def _shaken(rng: np.random.Generator, image: Image) -> Image:
    kernel = np.zeros((15, 15), np.float32)
    way = rng.uniform(-1, 1, 2) * rng.uniform(1, 5)
    ends = [(round(16 * (7 + sign * way[0] / 2)), round(16 * (7 + sign * way[1] / 2))) for sign in (-1, 1)]
    cv2.line(kernel, ends[0], ends[1], 1.0, 1, cv2.LINE_8, 4)
    return cv2.filter2D(image, -1, kernel / kernel.sum())


def _noisy(rng: np.random.Generator, image: Image) -> Image:
    """Grain that grows with the light, finer or coarser than pixels."""
    size = (image.shape[0], image.shape[1])
    read, shot = rng.uniform(0.3, 3.0), rng.uniform(0, 0.25)
    grain = cv2.merge([rng.standard_normal(size, dtype=np.float32)] * 3)
    if rng.random() < 0.5:
        grain += 0.5 * cv2.resize(rng.standard_normal((size[0] // 2, size[1] // 2, 3), dtype=np.float32), size[::-1])
    if rng.random() < 0.5:
        grain = cv2.GaussianBlur(grain, (0, 0), rng.uniform(0.4, 1.0)) * 1.5
    return image + grain * (read + shot * np.sqrt(np.clip(image, 0, 255)))


def _burn_in(rng: np.random.Generator, canvas: Canvas, image: Image) -> None:
    """Words, dots and frames that a video shows over the scene: they are no thread, and they hide it."""
    shape = canvas.light.shape[:2]
    mask = np.zeros(shape, np.uint8)
    kind = rng.random()
    if kind < 0.6:
        words, font = " ".join(rng.choice(WORDS, 2)), int(rng.choice(FONTS))
        at = int(rng.choice([0.01, 0.5, 0.7]) * shape[1]), int(rng.choice([0.05, 0.95]) * shape[0])
        cv2.putText(mask, words, at, font, rng.uniform(0.5, 1.2), 255, int(rng.integers(1, 3)), cv2.LINE_AA)
    else:
        for _ in range(int(rng.integers(1, 4))):
            at = rng.uniform(0.1, 0.9, 2) * shape[::-1]
            thick = -1 if kind < 0.9 else 2
            cv2.circle(mask, (int(at[0]), int(at[1])), int(rng.uniform(3, 14)), 255, thick, cv2.LINE_AA)
    colours = [(0, 140, 0), (255, 255, 255), (0, 255, 255), (0, 0, 255), (255, 0, 0), (0, 255, 0)]
    alpha = mask.astype(np.float32) / 255
    colour = np.array(colours[int(rng.integers(6))], np.float32)
    image += alpha[..., None] * (colour - image)
    lay(canvas, np.s_[:, :], canvas.image, alpha, GROUND, is_lit=False)


def _compressed(rng: np.random.Generator, image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """As a still or a video keeps it: sometimes from a smaller picture, with softened blocks."""
    kind, size = rng.random(), image.shape[1::-1]
    if kind < 0.25:
        return image
    if kind > 0.7:
        share = rng.uniform(0.6, 1.0)
        image = cv2.resize(image, (int(size[0] * share), int(size[1] * share)), interpolation=cv2.INTER_AREA)
    quality = int(rng.uniform(30, 96))
    coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    image = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)
    if kind > 0.7:
        if quality < 70:
            image = cv2.bilateralFilter(image, 5, rng.uniform(8, 20), 2)
        image = cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)
    return image


def write_scenes(folder: Path, seeds: range, meshes: dict[str, Solid], lists: Lists, ground: str | None) -> None:
    """Write the scenes of some seeds; those that are there already are left alone."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        paths = [folder / f"lab_{seed:06d}_{name}.png" for name in NAMES]
        if all(path.exists() for path in paths):
            continue
        scene = lab_scene(seed, meshes, lists, ground)
        for path, image in zip(paths, (scene.image, *scene.covers), strict=True):
            save(path, image)


@dataclasses.dataclass(frozen=True)
class Options:
    """Which scenes."""

    output: Path
    """Folder to write into."""
    count: int = 100
    seed: int = 1
    """Of the first scene; the others follow."""
    meshes: Path = Path("../shared/data/instruments")
    """Folder of the *.dae."""
    lists: Literal["train", "sealed"] = "train"
    """Of colours, lights and poses."""
    ground: Literal["pad", "phantom", "flesh", "cloth", "dark"] | None = None
    """What everything lies on; drawn by default."""


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line and write the scenes; returns the exit status."""
    options = tyro.cli(Options, args=arguments, description=__doc__)
    try:
        meshes = load_meshes(options.meshes)
    except SceneError as error:
        print(error, file=sys.stderr)
        return 2
    seeds = range(options.seed, options.seed + options.count)
    write_scenes(options.output, seeds, meshes, LISTS[options.lists], options.ground)
    return 0


if __name__ == "__main__":
    sys.exit(main())
