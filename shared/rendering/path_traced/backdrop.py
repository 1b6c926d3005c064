"""A path-traced field without thread, as the light renderer takes it.

Blur and noise are left to the sensor, which adds them when a frame is exposed, to field and thread alike.
"""

from dataclasses import replace

import numpy as np

from shared.rendering.backdrop_files import Backdrop, Light, SceneError
from shared.rendering.path_traced.camera_effects import developed, gain_for
from shared.rendering.path_traced.eyes import Rig
from shared.rendering.path_traced.field import Lamp
from shared.rendering.path_traced.recipe import LAB_BACKGROUNDS, Recipe, arranged
from shared.rendering.path_traced.tracing import traced_light
from shared.rendering.path_traced.world import build
from shared.rendering.surface import Surface, meet_rays, ray_tangents

STRIDE, LAMPS = 4, 2


def traced_backdrop(background: str, seed: int, rig: Rig, samples: int) -> Backdrop:
    """The field of a seed in both eyes.

    Raises:
        SceneError: for an unknown background, or a camera that is not rectified.
    """
    if not rig.is_rectified:
        raise SceneError("a backdrop is for a rectified camera; leave out --calibration or give a rectified one")
    if background in LAB_BACKGROUNDS:
        raise SceneError(f"the light renderer knows no light of a lab, so there is no backdrop of a {background}")
    scenery = arranged(Recipe("none", background, seed), rig)
    effects = replace(scenery.effects, blur_px=0.0, sharpening=0.0, read_noise=0.0, shot_noise=0.0, jpeg_quality=0)
    scene = build(scenery.field)
    lights = [traced_light(scene, scenery.field.lamps, eye, samples, 2 * seed + k) for k, eye in enumerate(rig.eyes)]
    gain = gain_for(lights[0], effects)
    left, right = (developed(light, effects, gain, np.random.default_rng(seed)) for light in lights)
    surface = scenery.field.ground.surface
    coarse = Surface(surface.depth_mm[::STRIDE, ::STRIDE], surface.x0_mm, surface.y0_mm, STRIDE * surface.step_mm)
    p, q = ray_tangents(rig.near_enough)
    depths = [meet_rays(coarse, p, q, eye_x_mm) for eye_x_mm in (0.0, rig.baseline_mm)]
    return Backdrop(coarse, left, right, depths[0], depths[1], True, _beside_the_lens(scenery.field.lamps))


def _beside_the_lens(lamps: list[Lamp]) -> tuple[Light, ...]:
    """The lamps that cast shadows to be seen; the faint one from aside is left out."""
    strongest = sorted(lamps, key=lambda lamp: lamp.intensity[1])[-LAMPS:]
    total = sum(lamp.intensity[1] for lamp in strongest)
    return tuple(Light(lamp.place_mm, lamp.intensity[1] / total) for lamp in strongest)
