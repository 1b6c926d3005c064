"""A stereo pair of a scene, in two steps: the background once, the thread over it for every frame."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import UInt8

from schemas.messages import RectifiedStereo
from shared.rendering.backdrop_files import Backdrop, SceneError
from shared.rendering.centreline import Thread, sample_centreline, shifted_to_right
from shared.rendering.compositing import cast_shadow, lay_over, shade_tube
from shared.rendering.rendered_fields import rendered_backdrop, rendered_surface
from shared.rendering.sensor import Sensor, expose, grain
from shared.rendering.surface import Surface, flat_surface, tissue_surface
from shared.rendering.thread_shapes import thread_on
from shared.rendering.tissue import GAMMA, PLAIN_GREY, tissue_texture, tissue_view, vignette
from shared.rendering.tube import TubePixels, coverage_image, tube_pixels

ENDOSCOPE = RectifiedStereo(
    image_width=960,
    image_height=540,
    fx_px=1000.0,
    fy_px=1000.0,
    cx_px=479.5,
    cy_px=269.5,
    baseline=5.5,
    metres_per_unit=1e-3,
)
"""The camera of the published renders."""
COLOURS = {
    "violet": (92.0, 50.0, 98.0),
    "black": (36.0, 36.0, 42.0),
    "blue": (110.0, 58.0, 52.0),
    "green": (66.0, 96.0, 52.0),
    "white": (186.0, 202.0, 214.0),
    "grey": (150.0, 150.0, 150.0),
}
"""Threads as they are sold (white is undyed), blue first, as they look where they face the light."""

TISSUE, PLAIN, RENDERED = "tissue", "plain", "rendered"
BACKGROUNDS = (TISSUE, PLAIN, RENDERED)
"""Tissue that is drawn here, a uniform grey, or one of the path-traced fields that come with the project."""


@dataclass(frozen=True)
class Scene:
    """Everything that the images of a thread depend on. Lengths are in millimetres, the camera's included."""

    camera: RectifiedStereo
    thread: Thread
    colour: str = "violet"
    background: str = "tissue"
    distance_mm: float = 95.0
    seed: int = 0
    sensor: Sensor = field(default_factory=Sensor)

    def __post_init__(self) -> None:
        if self.colour not in COLOURS:
            raise SceneError(f"unknown thread colour {self.colour!r}; known colours: {', '.join(COLOURS)}")
        check_background(self.background)


@dataclass(frozen=True)
class RenderedPair:
    """The images, blue first, and how much of each pixel is thread, 0 to 255."""

    left_bgr: UInt8[np.ndarray, "h w 3"]
    right_bgr: UInt8[np.ndarray, "h w 3"]
    coverage_left: UInt8[np.ndarray, "h w"]
    coverage_right: UInt8[np.ndarray, "h w"]


@dataclass(frozen=True)
class View:
    """One eye's image with the thread in it, before the sensor, and the thread's pixels."""

    bgr: UInt8[np.ndarray, "h w 3"]
    tube: TubePixels


def check_background(name: str) -> None:
    """Raise a SceneError unless there is a background of that name."""
    if name not in BACKGROUNDS:
        raise SceneError(f"unknown background {name!r}; known backgrounds: {', '.join(BACKGROUNDS)}")


def surface_of(camera: RectifiedStereo, background: str, distance_mm: float, seed: int) -> Surface:
    """The surface that a background puts behind the thread."""
    check_background(background)
    if background == PLAIN:
        return flat_surface(distance_mm)
    if background == RENDERED:
        return rendered_surface(distance_mm, seed)
    return tissue_surface(camera, distance_mm, seed)


def make_scene(
    config: str,
    background: str,
    seed: int,
    colour: str = "violet",
    distance_mm: float = 95.0,
    camera: RectifiedStereo = ENDOSCOPE,
) -> Scene:
    """A scene of a configuration: a thread that the seed draws, on the surface that the same seed makes."""
    surface = surface_of(camera, background, distance_mm, seed)
    thread = thread_on(camera, surface, config, seed)
    return Scene(camera, thread, colour, background, distance_mm, seed)


def render_backdrop(camera: RectifiedStereo, background: str, distance_mm: float, seed: int) -> Backdrop:
    """The background in both cameras: most of a second, so keep it while only the thread moves."""
    if background == RENDERED:
        return rendered_backdrop(camera, distance_mm, seed)
    surface = surface_of(camera, background, distance_mm, seed)
    if background == PLAIN:
        shape = (camera.image_height, camera.image_width)
        grey = np.full((*shape, 3), PLAIN_GREY, dtype=np.uint8)
        depth = np.full(shape, distance_mm, dtype=np.float32)
        return Backdrop(surface, grey, grey, depth, depth, shadows=False)
    texture = tissue_texture(surface, seed)
    left, depth_left = tissue_view(camera, surface, texture, 0.0)
    right, depth_right = tissue_view(camera, surface, texture, camera.baseline)
    return Backdrop(surface, left, right, depth_left, depth_right, shadows=True)


def render_thread(camera: RectifiedStereo, thread: Thread, colour: str, backdrop: Backdrop) -> tuple[View, View]:
    """The thread, and its shadow on tissue, over the backdrop: the left and the right view."""
    centreline = sample_centreline(camera, thread)
    views: list[View] = []
    eyes = (
        (0.0, backdrop.left_bgr, centreline),
        (camera.baseline, backdrop.right_bgr, shifted_to_right(camera, centreline)),
    )
    for eye_x_mm, behind, seen in eyes:
        image = behind.copy()
        if backdrop.shadows:
            cast_shadow(image, camera, backdrop.surface, centreline, thread.radius_mm, eye_x_mm, backdrop.lights)
        tube = tube_pixels(camera, seen, thread.radius_mm)
        light = _light_on(camera, tube) if backdrop.shadows else 1.0
        lay_over(image, tube, shade_tube(tube, COLOURS[colour], light))
        views.append(View(image, tube))
    return views[0], views[1]


def render(scene: Scene) -> RenderedPair:
    """The whole pair, the same for the same scene."""
    backdrop = render_backdrop(scene.camera, scene.background, scene.distance_mm, scene.seed)
    left, right = render_thread(scene.camera, scene.thread, scene.colour, backdrop)
    shape = (scene.camera.image_height, scene.camera.image_width)
    return RenderedPair(
        expose(left.bgr, scene.sensor, grain(shape, 2 * scene.seed)),
        expose(right.bgr, scene.sensor, grain(shape, 2 * scene.seed + 1)),
        mask_of(scene.camera, left.tube),
        mask_of(scene.camera, right.tube),
    )


def mask_of(camera: RectifiedStereo, tube: TubePixels) -> UInt8[np.ndarray, "h w"]:
    """Coverage as an image of 0 to 255."""
    return np.rint(255.0 * coverage_image(camera, tube)).astype(np.uint8)


def _light_on(camera: RectifiedStereo, tube: TubePixels) -> np.ndarray:
    """What the vignette leaves on the tube's pixels, in display values."""
    p = (tube.flat % camera.image_width - camera.cx_px) / camera.fx_px
    q = (tube.flat // camera.image_width - camera.cy_px) / camera.fy_px
    return vignette(camera, p, q) ** GAMMA
