"""Many quick scenes to train on: python -m benchmarks.training.light_scenes --count 120 --seed 1 --output DIR.

One backdrop carries several scenes, each with no, one or two threads of colours as varied as sutures and lamps are.
Files are named as those of path-traced scenes: NAME_left.png, NAME_mask_left.png, and the right ones.
"""

import dataclasses
import sys
from pathlib import Path

import cv2
import numpy as np
import tyro
from jaxtyping import Float32, UInt8

from schemas.messages import RectifiedStereo
from shared.rendering.centreline import Thread, sample_centreline, shifted_to_right
from shared.rendering.compositing import cast_shadow, lay_over, shade_tube
from shared.rendering.render import COLOURS, ENDOSCOPE, Backdrop, render_backdrop
from shared.rendering.sensor import Sensor, expose, grain
from shared.rendering.thread_shapes import CONFIGS, ShapeError, thread_on
from shared.rendering.tissue import GAMMA, vignette
from shared.rendering.tube import TubePixels, coverage_image, tube_pixels

SCENES_PER_BACKDROP = 3
THREADS = 0, 1, 1, 1, 1, 2
"""How many lie in a scene: one of these."""
DISTANCE_MM = 68.0, 120.0
RADIUS_MM = 0.09, 0.30
COLOUR_SPREAD = 0.18
"""Of each channel, relative."""
Image = UInt8[np.ndarray, "h w 3"]
Coverage = UInt8[np.ndarray, "h w"]


def scenes_over_one_backdrop(
    seed: int, camera: RectifiedStereo = ENDOSCOPE
) -> list[tuple[tuple[Image, Coverage], tuple[Image, Coverage]]]:
    """Scenes over the backdrop that the seed makes: of each the left and the right image with its true coverage."""
    rng = np.random.default_rng([seed, 11])
    distance_mm = float(rng.uniform(*DISTANCE_MM))
    backdrop = render_backdrop(camera, "tissue", distance_mm, seed)
    scenes: list[tuple[tuple[Image, Coverage], tuple[Image, Coverage]]] = []
    for scene in range(SCENES_PER_BACKDROP):
        threads = _threads(camera, backdrop, SCENES_PER_BACKDROP * seed + scene, rng)
        colours = [_colour(rng) for _ in threads]
        sensor = Sensor(float(rng.uniform(0.3, 0.9)), float(rng.uniform(0.5, 2.0)), float(rng.uniform(1.0, 4.0)))
        left, right = (
            _seen(camera, backdrop, threads, colours, sensor, eye, 2 * (SCENES_PER_BACKDROP * seed + scene) + eye)
            for eye in (0, 1)
        )
        scenes.append((left, right))
    return scenes


def _threads(camera: RectifiedStereo, backdrop: Backdrop, seed: int, rng: np.random.Generator) -> list[Thread]:
    threads: list[Thread] = []
    for thread in range(int(rng.choice(THREADS))):
        config = str(rng.choice(list(CONFIGS)))
        radius_mm = float(rng.uniform(*RADIUS_MM))
        try:
            threads.append(thread_on(camera, backdrop.surface, config, 2 * seed + thread, radius_mm))
        except ShapeError:
            # at this distance no thread of this configuration fits; the scene has one fewer
            continue
    return threads


def _colour(rng: np.random.Generator) -> tuple[float, float, float]:
    blue, green, red = np.array(COLOURS[str(rng.choice(list(COLOURS)))]) * rng.normal(1.0, COLOUR_SPREAD, 3)
    return float(blue), float(green), float(red)


def _seen(
    camera: RectifiedStereo,
    backdrop: Backdrop,
    threads: list[Thread],
    colours: list[tuple[float, float, float]],
    sensor: Sensor,
    eye: int,
    grain_seed: int,
) -> tuple[Image, Coverage]:
    """One eye's image of the threads over the backdrop, and how much of each pixel they cover."""
    image = (backdrop.right_bgr if eye else backdrop.left_bgr).copy()
    clear: Float32[np.ndarray, "h w"] = np.ones(image.shape[:2], np.float32)
    for thread, colour in zip(threads, colours, strict=True):
        centreline = sample_centreline(camera, thread)
        cast_shadow(image, camera, backdrop.surface, centreline, thread.radius_mm, eye * camera.baseline)
        tube = tube_pixels(camera, shifted_to_right(camera, centreline) if eye else centreline, thread.radius_mm)
        lay_over(image, tube, shade_tube(tube, colour, _light_on(camera, tube)))
        clear *= 1 - coverage_image(camera, tube)
    coverage = np.rint(255 * (1 - clear)).astype(np.uint8)
    return expose(image, sensor, grain(coverage.shape, grain_seed)), coverage


def _light_on(camera: RectifiedStereo, tube: TubePixels) -> np.ndarray:
    p = (tube.flat % camera.image_width - camera.cx_px) / camera.fx_px
    q = (tube.flat // camera.image_width - camera.cy_px) / camera.fy_px
    return vignette(camera, p, q) ** GAMMA


def write_scenes(folder: Path, first_seed: int, count: int, camera: RectifiedStereo = ENDOSCOPE) -> None:
    """Write the scenes over so many backdrops; those that are there already are left alone."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed in range(first_seed, first_seed + count):
        names = [f"light_{seed:05d}_{scene}" for scene in range(SCENES_PER_BACKDROP)]
        if all((folder / f"{name}_mask_right.png").exists() for name in names):
            continue
        for name, views in zip(names, scenes_over_one_backdrop(seed, camera), strict=True):
            for eye, (image, coverage) in zip(("left", "right"), views, strict=True):
                _write(folder / f"{name}_{eye}.png", image)
                _write(folder / f"{name}_mask_{eye}.png", coverage)


def _write(path: Path, image: np.ndarray) -> None:
    path.write_bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1].tobytes())


@dataclasses.dataclass(frozen=True)
class Options:
    """Which scenes."""

    output: Path
    """Folder to write into."""
    count: int = 120
    """Of backdrops, each with three scenes."""
    seed: int = 1
    """Of the first backdrop; the others follow."""


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line and write the scenes; returns the exit status."""
    options = tyro.cli(Options, args=arguments, description=__doc__)
    write_scenes(options.output, options.seed, options.count)
    return 0


if __name__ == "__main__":
    sys.exit(main())
