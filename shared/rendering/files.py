"""A rendered pair on disk: images, masks, the calibration, and the true centreline."""

import json
from pathlib import Path

import cv2
import numpy as np

from shared.camera import camera_matrix
from shared.rendering.render import RenderedPair, Scene, SceneError


def write_pair(folder: Path, scene: Scene, pair: RenderedPair, masks: bool = True) -> None:
    """Write left.png, right.png, calibration.json, truth.json and, where wanted, mask_left.png and mask_right.png.

    Raises:
        SceneError: where a file cannot be written; the text names it.
    """
    images = {"left.png": pair.left_bgr, "right.png": pair.right_bgr}
    if masks:
        images |= {"mask_left.png": pair.coverage_left, "mask_right.png": pair.coverage_right}
    documents = {"calibration.json": calibration_of(scene), "truth.json": truth_of(scene)}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, image in images.items():
            _, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
            (folder / name).write_bytes(data.tobytes())
        for name, document in documents.items():
            (folder / name).write_text(_as_text(document), encoding="utf-8")
    except OSError as error:
        raise SceneError(f"cannot write into {folder} ({error.strerror}); choose a folder you may write to") from error


def calibration_of(scene: Scene) -> dict[str, object]:
    """The calibration of the pair, in the keys of the published renders."""
    camera = scene.camera
    return {
        "width": camera.image_width,
        "height": camera.image_height,
        "K": camera_matrix(camera).tolist(),
        "baseline_mm": camera.baseline,
        "pixel_convention": "integer coordinate = pixel centre",
    }


def truth_of(scene: Scene) -> dict[str, object]:
    """The thread as a clamped B-spline in the left camera's frame."""
    thread = scene.thread
    return {
        "unit": "mm",
        "frame": "rectified left camera, OpenCV axes",
        "degree": thread.degree,
        "knots": thread.knots.tolist(),
        "control_points": np.round(thread.control_points, 6).tolist(),
        "radius_mm": round(thread.radius_mm, 6),
        "colour": scene.colour,
        "background": scene.background,
        "seed": scene.seed,
    }


def _as_text(document: dict[str, object]) -> str:
    """JSON with one key a line, which is short and still shows a difference."""
    lines = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in document.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"
