"""The simulator's published field as a camera would see it: tissue, thread and noise, but no tool.

What costs time is kept for as long as it holds: the tissue as long as tissue and camera are the same, the image without
noise, and how strong its noise is, as long as nothing in the field moves. Noise is cut out of one larger grain at a
place that the frame's number decides, so that a frame is a function of state and number alone.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from agents.camera.sources import Pair
from schemas.messages import RectifiedStereo, SimulatorState, StereoCalibration
from shared.calibration.uncertainty import ERRORS
from shared.camera import camera_matrix
from shared.rendering.centreline import Thread
from shared.rendering.render import COLOURS, Backdrop, SceneError, render_backdrop, render_thread
from shared.rendering.sensor import Sensor, grain, noise_deviation, with_noise

METRES_PER_MM = 1e-3
GRAIN_MARGIN_PX = 64
"""A grain this much larger than the image has 65² windows, so that noise does not repeat within a minute or two."""

SHIFT_RIGHT = 1_000_003
"""Where the right eye's windows are, relative to the left's: prime, so that the two never keep step."""


@dataclass(frozen=True)
class _Tissue:
    """A backdrop and what it was made from."""

    made_from: tuple[RectifiedStereo, str, float, int]
    backdrop: Backdrop
    grain: Float32[np.ndarray, "H W 3"]


@dataclass(frozen=True)
class _Clean:
    """Images without noise, blurred as the lens does, the deviations of their noise, and the state they show."""

    state: SimulatorState
    images: Pair
    deviations: tuple[Float32[np.ndarray, "h w 3"], ...]


class SceneSource:
    """Renders states of the simulator, one frame after another."""

    def __init__(self, sensor: Sensor | None = None) -> None:
        self._sensor = Sensor() if sensor is None else sensor
        self._tissue: _Tissue | None = None
        self._clean: _Clean | None = None

    def render(self, state: SimulatorState, frame: int) -> Pair:
        """What the cameras see of a state in the frame of that number; the first of a new tissue takes a second.

        Raises:
            SceneError: where the state names a colour or background that cannot be drawn, or a camera without a unit.
        """
        tissue = self._tissue_of(state)
        if self._clean is None or not _looks_alike(self._clean.state, state):
            images = self._without_noise(state, tissue)
            self._clean = _Clean(state, images, tuple(noise_deviation(image, self._sensor) for image in images))
        clean, numbers = self._clean, (2 * frame, 2 * frame + SHIFT_RIGHT)
        left, right = (
            with_noise(image, deviation, _window(tissue.grain, image.shape[:2], number))
            for image, deviation, number in zip(clean.images, clean.deviations, numbers, strict=True)
        )
        return left, right

    def _tissue_of(self, state: SimulatorState) -> _Tissue:
        if state.colour not in COLOURS:
            raise SceneError(f"unknown thread colour {state.colour!r}; known colours: {', '.join(COLOURS)}")
        camera = camera_in_mm(state.camera)
        wanted = (camera, state.background, state.distance_m / METRES_PER_MM, state.seed)
        if self._tissue is None or self._tissue.made_from != wanted:
            shape = (camera.image_height + GRAIN_MARGIN_PX, camera.image_width + GRAIN_MARGIN_PX)
            self._tissue = _Tissue(wanted, render_backdrop(*wanted), grain(shape, state.seed))
            self._clean = None
        return self._tissue

    def _without_noise(self, state: SimulatorState, tissue: _Tissue) -> Pair:
        control_points = state.control_points_camera / METRES_PER_MM
        thread = Thread(state.knots, control_points, state.radius_m / METRES_PER_MM)
        views = render_thread(tissue.made_from[0], thread, state.colour, tissue.backdrop)
        return _blurred(views[0].bgr, self._sensor), _blurred(views[1].bgr, self._sensor)


def camera_in_mm(camera: RectifiedStereo) -> RectifiedStereo:
    """The same camera in the renderer's unit.

    Raises:
        SceneError: where its unit is unknown.
    """
    if camera.metres_per_unit is None:
        raise SceneError("a camera of unknown unit cannot show a field in metres; give its metres_per_unit")
    baseline_mm = camera.baseline * (camera.metres_per_unit / METRES_PER_MM)
    return replace(camera, baseline=baseline_mm, metres_per_unit=METRES_PER_MM)


def calibration_of(camera: RectifiedStereo) -> StereoCalibration:
    """The calibration of the rendered images, in the camera's own unit: already rectified, without distortion."""
    T_right_left = np.eye(4)
    T_right_left[0, 3] = -camera.baseline
    return StereoCalibration(
        image_width=camera.image_width,
        image_height=camera.image_height,
        K_left=camera_matrix(camera),
        K_right=camera_matrix(camera),
        distortion_left=np.zeros(0),
        distortion_right=np.zeros(0),
        T_right_left=T_right_left,
        metres_per_unit=camera.metres_per_unit,
        # what is rendered is seen by this camera exactly
        covariance=np.zeros((len(ERRORS), len(ERRORS))),
    )


def _looks_alike(a: SimulatorState, b: SimulatorState) -> bool:
    return (
        a.camera == b.camera
        and (a.background, a.colour, a.seed) == (b.background, b.colour, b.seed)
        and (a.distance_m, a.radius_m) == (b.distance_m, b.radius_m)
        and np.array_equal(a.knots, b.knots)
        and np.array_equal(a.control_points_camera, b.control_points_camera)
    )


def _blurred(image: UInt8[np.ndarray, "h w 3"], sensor: Sensor) -> UInt8[np.ndarray, "h w 3"]:
    return cv2.GaussianBlur(image, (5, 5), sensor.blur_px) if sensor.blur_px > 0 else image


def _window(
    deviates: Float32[np.ndarray, "H W 3"], shape: tuple[int, int], number: int
) -> Float32[np.ndarray, "h w 3"]:
    """The window of that number; neighbours in number are far apart in place."""
    places = GRAIN_MARGIN_PX + 1
    row, column = divmod(number * 2654435761 % (places * places), places)
    return deviates[row : row + shape[0], column : column + shape[1]]
