"""A drawn instrument over plain tissue, quickly, where a test needs one: before a small camera, always the same."""

import dataclasses

import cv2
import numpy as np
from jaxtyping import Float64

from schemas.messages import RectifiedStereo
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER as PSM
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as T_TRUE
from shared.rendering.sensor import Sensor, expose, grain
from shared.rendering.tool_view import Instrument, draw_solids, solids_of

CAMERA = RectifiedStereo(640, 360, 660.0, 660.0, 319.5, 179.5, 0.0055, 1.0)
IN_MM = dataclasses.replace(CAMERA, baseline=5.5, metres_per_unit=1e-3)
JAW = 0.6
TOOL = Instrument(shaft_metal="dark", stains=2)


def tissue(seed: int) -> np.ndarray:
    """Red tissue, here darker and there brighter, with highlights."""
    rng = np.random.default_rng(seed)
    rough = cv2.resize(rng.standard_normal((12, 20)).astype(np.float32), (640, 360), interpolation=cv2.INTER_CUBIC)
    image = np.array((85.0, 90.0, 170.0)) * (1 + 0.12 * rough[..., None])
    image[rng.random((360, 640)) > 0.9997] = 255
    return np.clip(cv2.GaussianBlur(image, (0, 0), 1.5), 0, 255).astype(np.uint8)


BEHIND = tissue(0)


def joints(at_s: float) -> np.ndarray:
    """Of a tool that swings to and fro."""
    swing = np.array((0.03, 0.02, 0.006, 0.5, 0.3, 0.3)) * np.sin(0.9 * at_s + np.arange(6))
    return np.array((0.02, 0.0, 0.172, 0.2, 0.35, 0.3)) + swing


def pair(at_s: float, seed: int, shown: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Both images of a time, with noise of a seed; without the tool where it is not `shown`."""
    return pair_of(PSM.forward(joints(at_s)), JAW, seed, shown)


def pair_of(
    T_base_tool: Float64[np.ndarray, "4 4"], jaw_rad: float, seed: int, shown: bool = True, tool: Instrument = TOOL
) -> tuple[np.ndarray, np.ndarray]:
    """Both images of a tool there."""
    solids = solids_of(T_TRUE, T_base_tool, jaw_rad, tool)
    images = [draw_solids(BEHIND, IN_MM, solids, tool, x, seed)[0] if shown else BEHIND for x in (0.0, 5.5)]
    noisy = [expose(one, Sensor(), grain(one.shape[:2], 2 * seed + k)) for k, one in enumerate(images)]
    return noisy[0], noisy[1]
