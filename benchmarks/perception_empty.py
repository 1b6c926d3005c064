"""Stereo pairs in which there is no thread, so that everything that is found in them is false."""

from collections.abc import Iterator

import numpy as np
from rich.progress import track

from agents.cli.pipeline import reconstruct_pair
from agents.reconstruction.method_names import DEFAULT_METHOD
from benchmarks.scenes import Pair
from schemas.messages import RectifiedStereo, Status, StereoCalibration
from shared.camera import camera_matrix
from shared.scene.render import render_backdrop
from shared.scene.sensor import Sensor, expose, grain

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)
NEAREST_MM, FARTHEST_MM = 70.0, 120.0
FRAMES_OF_ONE_TISSUE = 5
"""The same tissue under other noise is cheaper to render, and each frame is a chance of its own to be wrong."""
SALT = 91


def false_threads(frames: int, segmenter: str, seed: int = 0) -> dict[str, int]:
    """How often perception, and reconstruction after it, takes something in so many thread-free frames for thread."""
    counts = {"frames": 0, "perception": 0, "reconstruction": 0}
    for pair in track(thread_free(frames, seed), f"thread-free frames, {segmenter}", frames, transient=True):
        result = reconstruct_pair(pair, calibration(), masks=None, segmenter=segmenter, method=DEFAULT_METHOD)
        counts["frames"] += 1
        counts["perception"] += result.observations.status is Status.OK
        counts["reconstruction"] += result.reconstruction.status is Status.OK
    return counts


def thread_free(frames: int, seed: int) -> Iterator[Pair]:
    """Rendered tissue without a thread: another one, at another distance, every few frames."""
    shape = (CAMERA.image_height, CAMERA.image_width)
    for tissue in range(-(-frames // FRAMES_OF_ONE_TISSUE)):
        rng = np.random.default_rng([seed, tissue, SALT])
        distance_mm = float(rng.uniform(NEAREST_MM, FARTHEST_MM))
        backdrop = render_backdrop(CAMERA, "tissue", distance_mm, int(rng.integers(1 << 30)))
        for _ in range(min(FRAMES_OF_ONE_TISSUE, frames - tissue * FRAMES_OF_ONE_TISSUE)):
            noise = [grain(shape, int(rng.integers(1 << 30))) for _ in range(2)]
            yield expose(backdrop.left_bgr, Sensor(), noise[0]), expose(backdrop.right_bgr, Sensor(), noise[1])


def calibration() -> StereoCalibration:
    """Of the rendered images."""
    T_right_left = np.eye(4)
    T_right_left[0, 3] = -CAMERA.baseline
    none = np.zeros(0)
    K = camera_matrix(CAMERA)
    return StereoCalibration(
        CAMERA.image_width, CAMERA.image_height, K, K, none, none, T_right_left, CAMERA.metres_per_unit
    )
