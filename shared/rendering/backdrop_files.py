"""A field without thread on disk, for the light renderer to lay threads over: images of both eyes, and the surface."""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from schemas.messages import RectifiedStereo
from shared.rendering.surface import Surface, meet_rays, ray_tangents


class SceneError(ValueError):
    """A scene that cannot be rendered: the text names what is wrong and what would do."""


@dataclass(frozen=True)
class Light:
    """A lamp beside the lens: where it is, in mm in the left camera's frame, and its share of the light."""

    place_mm: tuple[float, float, float]
    share: float


@dataclass(frozen=True)
class Backdrop:
    """What lies behind the thread, seen by both cameras, without noise; depths in mm along each camera's axis.

    Fields:
        shadows: whether a thread casts any.
        lights: those that cast them; none: the light renderer's own.
    """

    surface: Surface
    left_bgr: UInt8[np.ndarray, "h w 3"]
    right_bgr: UInt8[np.ndarray, "h w 3"]
    depth_left_mm: Float32[np.ndarray, "h w"]
    depth_right_mm: Float32[np.ndarray, "h w"]
    shadows: bool
    lights: tuple[Light, ...] = ()


DOCUMENT, SURFACE, SIDES = "backdrop.json", "surface.npz", ("left", "right")
QUALITY = 93
DEPTH_STEP_MM = 0.005
CAMERA_KEYS = ("image_width", "image_height", "fx_px", "fy_px", "cx_px", "cy_px", "baseline")


@dataclass(frozen=True)
class StoredField:
    """A field as it lies on disk: for which camera, in mm, its surface, both images, and the lamps beside the lens."""

    camera: RectifiedStereo
    surface: Surface
    left_bgr: UInt8[np.ndarray, "h w 3"]
    right_bgr: UInt8[np.ndarray, "h w 3"]
    lights: tuple[Light, ...]


def write_backdrop(folder: Path, camera: RectifiedStereo, backdrop: Backdrop, origin: dict[str, object]) -> None:
    """Write the images as JPEG, the surface's grid in steps of 5 µm, and the camera; `origin` says where it is from.

    Raises:
        SceneError: where a file cannot be written.
    """
    surface = backdrop.surface
    levels = np.rint(surface.depth_mm / DEPTH_STEP_MM).astype(np.uint16)
    seen_with = {key: getattr(camera, key) for key in CAMERA_KEYS}
    lights = [[*light.place_mm, light.share] for light in backdrop.lights]
    document = {"camera": seen_with, "unit": "mm", "lights": lights, "origin": origin}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for side, image in zip(SIDES, (backdrop.left_bgr, backdrop.right_bgr), strict=True):
            _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
            (folder / f"{side}.jpg").write_bytes(data.tobytes())
        grid = np.array([surface.x0_mm, surface.y0_mm, surface.step_mm])
        np.savez_compressed(folder / SURFACE, depth=levels, grid=grid)
        (folder / DOCUMENT).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise SceneError(f"cannot write into {folder} ({error.strerror}); choose a folder you may write to") from error


def stored_field(folder: Path) -> StoredField:
    """The field in a folder, as it was rendered.

    Raises:
        SceneError: where there is none; the text says what is wrong.
    """
    try:
        document = json.loads((folder / DOCUMENT).read_text(encoding="utf-8"))
        camera = RectifiedStereo(**{key: document["camera"][key] for key in CAMERA_KEYS}, metres_per_unit=1e-3)
        lights = tuple(Light((x, y, z), share) for x, y, z, share in document.get("lights", ()))
        with np.load(folder / SURFACE) as stored:
            depth, (x0, y0, step) = stored["depth"], stored["grid"].tolist()
        images = [cv2.imread(str(folder / f"{side}.jpg"), cv2.IMREAD_COLOR) for side in SIDES]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SceneError(
            f"{folder} holds no rendered field ({error}); make one by suturegrasp scenes backdrop"
        ) from error
    left, right = images
    if left is None or right is None:
        raise SceneError(f"{folder} lacks left.jpg or right.jpg; make it again by suturegrasp scenes backdrop")
    surface = Surface((depth * DEPTH_STEP_MM).astype(np.float32), x0, y0, step)
    return StoredField(camera, surface, np.asarray(left, dtype=np.uint8), np.asarray(right, dtype=np.uint8), lights)


def read_backdrop(folder: Path, camera: RectifiedStereo) -> Backdrop:
    """The field in a folder, for that camera alone.

    Raises:
        SceneError: where there is none, or it was made for another camera; the text says which.
    """
    field = stored_field(folder)
    made_for = field.camera
    other = [key for key in CAMERA_KEYS if not np.isclose(getattr(made_for, key), getattr(camera, key), rtol=1e-6)]
    if other:
        raise SceneError(
            f"{folder} was rendered for another camera, which differs in {', '.join(other)}; render it again"
        )
    p, q = ray_tangents(camera)
    depths = [meet_rays(field.surface, p, q, eye_x_mm) for eye_x_mm in (0.0, camera.baseline)]
    return Backdrop(field.surface, field.left_bgr, field.right_bgr, depths[0], depths[1], True, field.lights)
