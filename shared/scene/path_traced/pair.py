"""One stereo pair from its recipe: traced, labelled, checked against its own truth, and seen by a camera."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from shared.scene.path_traced.camera_effects import developed, gain_by_middle, gain_for
from shared.scene.path_traced.eyes import Eye, Rig
from shared.scene.path_traced.own_check import offset_from_truth
from shared.scene.path_traced.recipe import Arranged, Recipe, arranged
from shared.scene.path_traced.splines import sampled
from shared.scene.path_traced.tracing import Sight, coverage, sight, traced_lab_light, traced_light, visible
from shared.scene.path_traced.world import NEEDLE, STRAND, TOOL, build

TURN_SEEDS = 1_000_003
"""From one turn of a recipe to the next: farther than batches reach."""


@dataclass(frozen=True)
class StrandTruth:
    """Points of a centreline in mm, arc lengths in mm, and whether the left and the right eye see them."""

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
    """A pair with all that is known about it; `offsets_px` is how far the mask lies from the truth, left and right."""

    recipe: Recipe
    rig: Rig
    arranged: Arranged
    images: tuple[EyeImages, EyeImages]
    strands: list[StrandTruth]
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
    strands = [_truth(scenery, index, sights, eyes) for index in range(len(scenery.field.strands))]
    offsets = [_offsets(scenery, strands, seen, eye, k) for k, (seen, eye) in enumerate(zip(sights, eyes, strict=True))]
    return TracedPair(recipe, rig, scenery, (images[0], images[1]), strands, (offsets[0], offsets[1]), samples)


def _images(bgr: UInt8[np.ndarray, "h w 3"], seen: Sight, eye: Eye) -> EyeImages:
    return EyeImages(bgr, *(coverage(seen.covers(kind), eye) for kind in (STRAND, TOOL, NEEDLE)))


def _truth(scenery: Arranged, index: int, sights: list[Sight], eyes: tuple[Eye, Eye]) -> StrandTruth:
    strand = scenery.field.strands[index]
    points, arc = sampled(strand.curve)
    left, right = (
        visible(seen, eye, f"{STRAND}{index}", points, strand.radius_mm) for seen, eye in zip(sights, eyes, strict=True)
    )
    return StrandTruth(points, arc, (left, right))


def _offsets(
    scenery: Arranged, strands: list[StrandTruth], seen: Sight, eye: Eye, side: int
) -> Float64[np.ndarray, "k"]:
    """Of all strands: how far each one's own mask lies from its projected centreline."""
    parts = [np.zeros(0)]
    for index, (strand, truth) in enumerate(zip(scenery.field.strands, strands, strict=True)):
        cover = coverage(seen.covers(f"{STRAND}{index}"), eye)
        parts.append(offset_from_truth(cover, eye, truth.points, truth.seen[side], strand.radius_mm))
    return np.concatenate(parts)
