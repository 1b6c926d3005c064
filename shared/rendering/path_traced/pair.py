"""One stereo pair from its recipe: traced, labelled, checked against its own truth, and seen by a camera.

On disk it has the form of the published renders: images, masks, the camera, the true centrelines.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from shared.rendering.path_traced.camera_effects import developed, gain_by_middle, gain_for
from shared.rendering.path_traced.eyes import Eye, Rig
from shared.rendering.path_traced.recipe import Arranged, Recipe, arranged
from shared.rendering.path_traced.solids import Needle
from shared.rendering.path_traced.splines import Strand, arc_lengths, sampled
from shared.rendering.path_traced.tracing import Sight, coverage, sight, traced_lab_light, traced_light, visible
from shared.rendering.path_traced.world import NEEDLE, STRAND, TOOL, build
from shared.rendering.render import SceneError

REACH_PX = 12.0
SPARE_PX = 1.5


def offset_from_truth(
    cover: Float32[np.ndarray, "h w"],
    eye: Eye,
    points: Float64[np.ndarray, "n 3"],
    shown: Bool[np.ndarray, "n"],
    radius_mm: float,
) -> Float64[np.ndarray, "k"]:
    """Across the projected centreline, how far the middle of its mask lies from it, in px, at places a pixel apart.

    Only where all around is visible and no other strand is near, since elsewhere the middle means nothing.
    """
    pixels = eye.project(points)
    travelled = arc_lengths(np.column_stack((pixels, np.zeros(len(pixels)))))
    even = np.arange(REACH_PX, travelled[-1] - REACH_PX)
    if not len(even):
        return np.zeros(0)
    place = np.column_stack([np.interp(even, travelled, axis) for axis in pixels.T])
    ahead = np.column_stack([np.interp(even + 2.0, travelled, axis) for axis in pixels.T])
    along = ahead - place
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    normal = np.column_stack((-along[:, 1], along[:, 0]))
    reach = np.linspace(-REACH_PX, REACH_PX, 193)
    profile = _bilinear(cover, place[:, None] + reach[:, None] * normal[:, None])
    whole = np.interp(even, travelled, shown.astype(np.float64))
    window = np.ones(2 * round(REACH_PX) + 1)
    near = np.convolve(np.pad(whole, round(REACH_PX), mode="edge"), window, "valid") > len(window) - 0.01
    half = np.interp(even, travelled, eye.focal_px * radius_mm / eye.seen_from(points)[:, 2])
    aside = np.abs(reach) > half[:, None] + SPARE_PX
    clear = near & (np.where(aside, profile, 0.0).max(axis=1, initial=0) == 0)
    weight = profile.sum(axis=1)
    kept = clear & (weight > 0)
    return (profile[kept] @ reach) / weight[kept]


def _bilinear(image: np.ndarray, where: np.ndarray) -> np.ndarray:
    u, v = where[..., 0].astype(np.float32), where[..., 1].astype(np.float32)
    # remap takes fewer than 32768 rows
    parts = [
        cv2.remap(image, u[k : k + 8192], v[k : k + 8192], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        for k in range(0, len(u), 8192)
    ]
    return np.concatenate(parts).astype(np.float64)


TURN_SEEDS = 1_000_003
"""From one turn of a recipe to the next: farther than batches reach."""


@dataclass(frozen=True)
class CentrelineTruth:
    """Points of a strand's or a needle's centreline in mm, arc lengths in mm, and which of them either eye sees."""

    points: Float64[np.ndarray, "n 3"]
    arc_mm: Float64[np.ndarray, "n"]
    seen: tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "n"]]


@dataclass(frozen=True)
class EyeImages:
    """What one eye's camera puts out, blue first, and the share of each pixel that is thread, tool, needle, 0 to 1."""

    bgr: UInt8[np.ndarray, "h w 3"]
    thread: Float32[np.ndarray, "h w"]
    tool: Float32[np.ndarray, "h w"]
    needle: Float32[np.ndarray, "h w"]


@dataclass(frozen=True)
class TracedPair:
    """A pair with all that is known about it.

    Fields:
        needle: from where the thread enters it to its point; None where there is none.
        offsets_px: how far the mask of the threads lies from the truth, left and right.
    """

    recipe: Recipe
    rig: Rig
    arranged: Arranged
    images: tuple[EyeImages, EyeImages]
    strands: list[CentrelineTruth]
    needle: CentrelineTruth | None
    offsets_px: tuple[Float64[np.ndarray, "k"], Float64[np.ndarray, "l"]]
    samples: int


def traced_pair(recipe: Recipe, rig: Rig, samples: int, turn: int = 0) -> TracedPair:
    """Trace a recipe with so many samples of each pixel.

    Args:
        turn: of the same recipe; each has other rays, and so another grain.

    Raises:
        SceneError: where it cannot be arranged for this camera, or Mitsuba is missing.
    """
    scenery = arranged(recipe, rig)
    scene = build(scenery.field)
    eyes = rig.eyes
    sights = [sight(scene, eye, 2 * recipe.seed + k) for k, eye in enumerate(eyes)]
    seed = 2 * recipe.seed + TURN_SEEDS * turn
    if scenery.field.lab_light is None:
        lights = [traced_light(scene, scenery.field.lamps, eye, samples, seed + k) for k, eye in enumerate(eyes)]
        gain = gain_for(lights[0], scenery.effects)
    else:
        lights = [traced_lab_light(scene, eye, samples, seed + k) for k, eye in enumerate(eyes)]
        gain = gain_by_middle(lights[0], scenery.effects)
    rng = np.random.default_rng([recipe.seed, 8])
    images = [
        _images(developed(light, scenery.effects, gain, rng), seen, eye)
        for light, seen, eye in zip(lights, sights, eyes, strict=True)
    ]
    strands = [_truth(strand, f"{STRAND}{index}", sights, eyes) for index, strand in enumerate(scenery.field.strands)]
    needle = None if scenery.field.needle is None else _truth(scenery.field.needle, f"{NEEDLE}0", sights, eyes)
    offsets = [_offsets(scenery, strands, seen, eye, k) for k, (seen, eye) in enumerate(zip(sights, eyes, strict=True))]
    return TracedPair(recipe, rig, scenery, (images[0], images[1]), strands, needle, (offsets[0], offsets[1]), samples)


def _images(bgr: UInt8[np.ndarray, "h w 3"], seen: Sight, eye: Eye) -> EyeImages:
    return EyeImages(bgr, *(coverage(seen.covers(kind), eye) for kind in (STRAND, TOOL, NEEDLE)))


def _truth(thing: Strand | Needle, part: str, sights: list[Sight], eyes: tuple[Eye, Eye]) -> CentrelineTruth:
    points, arc = sampled(thing.curve)
    radius = thing.radius_at(arc / arc[-1]) if isinstance(thing, Needle) else thing.radius_mm
    left, right = (visible(seen, eye, part, points, radius) for seen, eye in zip(sights, eyes, strict=True))
    return CentrelineTruth(points, arc, (left, right))


def _offsets(
    scenery: Arranged, strands: list[CentrelineTruth], seen: Sight, eye: Eye, side: int
) -> Float64[np.ndarray, "k"]:
    """Of all strands: how far each one's own mask lies from its projected centreline."""
    parts = [np.zeros(0)]
    for index, (strand, truth) in enumerate(zip(scenery.field.strands, strands, strict=True)):
        cover = coverage(seen.covers(f"{STRAND}{index}"), eye)
        parts.append(offset_from_truth(cover, eye, truth.points, truth.seen[side], strand.radius_mm))
    return np.concatenate(parts)


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
        "post": asdict(pair.arranged.effects),
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
