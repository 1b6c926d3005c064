"""What a recipe asks for is in its field, before any light is traced."""

import functools
import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from agents.cli.lab.scenes import endoscope
from shared.camera import project
from shared.scene.path_traced.eyes import rectified_rig
from shared.scene.path_traced.recipe import CONFIGS, EXTRAS, Recipe, _drawn_config, _drawn_extras, arranged
from shared.scene.path_traced.solids import silhouette
from shared.scene.path_traced.splines import sampled
from shared.scene.path_traced.strands import DYES, USUAL_DYES
from shared.scene.render import SceneError
from shared.scene.surface import depth_at_points

RIG = endoscope(320, 180)
PLAIN = arranged(Recipe("easy", "chicken", 4), RIG)


@functools.cache
def with_extra(extra):
    return arranged(Recipe("easy", "chicken", 4, (extra,)), RIG)


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
    u, v = np.rint(project(field.camera, sampled(field.strands[0].curve, 0.5)[0])[0]).astype(int).T
    assert np.mean(silhouette(field.camera, field.tools)[v, u] > 0) < 0.12


@pytest.mark.renders
@pytest.mark.parametrize(("seed", "ending"), [(8, "needle"), (2, "jaws"), (3, "stitch"), (9, "free")])
def test_a_thread_at_rest_comes_out_of_the_tissue_and_ends_at_what_holds_it(seed, ending):
    field = arranged(Recipe("rod", "chicken", seed), RIG).field
    (strand,) = field.strands
    points = sampled(strand.curve, 0.5)[0]
    above = depth_at_points(field.ground.surface, points[:, :2]) - points[:, 2]
    assert above[0] == pytest.approx(-0.8, abs=0.1)
    assert float(np.min(above[4:-4])) > -0.1
    needle = np.zeros((0, 3)) if field.needle is None else sampled(field.needle.curve, 0.2)[0]
    jaws = np.concatenate([np.zeros((0, 3)), *(tool.vertices for tool in field.tools)])
    held_by = {
        "needle": bool((np.linalg.norm(needle - points[-1], axis=1) < 0.05).any()),
        "jaws": bool((np.linalg.norm(jaws - points[-1], axis=1) < 1.0).any()),
        "stitch": above[-1] < -0.5,
    }
    assert {what for what, holds in held_by.items() if holds} == {ending} - {"free"}


def test_several_threads_pass_through_none_of_each_other():
    strands = arranged(Recipe("several", "chicken", 18), RIG).field.strands
    assert len(strands) == 3
    for one, other in itertools.combinations(strands, 2):
        apart, _ = cKDTree(sampled(one.curve, 0.1)[0]).query(sampled(other.curve, 0.1)[0])
        assert np.min(apart) > one.radius_mm + other.radius_mm


def test_only_who_asks_for_red_thread_gets_it():
    assert "red" not in USUAL_DYES
    assert set(USUAL_DYES) < set(DYES)
    (strand,) = arranged(Recipe("easy", "paper", 4, dye="red"), RIG).field.strands
    assert strand.dye == "red"


def test_what_is_varied_for_training_has_a_third_without_thread_and_all_extras_now_and_then():
    made = [_drawn_config(np.random.default_rng(seed)) for seed in range(300)]
    assert made.count("none") / 300 == pytest.approx(1 / 3, abs=0.08)
    assert set(made) == set(CONFIGS)
    drawn = [_drawn_extras(np.random.default_rng(seed), "easy") for seed in range(300)]
    assert {extra for extras in drawn for extra in extras} == set(EXTRAS)
    assert () in drawn


@pytest.mark.slow
def test_a_camera_that_sees_half_as_wide_stands_twice_as_far_away():
    near = RIG.near_enough
    narrow = rectified_rig(replace(near, fx_px=2 * near.fx_px, fy_px=2 * near.fy_px))
    far = arranged(Recipe("none", "chicken", 4), narrow).distance_mm
    assert far == pytest.approx(2 * arranged(Recipe("none", "chicken", 4), RIG).distance_mm)


@pytest.mark.slow
def test_a_seed_makes_the_same_scene_again_and_another_one_another():
    again, other = (arranged(Recipe("easy", "chicken", seed), RIG) for seed in (4, 5))
    np.testing.assert_array_equal(
        again.field.strands[0].curve.control_points, PLAIN.field.strands[0].curve.control_points
    )
    assert again.effects == PLAIN.effects != other.effects


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
