"""Stereo pairs in which there is no thread, so that everything that is found in them is false.

Tissue that is drawn, the rendered fields that come with the project, and path-traced scenes of folders, with
instruments, stains and smoke, take the same number of frames each. Every frame is its own chance to be wrong: another
tissue or distance, mirrored, upside down, in other light, under other noise.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from agents.camera.scene_source import calibration_of
from agents.cli.reconstruct.pipeline import Pair
from benchmarks.scenes import Scene, rendered
from shared.rendering.render import ENDOSCOPE, RENDERED, TISSUE, render_backdrop
from shared.rendering.sensor import Sensor, expose, grain

NEAREST_MM, FARTHEST_MM = 70.0, 120.0
FRAMES_OF_ONE_TISSUE = 5
"""The same tissue under other noise is cheaper to render, and each frame is a chance of its own to be wrong."""
SALT = 91
GAINS, TINT = (0.75, 1.3), 0.05
"""Of the light, in display values, and the deviation of each channel's."""
FAINT = Sensor(blur_px=0.0, read_noise=0.7, shot_noise=1.1)
"""Path-traced images have a camera's blur and noise already; this only makes two frames differ."""


def thread_free(frames: int, seed: int, folders: Sequence[Path] = ()) -> Iterator[Scene]:
    """So many pairs without thread, of every kind as many, or one more; the group of each is its kind.

    Raises:
        ValueError: for a folder without thread-free scenes.
    """
    stored = _stored(folders)
    kinds = 2 + bool(folders)
    shares = [len(range(kind, frames, kinds)) for kind in range(kinds)]
    yield from _drawn(shares[0], seed)
    yield from _over_fields(shares[1], seed)
    if folders:
        yield from _again(shares[2], seed, stored)


def _drawn(frames: int, seed: int) -> Iterator[Scene]:
    """Drawn tissue: another one, at another distance, every few frames."""
    for tissue in range(-(-frames // FRAMES_OF_ONE_TISSUE)):
        rng = np.random.default_rng([seed, tissue, SALT])
        distance_mm = float(rng.uniform(NEAREST_MM, FARTHEST_MM))
        backdrop = render_backdrop(ENDOSCOPE, TISSUE, distance_mm, int(rng.integers(1 << 30)))
        images = backdrop.left_bgr, backdrop.right_bgr
        for frame in range(min(FRAMES_OF_ONE_TISSUE, frames - tissue * FRAMES_OF_ONE_TISSUE)):
            name = f"{tissue}_{frame}"
            yield Scene("drawn tissue", name, _exposed(images, Sensor(), rng), calibration_of(ENDOSCOPE))


def _over_fields(frames: int, seed: int) -> Iterator[Scene]:
    """The fields in turn, each time from another distance."""
    for frame in range(frames):
        rng = np.random.default_rng([seed, frame, SALT + 1])
        backdrop = render_backdrop(ENDOSCOPE, RENDERED, float(rng.uniform(NEAREST_MM, FARTHEST_MM)), 1 + frame)
        images = _varied((backdrop.left_bgr, backdrop.right_bgr), rng)
        yield Scene("rendered fields", str(frame), _exposed(images, Sensor(), rng), calibration_of(ENDOSCOPE))


def _stored(folders: Sequence[Path]) -> list[Path]:
    """The documents of the folders' scenes without thread.

    Raises:
        ValueError: where there is none.
    """
    found = [path for folder in folders for path in sorted(folder.glob("**/*.json")) if _has_no_thread(path)]
    if folders and not found:
        said = ", ".join(map(str, folders))
        raise ValueError(f"no thread-free scene in {said}; make some by suturegrasp scenes render --config none")
    return found


def _again(frames: int, seed: int, paths: Sequence[Path]) -> Iterator[Scene]:
    """The scenes in turn, the first time as they are."""
    for frame in range(frames):
        scene = rendered(paths[frame % len(paths)])
        images, rng = scene.images, np.random.default_rng([seed, frame, SALT + 2])
        if frame >= len(paths):
            images = _exposed(_varied(images, rng), FAINT, rng)
        yield Scene("path-traced scenes", f"{scene.name}_{frame}", images, scene.calibration)


def _has_no_thread(path: Path) -> bool:
    """Whether a document is that of a scene whose mask is empty."""
    mask = path.with_name(f"{path.stem}_mask_left.png")
    return mask.is_file() and not np.any(cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE))


def _varied(images: Pair, rng: np.random.Generator) -> Pair:
    """The pair as it is or upside down, as it is or mirrored (so that the eyes change places), in another light."""
    left, right = images
    if rng.integers(2):
        left, right = left[::-1], right[::-1]
    if rng.integers(2):
        left, right = right[:, ::-1], left[:, ::-1]
    gain = rng.uniform(*GAINS) * rng.normal(1.0, TINT, 3)
    left, right = (np.clip(np.rint(gain * image), 0, 255).astype(np.uint8) for image in (left, right))
    return left, right


def _exposed(images: Pair, sensor: Sensor, rng: np.random.Generator) -> Pair:
    shape = images[0].shape[0], images[0].shape[1]
    left, right = (expose(image, sensor, grain(shape, int(rng.integers(1 << 30)))) for image in images)
    return left, right
