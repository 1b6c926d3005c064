"""The field of an evaluation as it looks while it is grasped in: the thread moved, and the instrument in view."""

from functools import cached_property, lru_cache

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from agents.camera.scene_source import camera_in_mm
from agents.camera.sources import Pair
from agents.cli.evaluate.scenes import Scenery
from schemas.messages import RobotState, SimulatorState
from shared.rendering.backdrop_files import Backdrop
from shared.rendering.centreline import Thread
from shared.rendering.render import render_backdrop, render_thread
from shared.rendering.sensor import Sensor, expose, grain
from shared.rendering.surface import meet_rays, ray_tangents
from shared.rendering.tool_view import Instrument, draw_solids, solids_of

Bgr = UInt8[np.ndarray, "h w 3"]
MARGIN_PX, RADIUS_PX = 9, 5
"""How far beyond its mask thread is taken out of an image, and from how far around it is filled."""
COLOUR = {"undyed": "white"}


class FieldView:
    """Both eyes' images of a field at any moment.

    Path-traced images have their thread taken out by their masks, and the light renderer lays the moved one over what
    is left.
    """

    def __init__(self, scenery: Scenery) -> None:
        self._scenery = scenery
        self._camera = camera_in_mm(scenery.simulated.camera)

    def pair(self, state: SimulatorState, frame: int, arm: RobotState | None = None, whole: bool = False) -> Pair:
        """What both eyes see; with an arm, its fingers too, and with `whole` its wrist and shaft."""
        thread = Thread(state.knots, 1e3 * state.control_points_camera, 1e3 * state.radius_m)
        views = render_thread(self._camera, thread, self._colour, self._backdrop)
        images = [view.bgr for view in views]
        if arm is not None:
            tool = Instrument()
            solids = solids_of(arm.T_camera_base, arm.T_base_tool, arm.jaw_rad, tool)[0 if whole else 2 :]
            eyes = (0.0, self._camera.baseline)
            images = [
                draw_solids(image, self._camera, solids, tool, x, 0)[0] for image, x in zip(images, eyes, strict=True)
            ]
        shape = images[0].shape[:2]
        left, right = (expose(image, Sensor(), _grain(shape, 2 * frame + eye)) for eye, image in enumerate(images))
        return left, right

    @property
    def _colour(self) -> str:
        if self._scenery.traced is None:
            return self._scenery.simulated.colour
        dye = self._scenery.traced.dye
        return COLOUR.get(dye, dye)

    @cached_property
    def _backdrop(self) -> Backdrop:
        simulated, traced = self._scenery.simulated, self._scenery.traced
        if traced is None:
            return render_backdrop(self._camera, simulated.background, simulated.distance_mm, simulated.seed)
        images = [_without(image, mask) for image, mask in zip(self._scenery.images, traced.masks, strict=True)]
        p, q = ray_tangents(self._camera)
        depths = [meet_rays(traced.surface, p, q, eye_x_mm) for eye_x_mm in (0.0, self._camera.baseline)]
        return Backdrop(traced.surface, images[0], images[1], depths[0], depths[1], shadows=True)


@lru_cache(maxsize=4)
def _grain(shape: tuple[int, int], seed: int) -> Float32[np.ndarray, "h w 3"]:
    """That of the first looks, which every trial has."""
    return grain(shape, seed)


def _without(image: Bgr, mask: UInt8[np.ndarray, "h w"]) -> Bgr:
    """The image with what a mask covers filled from around it."""
    wide = cv2.dilate((mask > 0).astype(np.uint8), np.ones((MARGIN_PX, MARGIN_PX), np.uint8))
    return cv2.inpaint(image, wide, RADIUS_PX, cv2.INPAINT_TELEA)
