"""What a scene is asked to be, and its field drawn accordingly; the same recipe makes the same scene."""

from dataclasses import dataclass, replace

import numpy as np

from schemas.messages import RectifiedStereo
from shared.rendering.path_traced.camera_effects import Effects, drawn_effects
from shared.rendering.path_traced.eyes import Rig
from shared.rendering.path_traced.field import Field, Lamp
from shared.rendering.path_traced.flesh import flesh_ground, stained
from shared.rendering.path_traced.holding import driver_maker, holding_needle, holding_thread
from shared.rendering.path_traced.lab_light import lab_light
from shared.rendering.path_traced.meshes import driver_parts
from shared.rendering.path_traced.pad import pad_ground, phantom_ground
from shared.rendering.path_traced.paper import paper_ground
from shared.rendering.path_traced.placing import (
    NEAR_TIPS_MM,
    bystanders,
    drawn_instrument,
    needle_on,
    occluders,
    with_ending,
)
from shared.rendering.path_traced.rod import pinned_strand
from shared.rendering.path_traced.solids import Solid
from shared.rendering.path_traced.splines import DYES, LAB_DYES, USUAL_DYES, drawn_strand, laid_over, sampled
from shared.rendering.render import SceneError
from shared.rendering.thread_shapes import ShapeError

CONFIGS = (
    "easy",
    "medium",
    "hard",
    "singularity",
    "occlusion",
    "crossing",
    "several",
    "needle",
    "rod",
    "none",
)
BACKGROUNDS = {"chicken": flesh_ground, "paper": paper_ground, "pad": pad_ground, "phantom": phantom_ground}
"""Those of a lab come last: a background's number is part of its scenes' seeds."""
LAB_BACKGROUNDS = ("pad", "phantom")
EXTRAS = ("tools", "stains", "smoke", "blur", "interlaced")
MESHES = "meshes"
"""The extra that no scene has unless it is asked for, since it needs files."""
VARIED = "varied"
DISTANCES_MM = (72.0, 112.0)
WIDE_BASELINE_MM = 12.0
DISPARITY_SHARES = (0.38, 0.15)
"""Of the width, where eyes are farther apart than an endoscope's: nearer, and they share too little of the field."""
HOLDS_NEEDLE = 0.6
FARTHEST_MM = 1000.0
REACH_MM = 95.0
USUAL_FOCAL_WIDTHS = 1000.0 / 960.0
INSIDE_SHARE, LEAST_SHARE = 0.97, 0.5
SHAPES = ("easy", "medium", "hard", "singularity", "crossing")
ATTEMPTS = 12


class UnarrangedError(SceneError):
    """A recipe whose threads find no place before a camera; others of the same batch may."""


@dataclass(frozen=True)
class Recipe:
    """A configuration (or `varied`), a background, what is added to it, the dye where it is not drawn, and the seed.

    Fields:
        meshes: the folder of the needle driver's *.dae, for the extra `meshes`.
        distances_mm: from nearest to farthest, where they do not follow from the rig.
    """

    config: str
    background: str
    seed: int
    extras: tuple[str, ...] = ()
    dye: str | None = None
    meshes: str | None = None
    distances_mm: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        _known("configuration", (self.config,), (*CONFIGS, VARIED))
        _known("background", (self.background,), tuple(BACKGROUNDS))
        _known("extra", self.extras, (*EXTRAS, MESHES))
        if self.dye is not None:
            _known("thread", (self.dye,), tuple(DYES))
        if (MESHES in self.extras) != (self.meshes is not None):
            raise SceneError(
                "instruments from meshes need both: --with meshes, and --meshes with the folder of their *.dae"
            )
        if self.distances_mm is not None and not 0.0 < self.distances_mm[0] <= self.distances_mm[1] < FARTHEST_MM:
            near, far = self.distances_mm
            raise SceneError(
                f"--distance {near:g} {far:g}: give the nearest and the farthest, up to {FARTHEST_MM:g} mm"
            )

    @property
    def is_of_lab(self) -> bool:
        """Whether it has a lab's light, dyes and instruments."""
        return self.background in LAB_BACKGROUNDS or MESHES in self.extras


@dataclass(frozen=True)
class Arranged:
    """A field, the camera's effects, and which configuration and extras it came to."""

    field: Field
    effects: Effects
    config: str
    extras: tuple[str, ...]
    distance_mm: float


def arranged(recipe: Recipe, rig: Rig) -> Arranged:
    """The field of a recipe.

    Raises:
        UnarrangedError: where the camera sees too little for its threads.
    """
    # the shape's own seed differs by background, so that a scene on paper is not one on flesh with another picture
    place = list(BACKGROUNDS).index(recipe.background), (*CONFIGS, VARIED).index(recipe.config)
    rng = np.random.default_rng([recipe.seed, 7, *place])
    wide = recipe.config == VARIED
    config = _drawn_config(rng) if wide else recipe.config
    extras = (*_drawn_extras(rng, config), *((MESHES,) if MESHES in recipe.extras else ())) if wide else recipe.extras
    parts = driver_parts(recipe.meshes) if recipe.meshes is not None else None
    camera = rig.near_enough
    # as much of the field as the published renders show
    nearness = camera.fx_px / camera.image_width / USUAL_FOCAL_WIDTHS
    problem: ShapeError | None = None
    for _ in range(ATTEMPTS):
        distance = _distance(recipe, camera, rng) or float(rng.uniform(*DISTANCES_MM)) * nearness
        ground = BACKGROUNDS[recipe.background](rig.widest, distance, rng)
        field = Field(camera, ground, [])
        if recipe.is_of_lab:
            field = replace(field, lab_light=lab_light(camera, distance, rng))
        else:
            field = replace(field, lamps=_lamps(camera, rng, wide))
        try:
            field = _laid(field, config, rng, recipe.dye, wide, parts)
        except ShapeError as error:
            problem = error
            continue
        field = None if field is None else _with_tools(field, config, extras, rng, parts)
        if field is None or not _both_see(rig, field, LEAST_SHARE if wide else INSIDE_SHARE):
            continue
        if "stains" in extras:
            field = replace(field, ground=stained(field.ground, rng))
        return Arranged(field, _effects(rng, wide, extras), config, extras, distance)
    raise UnarrangedError(
        f"no {config} scene of seed {recipe.seed} fits into the images of this camera"
        f"{f': {problem}' if problem else ''}; use another seed or a wider view"
    )


def _distance(recipe: Recipe, camera: RectifiedStereo, rng: np.random.Generator) -> float | None:
    """Of the field in mm, where it was asked for or a lab's eyes are far apart; None where it is as an endoscope's."""
    if recipe.distances_mm is not None:
        return float(rng.uniform(*recipe.distances_mm))
    if camera.baseline < WIDE_BASELINE_MM or not recipe.is_of_lab:
        return None
    near, far = (camera.fx_px * camera.baseline / (share * camera.image_width) for share in DISPARITY_SHARES)
    if near > FARTHEST_MM:
        raise UnarrangedError(f"eyes {camera.baseline:.0f} mm apart share no field within {FARTHEST_MM:g} mm")
    return float(rng.uniform(near, min(far, FARTHEST_MM)))


def _both_see(rig: Rig, field: Field, share: float) -> bool:
    """Whether the eyes as they are show so much of each thread, hidden or not."""
    for strand in field.strands:
        points, _ = sampled(strand.curve, 0.5)
        for eye in rig.eyes:
            pixels = eye.project(points)
            inside = ((pixels > 1.0) & (pixels < (eye.width - 2.0, eye.height - 2.0))).all(axis=1)
            if inside.mean() < share:
                return False
    return True


def _known(what: str, chosen: tuple[str, ...], known: tuple[str, ...]) -> None:
    for name in chosen:
        if name not in known:
            raise SceneError(f"unknown {what} {name!r}; known: {', '.join(known)}")


def _drawn_config(rng: np.random.Generator) -> str:
    shares = {
        "easy": 9,
        "medium": 9,
        "hard": 9,
        "singularity": 5,
        "occlusion": 8,
        "crossing": 10,
        "several": 9,
        "needle": 8,
        "rod": 24,
    }
    odds = np.array([*shares.values(), 0.5 * sum(shares.values())])
    return str(rng.choice([*shares, "none"], p=odds / (1.5 * sum(shares.values()))))


def _drawn_extras(rng: np.random.Generator, config: str) -> tuple[str, ...]:
    odds = {"tools": 0.65 if config == "none" else 0.4, "stains": 0.35, "smoke": 0.12, "blur": 0.12, "interlaced": 0.05}
    return tuple(name for name, share in odds.items() if rng.uniform() < share)


def _laid(
    field: Field,
    config: str,
    rng: np.random.Generator,
    dye: str | None,
    wide: bool,
    parts: dict[str, Solid] | None,
) -> Field | None:
    """The field with its threads, and what holds them; None where what holds them found no place."""
    if config == "none":
        return field
    kinds = {"occlusion": ("easy", "medium"), "needle": ("easy", "medium"), "several": (*SHAPES[:3], "rod")}
    choices = kinds.get(config, (config,))
    count = int(rng.integers(2, 4)) if config == "several" else 1
    dyes = USUAL_DYES if field.lab_light is None else LAB_DYES
    bed = field.ground.bed
    for _ in range(count):
        # 3 to 7 px across at 960 wide, and where it is not for training, what sutures of 3-0 to 5-0 have
        thickest = 0.25 if field.lab_light is None else 0.3
        radius = float(rng.uniform(0.14, 0.33) if wide else rng.uniform(0.15, thickest))
        of_dye = dye or str(rng.choice(dyes))
        shape = str(rng.choice(choices))
        if shape == "rod":
            share = float(rng.choice((1.0, 0.55))) if wide else 1.0
            pinned = pinned_strand(field.camera, bed, rng, radius, of_dye, share)
            field = replace(field, strands=[*field.strands, laid_over(pinned.strand, field.strands)])
            if parts is not None and pinned.ending == "gripper":
                field = holding_thread(field, parts, rng)
            else:
                field = with_ending(field, pinned, rng)
            continue
        seed = int(rng.integers(2**31))
        one = drawn_strand(field.camera, bed, shape, seed, radius, of_dye)
        field = replace(field, strands=[*field.strands, laid_over(one, field.strands)])
    if config != "needle":
        return field
    needle = needle_on(field, rng)
    return None if needle is None else replace(field, needle=needle)


def _lamps(camera: RectifiedStereo, rng: np.random.Generator, wide: bool) -> list[Lamp]:
    """Two beside the lens, unlike each other by a little, and a faint one from aside for what the walls reflect."""
    apart, below = rng.uniform(5.0, 16.0), rng.uniform(-3.0, 4.0)
    balance = float(np.clip(rng.normal(1.0, 0.3 if wide else 0.1), 0.3, 1.7))
    warmth = float(np.clip(rng.normal(1.0, 0.06 if wide else 0.02), 0.8, 1.2))
    middle = 0.5 * camera.baseline
    aside = rng.choice((-1.0, 1.0), 2) * rng.uniform(15.0, 45.0, 2)
    places = (
        (middle - 0.5 * apart, below, 0.0, 0.5 * (2.0 - balance)),
        (middle + 0.5 * apart, below, 0.0, 0.5 * balance),
        (middle + aside[0], aside[1], -20.0, rng.uniform(0.04, 0.25)),
    )
    lamps: list[Lamp] = []
    for x, y, z, share in places:
        strength = float(share * np.pi * REACH_MM**2)
        lamps.append(Lamp((float(x), float(y), z), (warmth * strength, strength, (2.0 - warmth) * strength)))
    return lamps


def _with_tools(
    field: Field, config: str, extras: tuple[str, ...], rng: np.random.Generator, parts: dict[str, Solid] | None
) -> Field | None:
    """The field with instruments, or None where one that is to hide the thread found no place."""
    made = drawn_instrument if parts is None else driver_maker(parts)
    if parts is not None and field.needle is not None and rng.uniform() < HOLDS_NEEDLE:
        field = holding_needle(field, parts, rng)
    if config == "occlusion":
        hiding = occluders(field, rng, made)
        if not hiding:
            return None
        field = replace(field, tools=[*field.tools, *hiding])
    if parts is not None:
        count = int(rng.integers(0 if field.tools else 1, 3))
        field = replace(field, tools=[*field.tools, *bystanders(field, rng, count, NEAR_TIPS_MM, made)])
    if "tools" in extras:
        field = replace(field, tools=[*field.tools, *bystanders(field, rng, int(rng.integers(1, 3)), NEAR_TIPS_MM)])
    return field


def _effects(rng: np.random.Generator, wide: bool, extras: tuple[str, ...]) -> Effects:
    effects = drawn_effects(rng, wide)
    if "smoke" in extras:
        effects = replace(effects, smoke=float(rng.uniform(0.3, 0.75)))
    if "blur" in extras:
        length, angle = rng.uniform(2.5, 7.0), rng.uniform(0.0, np.pi)
        effects = replace(effects, motion_px=(float(length * np.cos(angle)), float(length * np.sin(angle))))
    if "interlaced" in extras:
        effects = replace(effects, interlace_px=float(rng.choice((-1.0, 1.0)) * rng.uniform(1.0, 4.0)))
    return effects
