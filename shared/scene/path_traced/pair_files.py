"""A traced pair on disk, in the form of the published renders: images, masks, the camera, the true centrelines."""

import json
from pathlib import Path

import cv2
import numpy as np

from shared.scene.path_traced.eyes import Rig
from shared.scene.path_traced.pair import CentrelineTruth, TracedPair
from shared.scene.path_traced.recipe import Recipe
from shared.scene.render import SceneError

COLUMNS = ("x", "y", "z", "arclength", "visible_left", "visible_right")


def is_written(folder: Path, name: str, recipe: Recipe, rig: Rig, samples: int) -> bool:
    """Whether the pair lies there already, whole: its document is written last.

    Raises:
        SceneError: where a pair of that name was made from another recipe, for another camera or with other samples.
    """
    path = folder / f"{name}.json"
    try:
        there = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    for what, wanted in asked(recipe, rig, samples).items():
        made = there.get("asked", {}).get(what, None if what == "distances" else wanted)
        if made != wanted:
            raise SceneError(
                f"{path} was made otherwise ({what}: {made}, not {wanted}); name another folder with --output"
            )
    return True


def asked(recipe: Recipe, rig: Rig, samples: int) -> dict[str, object]:
    """All that decides what a pair of a name looks like, and that its name does not tell."""
    left, right = rig.eyes
    cameras = [
        [
            eye.width,
            eye.height,
            eye.K.tolist(),
            eye.distortion.tolist(),
            eye.R_eye_left.tolist(),
            eye.t_eye_left.tolist(),
        ]
        for eye in (left, right)
    ]
    return {
        "with": list(recipe.extras),
        "colour": recipe.dye,
        "distances": None if recipe.distances_mm is None else list(recipe.distances_mm),
        "samples": samples,
        "cameras": cameras,
    }


def write_traced(folder: Path, name: str, pair: TracedPair) -> None:
    """Write NAME_left.png, NAME_right.png, the masks, NAME.npy of the first thread, NAME_needle.npy, NAME.json last.

    Raises:
        SceneError: where a file cannot be written; the text names the folder.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for side, images in zip(("left", "right"), pair.images, strict=True):
            _write_image(folder / f"{name}_{side}.png", images.bgr)
            for kind, cover in (("mask", images.thread), ("tool", images.tool), ("needle", images.needle)):
                if kind == "mask" or cover.any():
                    _write_image(folder / f"{name}_{kind}_{side}.png", np.rint(255.0 * cover).astype(np.uint8))
        tables = [_table(strand) for strand in pair.strands] or [np.zeros((0, 6), dtype=np.float32)]
        for index, table in enumerate(tables):
            np.save(folder / (f"{name}_thread{index + 1}.npy" if index else f"{name}.npy"), table)
        if pair.needle is not None:
            np.save(folder / f"{name}_needle.npy", _table(pair.needle))
        text = json.dumps(document(name, pair), indent=1)
        unfinished = folder / f".{name}.json"
        unfinished.write_text(text + "\n", encoding="utf-8")
        unfinished.replace(folder / f"{name}.json")
    except OSError as error:
        raise SceneError(f"cannot write into {folder} ({error.strerror}); choose a folder you may write to") from error


def document(name: str, pair: TracedPair) -> dict[str, object]:
    """What is known about the pair, in the keys of the published renders, and the other threads beside the first."""
    field = pair.arranged.field
    threads = [
        {
            "radius_mm": strand.radius_mm,
            "color": strand.dye,
            "length_mm": float(truth.arc_mm[-1]),
            "visible_left": float(truth.seen[0].mean()),
            "visible_right": float(truth.seen[1].mean()),
            "control_points": strand.curve.control_points.tolist(),
        }
        for strand, truth in zip(field.strands, pair.strands, strict=True)
    ]
    first = threads[0] if threads else {"radius_mm": 0.0, "color": "none", "length_mm": 0.0, "control_points": []}
    return {
        "name": name,
        "seed": pair.recipe.seed,
        "config": pair.arranged.config,
        "background": pair.recipe.background,
        "extras": list(pair.arranged.extras),
        "width": pair.rig.eyes[0].width,
        "height": pair.rig.eyes[0].height,
        "K": pair.rig.eyes[0].K.tolist(),
        "pixel_convention": "integer coordinate = pixel centre",
        "baseline_mm": pair.rig.baseline_mm,
        **_right_camera(pair.rig),
        "Z0": pair.arranged.distance_mm,
        "spp": pair.samples,
        "post": pair.arranged.effects.as_document(),
        "mask_offset_px": [float(np.abs(part).mean()) if len(part) else 0.0 for part in pair.offsets_px],
        "mask_bias_px": [float(part.mean()) if len(part) else 0.0 for part in pair.offsets_px],
        "threads": len(threads),
        **first,
        "other_threads": threads[1:],
        "needle_radius_mm": None if field.needle is None else field.needle.radius_mm,
        "npy_columns": list(COLUMNS),
        "asked": asked(pair.recipe, pair.rig, pair.samples),
    }


def _right_camera(rig: Rig) -> dict[str, object]:
    if rig.is_rectified:
        return {"right_camera": "P_right = P_left - [baseline,0,0]"}
    left, right = rig.eyes
    return {
        "right_camera": "P_right = R_right_left P_left + t_right_left_mm",
        "K_right": right.K.tolist(),
        "distortion_left": left.distortion.tolist(),
        "distortion_right": right.distortion.tolist(),
        "R_right_left": right.R_eye_left.tolist(),
        "t_right_left_mm": right.t_eye_left.tolist(),
    }


def _table(line: CentrelineTruth) -> np.ndarray:
    left, right = line.seen
    return np.column_stack((line.points, line.arc_mm, left, right)).astype(np.float32)


def _write_image(path: Path, image: np.ndarray) -> None:
    _, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 6])
    path.write_bytes(data.tobytes())
