"""What a recipe asks for is in its field, before any light is traced."""

import functools

import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.camera import project
from shared.scene.path_traced.recipe import EXTRAS, Recipe, arranged
from shared.scene.path_traced.solids import silhouette
from shared.scene.path_traced.splines import sampled
from shared.scene.render import SceneError

RIG = endoscope(320, 180)
PLAIN = arranged(Recipe("easy", "chicken", 4), RIG)


@functools.cache
def with_extra(extra):
    return arranged(Recipe("easy", "chicken", 4, (extra,)), RIG)


def test_instruments_hide_thirty_percent_of_the_thread_or_more_from_both_eyes():
    field = arranged(Recipe("occlusion", "chicken", 1), RIG).field
    points = sampled(field.strands[0].curve, 0.5)[0]
    for pixels, along in zip(project(field.camera, points), (0.0, field.camera.baseline), strict=True):
        u, v = np.rint(pixels).astype(int).T
        assert 0.30 <= np.mean(silhouette(field.camera, field.tools, along)[v, u] > 0) <= 0.51


def test_without_extras_nothing_is_wrong_with_the_view():
    effects = PLAIN.effects
    assert (PLAIN.field.tools, effects.smoke, effects.motion_px, effects.interlace_px) == ([], 0.0, (0.0, 0.0), 0.0)


@pytest.mark.parametrize("extra", EXTRAS)
def test_each_extra_is_in_the_field_or_in_the_camera_and_nothing_else_is(extra):
    made = with_extra(extra)
    stained = not np.array_equal(made.field.ground.albedo, PLAIN.field.ground.albedo)
    found = {
        "tools": len(made.field.tools) > 0,
        "stains": stained and extra != "tools",
        "smoke": made.effects.smoke >= 0.3,
        "blur": np.hypot(*made.effects.motion_px) >= 2.5,
        "interlaced": abs(made.effects.interlace_px) >= 1.0,
    }
    assert {name for name, is_there in found.items() if is_there} == {extra}


def test_stains_are_dark_smooth_fluid_on_a_part_of_the_ground():
    clean, stained = PLAIN.field.ground, with_extra("stains").field.ground
    wet = np.any(clean.albedo != stained.albedo, axis=2)
    assert 0.0 < wet.mean() < 0.8
    assert stained.albedo[wet].mean() < clean.albedo[wet].mean()
    assert (stained.film >= clean.film).all()


def test_tools_that_stand_by_hide_little_of_the_thread():
    field = with_extra("tools").field
    pixels = project(field.camera, sampled(field.strands[0].curve, 0.5)[0])[0]
    u, v = np.rint(pixels).astype(int).T
    assert np.mean(silhouette(field.camera, field.tools)[v, u] > 0) < 0.12


def test_a_seed_makes_the_same_scene_again_and_another_one_another():
    again, other = (arranged(Recipe("easy", "chicken", seed), RIG) for seed in (4, 5))
    np.testing.assert_array_equal(
        again.field.strands[0].curve.control_points, PLAIN.field.strands[0].curve.control_points
    )
    assert again.effects == PLAIN.effects != other.effects


def test_the_dye_is_the_one_that_was_asked_for():
    (strand,) = arranged(Recipe("easy", "paper", 4, dye="undyed"), RIG).field.strands
    assert strand.dye == "undyed"


@pytest.mark.parametrize(
    ("recipe", "said"),
    [
        (("knot", "chicken", 1), "unknown configuration 'knot'; known: easy, medium"),
        (("easy", "wood", 1), "unknown background 'wood'; known: chicken, paper"),
        (("easy", "paper", 1, ("fog",)), "unknown extra 'fog'; known: tools"),
        (("easy", "paper", 1, (), "pink"), "unknown thread 'pink'; known: violet"),
    ],
)
def test_what_nobody_knows_is_refused_with_what_is_known(recipe, said):
    with pytest.raises(SceneError, match=said):
        Recipe(*recipe)
