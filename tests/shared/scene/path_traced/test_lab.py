"""Scenes of a lab: light, dyes, instruments that hold something, and rigs whose eyes are far apart."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from schemas.messages import RectifiedStereo
from shared.camera import project
from shared.scene.path_traced import recipe
from shared.scene.path_traced.eyes import rectified_rig
from shared.scene.path_traced.holding import holding_needle, holding_thread
from shared.scene.path_traced.lab_light import lab_light
from shared.scene.path_traced.meshes import driver_parts
from shared.scene.path_traced.placing import above_ground
from shared.scene.path_traced.recipe import DISPARITY_SHARES, MESHES, Recipe, UnarrangedError, arranged
from shared.scene.path_traced.splines import sampled
from shared.scene.path_traced.strands import LAB_DYES
from shared.scene.path_traced.tracing import without_sparks
from shared.scene.render import SceneError

FOLDER = Path("../shared/data/instruments")
needs_meshes = pytest.mark.skipif(not FOLDER.exists(), reason=f"needs {FOLDER}")
RIG = endoscope(320, 180)
BESIDE = rectified_rig(RectifiedStereo(320, 240, 325.0, 325.0, 159.5, 119.5, 45.0, 1e-3))


def test_a_lab_has_light_and_dyes_of_its_own_and_the_distance_that_was_asked_for():
    scene = arranged(Recipe("easy", "phantom", 4, distances_mm=(80.0, 81.0)), RIG)
    assert scene.field.lab_light is not None and not scene.field.lamps
    assert scene.field.strands[0].dye in LAB_DYES
    assert 80.0 <= scene.distance_mm <= 81.0


def test_a_rig_beside_the_field_stands_where_both_eyes_see_it():
    scene = arranged(Recipe("easy", "pad", 2), BESIDE)
    near, far = DISPARITY_SHARES
    share = 325.0 * 45.0 / scene.distance_mm / 320.0
    assert far <= share <= near
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


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"extras": (MESHES,)}, "need both"),
        ({"meshes": "somewhere"}, "need both"),
        ({"distances_mm": (90.0, 80.0)}, "--distance 90 80: give the nearest and the farthest"),
    ],
)
def test_what_does_not_go_together_is_refused(options, said):
    with pytest.raises(SceneError, match=said):
        Recipe("easy", "pad", 1, **options)


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
        for number, disk in enumerate(light.disks):
            away = np.array(disk.place_mm) - (0.5 * RIG.baseline_mm, 0.0, 90.0)
            # each further lamp is half as bright
            one = np.array(disk.radiance) * np.pi * disk.radius_mm**2 / (away @ away)
            irradiance += one * (number == 0)
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


def first_held(hold, field):
    """The field with an instrument that holds something, by the first seed that finds a place for it."""
    held = (hold(field, driver_parts(FOLDER), np.random.default_rng(seed)) for seed in range(6))
    return next(found for found in held if found.tools)


@pytest.mark.slow
@needs_meshes
def test_a_needle_is_held_between_jaws_above_the_ground():
    field = arranged(Recipe("needle", "phantom", 1), RIG).field
    held = first_held(holding_needle, field)
    assert above_ground(held.tools, field)
    needle = field.needle
    assert needle is not None
    assert gap(held.tools, sampled(needle.curve, 0.1)[0]) < needle.radius_mm + 0.4


@pytest.mark.slow
@needs_meshes
def test_the_end_of_a_thread_is_held_where_it_is_in_the_air():
    field = arranged(Recipe("easy", "phantom", 4), RIG).field
    (strand,) = field.strands
    near = replace(strand.curve, control_points=strand.curve.control_points - (0.0, 0.0, 12.0))
    field = replace(field, strands=[replace(strand, curve=near)])
    held = first_held(holding_thread, field)
    assert gap(held.tools, near.at(np.array([float(near.spans)]))) < 2.0


def gap(tools, points):
    corners = np.vstack([tool.vertices for tool in tools if not tool.is_lofted])
    return min(float(np.linalg.norm(corners - point, axis=1).min()) for point in points)
