"""Sequences of a moving inextensible thread, rendered, a share of whose length is the same piece in every frame."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.perception.instances import as_sent
from agents.perception.observe import observe
from schemas.messages import FrameStamp, RectifiedStereo, ThreadObservations
from shared.arc_length import even_parameters
from shared.calibration.uncertainty import ERRORS
from shared.camera import project
from shared.rendering.centreline import Thread
from shared.rendering.render import mask_of, render_backdrop, render_thread, surface_of
from shared.rendering.sensor import Sensor, expose, grain
from shared.rendering.thread_shapes import thread_on
from shared.rigid_transforms import exp_so3
from shared.splines import basis_matrix, evaluate

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)
DISTANCE_MM = 100.0
RATE_HZ = 30.0
SAMPLES = 401
JUMP_PX = 100.0
TOOL_GREY, TOOL_WIDTH_SHARE = 150, 0.14


@dataclass(frozen=True)
class Kind:
    """How a thread moves.

    Fields:
        step_px: its fastest motion from frame to frame, about.
        bend_deg: how far its tangents turn against each other.
        hidden: whether a tool passes before it.
        jump_at: the frame before which it is laid elsewhere, and where it is out of sight.
    """

    name: str
    step_px: float
    bend_deg: float
    hidden: bool = False
    jump_at: int | None = None
    gone: tuple[int, int] | None = None


KINDS = (
    Kind("still", 0.0, 0.0),
    Kind("slow", 3.0, 8.0),
    Kind("fast", 12.0, 25.0),
    Kind("tool passes", 3.0, 8.0, hidden=True),
    Kind("moved by 100 px", 3.0, 8.0, jump_at=22),
    Kind("out of sight", 3.0, 8.0, gone=(20, 24)),
)


@dataclass(frozen=True)
class Drawn:
    """Both images and true masks, and where each of evenly spaced material points is."""

    images: list[UInt8[np.ndarray, "h w 3"]]
    masks: list[UInt8[np.ndarray, "h w"]]
    truth: Float64[np.ndarray, "n 3"]


@dataclass(frozen=True)
class Frame:
    """What perception saw, and where each of evenly spaced material points is; visible: in either image."""

    observations: ThreadObservations
    truth: Float64[np.ndarray, "n 3"]


def sequence(
    config: str, seed: int, kind: Kind, frames: int, binary: bool, camera: RectifiedStereo = CAMERA
) -> Iterator[Frame]:
    """The frames of a moving thread, masks given."""
    for number, drawn in enumerate(images_of(config, seed, kind, frames, camera)):
        masks = [np.where(mask >= 128, 255, 0).astype(np.uint8) for mask in drawn.masks] if binary else drawn.masks
        (left, right), (mask_left, mask_right) = drawn.images, masks
        seen = observe(stamp_of(number), camera, left, right, mask_left, mask_right, "mask", matching=False)
        # the camera is as it says
        seen = replace(seen, calibration_covariance=np.zeros((len(ERRORS), len(ERRORS))))
        yield Frame(as_sent(seen), drawn.truth)


def stamp_of(number: int) -> FrameStamp:
    """When a frame was taken."""
    at_ns = round(number * 1e9 / RATE_HZ)
    return FrameStamp(number, at_ns, at_ns, "")


def images_of(
    config: str, seed: int, kind: Kind, frames: int, camera: RectifiedStereo = CAMERA, background: str = "plain"
) -> Iterator[Drawn]:
    """The images of a moving thread."""
    first = thread_on(camera, surface_of(camera, background, DISTANCE_MM, seed), config, seed)
    backdrop = render_backdrop(camera, background, DISTANCE_MM, seed)
    for number in range(frames):
        thread = moved(first, camera, kind, number / RATE_HZ, seed)
        if kind.jump_at is not None and number >= kind.jump_at:
            # towards the middle
            above = project(camera, material_points(thread))[0][:, 1].mean() < camera.cy_px
            by = (1 if above else -1) * JUMP_PX * DISTANCE_MM / camera.fx_px * np.array((0.3, 0.954, 0.0))
            thread = replace(thread, control_points=thread.control_points + by)
        images, masks = [], []
        for eye, view in enumerate(render_thread(camera, thread, "violet", backdrop)):
            noise = grain((camera.image_height, camera.image_width), 7919 * seed + 2 * number + eye)
            images.append(expose(view.bgr, Sensor(), noise))
            masks.append(mask_of(camera, view.tube))
        if kind.hidden:
            _hide(images, masks, camera, number / frames)
        if kind.gone and kind.gone[0] <= number < kind.gone[1]:
            masks = [np.zeros_like(mask) for mask in masks]
            images = [np.full_like(image, TOOL_GREY) for image in images]
        yield Drawn(images, masks, material_points(thread))


def material_points(thread: Thread, count: int = SAMPLES) -> Float64[np.ndarray, "n 3"]:
    """Points at even shares of the length."""
    s = even_parameters(thread.knots, thread.control_points, thread.degree, count)
    return evaluate(thread.knots, thread.control_points, thread.degree, s)


def moved(first: Thread, camera: RectifiedStereo, kind: Kind, at_s: float, seed: int) -> Thread:
    """The thread at a moment."""
    rng = np.random.default_rng([seed, 11])
    phases = rng.uniform(0, 2 * np.pi, 8)
    u = np.linspace(0.0, 1.0, SAMPLES)

    def wave(hz: float, phase: float) -> float:
        return float(np.sin(2 * np.pi * hz * at_s + phase) - np.sin(phase))

    points = material_points(first)
    turn = np.radians(kind.bend_deg) * (
        wave(0.5, phases[0]) * np.sin(np.pi * u + phases[1])
        + 0.5 * wave(0.8, phases[2]) * np.sin(2 * np.pi * u + phases[3])
    )
    steps = np.diff(points, axis=0)
    angle = 0.5 * (turn[1:] + turn[:-1])
    c, s = np.cos(angle), np.sin(angle)
    turned = np.column_stack((c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1], steps[:, 2]))
    bent = np.concatenate((np.zeros((1, 3)), np.cumsum(turned, axis=0)))
    middle = points.mean(axis=0)
    bent += middle - bent.mean(axis=0)
    # a sine of 1 Hz changes by its amplitude times 2 pi / 30 from frame to frame
    reach = kind.step_px * DISTANCE_MM / camera.fx_px / (2 * np.pi / RATE_HZ)
    way = 0.5 * reach * np.array((wave(0.9, phases[4]), wave(0.7, phases[5]), 0.5 * wave(0.6, phases[6])))
    spin = exp_so3(
        0.1 * np.radians(kind.bend_deg) * np.array((wave(0.4, phases[7]), wave(0.5, phases[3]), wave(0.3, phases[1])))
    )
    placed = (bent - middle) @ spin.T + middle + way
    basis = basis_matrix(first.knots, first.degree, u)
    return replace(first, control_points=np.linalg.lstsq(basis, placed, rcond=None)[0])


def _hide(images: list[np.ndarray], masks: list[np.ndarray], camera: RectifiedStereo, share: float) -> None:
    """A tool's shaft from top to bottom, which passes from left to right in front of the thread."""
    width = round(TOOL_WIDTH_SHARE * camera.image_width)
    for eye, (image, mask) in enumerate(zip(images, masks, strict=True)):
        near = camera.fx_px * camera.baseline / (0.8 * DISTANCE_MM)
        start = round(share * (camera.image_width + width) - width - eye * near)
        band = slice(max(start, 0), max(start + width, 0))
        cv2.rectangle(image, (start, 0), (start + width, camera.image_height), (TOOL_GREY,) * 3, -1)
        mask[:, band] = 0
