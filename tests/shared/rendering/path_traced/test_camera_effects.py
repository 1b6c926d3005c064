"""What a camera does to traced light: each effect alone, on light that is known."""

from dataclasses import replace

import numpy as np
import pytest

from shared.rendering.path_traced.camera_effects import Effects, developed, gain_for, toned

PERFECT = Effects(blur_px=0.0, bloom=0.0, veil=0.0, vignette=0.0, shot_noise=0.0, read_noise=0.0, sharpening=0.0)
HEIGHT, WIDTH = 120, 960


def bars(axis):
    """Dark and bright bars, 40 px wide, across the rows (axis 1) or the columns."""
    index = np.indices((HEIGHT, WIDTH))[axis] // 40 % 2
    return np.repeat((0.05 + 0.4 * index.astype(np.float32))[..., None], 3, axis=2)


BARS = bars(1)
DARK = BARS[..., 0] < 0.1


def coloured(light, **effects):
    return developed(light, replace(PERFECT, **effects), 1.0, np.random.default_rng(0)).astype(float)


def seen(light, **effects):
    return coloured(light, **effects).mean(axis=2)


def steepest(axis, **effects):
    return np.abs(np.diff(seen(bars(axis), **effects), axis=axis)).max()


def flat(level):
    return np.full((HEIGHT, WIDTH, 3), level, np.float32)


def test_a_perfect_camera_shows_the_light_by_its_curve_alone():
    light = np.repeat(np.linspace(0.0, 2.0, WIDTH, dtype=np.float32)[None, :, None], 3, axis=2)
    value = light[0, :, 0] ** (1 / 2.2)
    curve = np.where(value > 0.8, 0.8 + 0.2 * np.tanh((value - 0.8) / 0.2), value)
    np.testing.assert_allclose(seen(light)[0], 255.0 * curve, atol=0.51)


@pytest.mark.parametrize(("motion_px", "softened", "kept"), [((6.0, 0.0), 1, 0), ((0.0, 6.0), 0, 1)])
def test_motion_smears_along_its_own_direction_alone(motion_px, softened, kept):
    assert steepest(softened, motion_px=motion_px) < 0.4 * steepest(softened)
    assert steepest(kept, motion_px=motion_px) == pytest.approx(steepest(kept), rel=0.02)


def test_defocus_softens_every_way_and_sharpening_makes_edges_steeper():
    for axis in (0, 1):
        assert steepest(axis, blur_px=3.0) < 0.6 * steepest(axis)
        assert steepest(axis, blur_px=1.0, sharpening=0.8) > 1.2 * steepest(axis, blur_px=1.0)


def test_of_an_interlaced_image_odd_rows_lie_further_right_by_as_much_as_was_asked():
    rows = seen(BARS, interlace_px=4.0)
    np.testing.assert_allclose(rows[0, :-8], rows[1, 4:-4], atol=1.0)
    np.testing.assert_array_equal(rows[0], rows[2])
    assert np.abs(rows[0] - rows[1]).max() > 60


def test_what_is_too_bright_glows_into_the_dark_beside_it_and_a_veil_or_smoke_lies_over_all():
    light = flat(0.02)
    light[50:70, 400:420] = 5.0
    glow = seen(light, bloom=0.05) - seen(light)
    assert glow[50:70, 424:428].mean() > 20
    assert np.abs(glow[:, :100]).max() <= 1
    clear, veiled, smoky = seen(BARS), seen(BARS, veil=0.3), seen(BARS, smoke=0.7)
    assert veiled[DARK].mean() > clear[DARK].mean() + 20
    assert veiled[~DARK].mean() < clear[~DARK].mean()
    assert np.ptp(smoky.mean(axis=0)) < np.ptp(clear.mean(axis=0))
    assert smoky[DARK].mean() > clear[DARK].mean() + 8
    assert np.std(smoky[DARK]) > 3, "wisps, and no even veil"


def test_corners_are_darker_by_the_vignette_and_white_balance_turns_the_colour():
    image = seen(flat(0.3), vignette=0.5)
    assert image[HEIGHT // 2, WIDTH // 2] == pytest.approx(seen(flat(0.3)).mean(), abs=1)
    corners = image[[0, 0, -1, -1], [0, -1, 0, -1]]
    np.testing.assert_allclose(corners, 255.0 * toned(np.full(4, 0.15, np.float32)), atol=1.5)
    blue, green, red = coloured(flat(0.3), white_balance=(1.2, 1.0, 0.8)).mean(axis=(0, 1))
    assert blue < green - 5 < green + 5 < red


def test_a_quality_is_that_of_jpeg_and_none_leaves_every_level():
    light = np.random.default_rng(1).uniform(0.0, 0.6, (HEIGHT, WIDTH, 3)).astype(np.float32)
    poor, good, all_of_it = (np.abs(coloured(light, jpeg_quality=q) - coloured(light)).mean() for q in (50, 95, 0))
    assert all_of_it == 0 < 1.0 < good < poor


def test_noise_is_read_noise_in_the_dark_and_grows_with_light_and_exposure_is_that_of_the_middle():
    slope = 1.0 / 2.2 * 0.4 ** (1.0 / 2.2 - 1.0) * 255.0
    assert np.std(coloured(flat(0.4), shot_noise=1e-3)) == pytest.approx(slope * np.sqrt(1e-3 * 0.4), rel=0.1)
    assert np.std(seen(flat(0.05))) == 0.0
    assert np.median(BARS) * gain_for(BARS, replace(PERFECT, exposure=0.3)) == pytest.approx(0.3)
