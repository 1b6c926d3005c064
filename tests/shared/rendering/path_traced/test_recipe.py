"""What a recipe asks for is in its field, before any light is traced."""

import functools
import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from agents.cli.lab.scenes import endoscope
from schemas.messages import RectifiedStereo
from shared.camera import project
from shared.rendering.path_traced import recipe
from shared.rendering.path_traced.eyes import rectified_rig
from shared.rendering.path_traced.lab_light import lab_light
from shared.rendering.path_traced.recipe import (
    CONFIGS,
    DISPARITY_SHARES,
    EXTRAS,
    MESHES,
    Recipe,
    UnarrangedError,
    _drawn_config,
    _drawn_extras,
    arranged,
)
from shared.rendering.path_traced.solids import silhouette
from shared.rendering.path_traced.splines import DYES, LAB_DYES, USUAL_DYES, sampled
from shared.rendering.path_traced.tracing import without_sparks
from shared.rendering.render import SceneError
from shared.rendering.surface import depth_at_points

RIG = endoscope(320, 180)
PLAIN = arranged(Recipe("easy", "chicken", 4), RIG)
BESIDE = rectified_rig(RectifiedStereo(320, 240, 325.0, 325.0, 159.5, 119.5, 45.0, 1e-3))


@functools.cache
def with_extra(extra):
    return arranged(Recipe("easy", "chicken", 4, (extra,)), RIG)


@pytest.mark.parametrize("extra", ["", *EXTRAS])
def test_each_extra_is_in_the_field_or_in_the_camera_and_nothing_else_is(extra):
    made = with_extra(extra) if extra else PLAIN
    stained = not np.array_equal(made.field.ground.albedo, PLAIN.field.ground.albedo)
    found = {
        "tools": len(made.field.tools) > 0,
        "stains": stained and extra != "tools",
        "smoke": made.effects.smoke >= (0.3 if extra else 1e-9),
        "blur": np.hypot(*made.effects.motion_px) >= (2.5 if extra else 1e-9),
        "interlaced": abs(made.effects.interlace_px) >= (1.0 if extra else 1e-9),
    }
    assert {name for name, is_there in found.items() if is_there} == {extra} - {""}


def test_stains_are_dark_smooth_fluid_on_a_part_of_the_ground_and_bystanding_tools_hide_little():
    clean, stained = PLAIN.field.ground, with_extra("stains").field.ground
    wet = np.any(clean.albedo != stained.albedo, axis=2)
    assert 0.0 < wet.mean() < 0.8
    assert stained.albedo[wet].mean() < clean.albedo[wet].mean()
    assert (stained.film >= clean.film).all()
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


def test_a_lab_has_light_and_dyes_of_its_own_and_only_who_asks_for_red_thread_gets_it():
    scene = arranged(Recipe("easy", "phantom", 4, distances_mm=(80.0, 81.0)), RIG)
    assert scene.field.lab_light is not None and not scene.field.lamps
    assert scene.field.strands[0].dye in LAB_DYES
    assert 80.0 <= scene.distance_mm <= 81.0
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


def test_a_rig_beside_the_field_stands_where_both_eyes_see_it():
    scene = arranged(Recipe("easy", "pad", 2), BESIDE)
    near, far = DISPARITY_SHARES
    assert far <= 325.0 * 45.0 / scene.distance_mm / 320.0 <= near
    assert scene.field.lab_light is not None and not scene.field.lab_light.beams
    for pixels in project(scene.field.camera, sampled(scene.field.strands[0].curve, 0.5)[0]):
        assert ((pixels > 0.0) & (pixels < (320.0, 240.0))).all()


@pytest.mark.slow
def test_eyes_that_share_no_field_or_none_that_a_thread_fits_into_are_told(monkeypatch):
    apart = rectified_rig(replace(BESIDE.near_enough, baseline=800.0))
    with pytest.raises(UnarrangedError, match="eyes 800 mm apart share no field within 1000 mm"):
        arranged(Recipe("easy", "pad", 2), apart)
    monkeypatch.setattr(recipe, "ATTEMPTS", 1)
    apart = rectified_rig(replace(endoscope(160, 90).near_enough, baseline=200.0))
    with pytest.raises(UnarrangedError, match="no easy scene of seed 1 fits into the images of this camera"):
        arranged(Recipe("easy", "paper", 1), apart)


@pytest.mark.slow
def test_a_seed_makes_the_same_scene_again_and_half_as_wide_a_camera_stands_twice_as_far_away():
    again, other = (arranged(Recipe("easy", "chicken", seed), RIG) for seed in (4, 5))
    (first,), (same,) = PLAIN.field.strands, again.field.strands
    np.testing.assert_array_equal(same.curve.control_points, first.curve.control_points)
    assert again.effects == PLAIN.effects != other.effects
    near = RIG.near_enough
    narrow = rectified_rig(replace(near, fx_px=2 * near.fx_px, fy_px=2 * near.fy_px))
    far, close = (arranged(Recipe("none", "chicken", 4), rig).distance_mm for rig in (narrow, RIG))
    assert far == pytest.approx(2 * close)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"config": "knot"}, "unknown configuration 'knot'; known: easy, medium"),
        ({"background": "wood"}, "unknown background 'wood'; known: chicken, paper"),
        ({"extras": ("fog",)}, "unknown extra 'fog'; known: tools"),
        ({"dye": "pink"}, "unknown thread 'pink'; known: violet"),
        ({"extras": (MESHES,)}, "need both"),
        ({"meshes": "somewhere"}, "need both"),
        ({"distances_mm": (90.0, 80.0)}, "--distance 90 80: give the nearest and the farthest"),
    ],
)
def test_what_nobody_knows_or_does_not_go_together_is_refused(changes, said):
    with pytest.raises(SceneError, match=said):
        Recipe(**({"config": "easy", "background": "pad", "seed": 1} | changes))


def test_a_scope_shines_from_beside_its_lens_and_a_room_is_dim_around_it():
    kinds = {"beams": 0, "disks": 0}
    for seed in range(12):
        light = lab_light(RIG.near_enough, 90.0, np.random.default_rng(seed))
        irradiance = np.zeros(3)
        kinds["beams"] += bool(light.beams)
        kinds["disks"] += bool(light.disks)
        for beam in light.beams:
            assert beam.full_deg < beam.black_deg
            assert np.linalg.norm(beam.place_mm) < 20.0
            irradiance += np.array(beam.intensity) / 90.0**2
        # each further lamp is half as bright
        for disk in light.disks[:1]:
            away = np.array(disk.place_mm) - (0.5 * RIG.baseline_mm, 0.0, 90.0)
            irradiance += np.array(disk.radiance) * np.pi * disk.radius_mm**2 / (away @ away)
        # a white card returns about as much as it gets: π in all
        assert irradiance[1] == pytest.approx(np.pi)
        assert light.room.min() >= 0.0 and light.room.mean() < 0.5
    assert min(kinds.values()) > 0


def test_a_lone_bright_pixel_goes_and_a_line_stays():
    image = np.full((9, 9, 3), 0.2, np.float32)
    image[2, 2] = 9.0
    image[6, 1:8] = 4.0
    clean = without_sparks(image)
    assert clean[2, 2].max() < 0.5
    np.testing.assert_array_equal(clean[6, 2:7], image[6, 2:7])
