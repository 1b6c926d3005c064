"""What a camera does to traced light: each effect alone, on light that is known."""

from dataclasses import replace

import numpy as np
import pytest

from shared.scene.path_traced.camera_effects import Effects, developed, gain_for, toned

PERFECT = Effects(blur_px=0.0, bloom=0.0, veil=0.0, vignette=0.0, shot_noise=0.0, read_noise=0.0, sharpening=0.0)
HEIGHT, WIDTH = 120, 960


def bars(axis):
    """Dark and bright bars, 40 px wide, across the rows (axis 1) or the columns."""
    index = np.indices((HEIGHT, WIDTH))[axis] // 40 % 2
    return np.repeat((0.05 + 0.4 * index.astype(np.float32))[..., None], 3, axis=2)


def seen(light, **effects):
    return developed(light, replace(PERFECT, **effects), 1.0, np.random.default_rng(0)).astype(float).mean(axis=2)


def steepest(image, axis):
    return np.abs(np.diff(image, axis=axis)).max()


def test_a_perfect_camera_shows_the_light_by_its_curve_alone():
    light = np.repeat(np.linspace(0.0, 2.0, WIDTH, dtype=np.float32)[None, :, None], 3, axis=2)
    value = light[0, :, 0] ** (1 / 2.2)
    curve = np.where(value > 0.8, 0.8 + 0.2 * np.tanh((value - 0.8) / 0.2), value)
    np.testing.assert_allclose(seen(light)[0], 255.0 * curve, atol=0.51)


@pytest.mark.parametrize(("motion_px", "softened", "kept"), [((6.0, 0.0), 1, 0), ((0.0, 6.0), 0, 1)])
def test_motion_smears_along_its_own_direction_alone(motion_px, softened, kept):
    still, moved = (
        {axis: steepest(seen(bars(axis), motion_px=motion), axis) for axis in (0, 1)}
        for motion in ((0.0, 0.0), motion_px)
    )
    assert moved[softened] < 0.4 * still[softened]
    assert moved[kept] == pytest.approx(still[kept], rel=0.02)


def test_of_an_interlaced_image_odd_rows_lie_further_right_by_as_much_as_was_asked():
    rows = seen(bars(1), interlace_px=4.0)
    np.testing.assert_allclose(rows[0, :-8], rows[1, 4:-4], atol=1.0)
    np.testing.assert_array_equal(rows[0], rows[2])
    assert np.abs(rows[0] - rows[1]).max() > 60


def coloured(light, **effects):
    return developed(light, replace(PERFECT, **effects), 1.0, np.random.default_rng(0)).astype(float)


def test_defocus_softens_every_way_and_sharpening_makes_edges_steeper():
    for axis in (0, 1):
        plain = steepest(seen(bars(axis)), axis)
        assert steepest(seen(bars(axis), blur_px=3.0), axis) < 0.6 * plain
        assert steepest(seen(bars(axis), blur_px=1.0, sharpening=0.8), axis) > 1.2 * steepest(
            seen(bars(axis), blur_px=1.0), axis
        )


def test_what_is_too_bright_glows_into_the_dark_beside_it_and_a_veil_lies_over_all():
    light = np.full((HEIGHT, WIDTH, 3), 0.02, np.float32)
    light[50:70, 400:420] = 5.0
    beside = np.s_[50:70, 424:428]
    assert seen(light, bloom=0.05)[beside].mean() > seen(light)[beside].mean() + 20
    assert np.abs(seen(light, bloom=0.05) - seen(light))[:, :100].max() <= 1
    veiled, clear = seen(bars(1), veil=0.3), seen(bars(1))
    dark = bars(1)[..., 0] < 0.1
    assert veiled[dark].mean() > clear[dark].mean() + 20
    assert veiled[~dark].mean() < clear[~dark].mean()


def test_corners_are_darker_by_the_vignette_and_white_balance_turns_the_colour():
    flat = np.full((HEIGHT, WIDTH, 3), 0.3, np.float32)
    corners = seen(flat, vignette=0.5)[[0, 0, -1, -1], [0, -1, 0, -1]]
    middle = seen(flat, vignette=0.5)[HEIGHT // 2, WIDTH // 2]
    assert middle == pytest.approx(seen(flat).mean(), abs=1)
    np.testing.assert_allclose(corners, 255.0 * toned(np.full(4, 0.15, np.float32)), atol=1.5)
    blue, green, red = coloured(flat, white_balance=(1.2, 1.0, 0.8)).mean(axis=(0, 1))
    assert blue < green - 5 < green + 5 < red


def test_a_quality_is_that_of_jpeg_and_none_leaves_every_level():
    light = np.random.default_rng(1).uniform(0.0, 0.6, (HEIGHT, WIDTH, 3)).astype(np.float32)
    plain = coloured(light)
    np.testing.assert_array_equal(plain, coloured(light, jpeg_quality=0))
    poor, good = (np.abs(coloured(light, jpeg_quality=quality) - plain).mean() for quality in (50, 95))
    assert 1.0 < good < poor


def test_smoke_takes_contrast_away_and_lightens_what_is_dark():
    clear, smoky = seen(bars(1)), seen(bars(1), smoke=0.7)
    dark = bars(1)[..., 0] < 0.1
    assert np.ptp(smoky.mean(axis=0)) < np.ptp(clear.mean(axis=0))
    assert smoky[dark].mean() > clear[dark].mean() + 8
    assert np.std(smoky[dark]) > 3, "wisps, and no even veil"


def test_noise_is_read_noise_in_the_dark_and_grows_with_light():
    dark, bright = np.full((HEIGHT, WIDTH, 3), 0.05, np.float32), np.full((HEIGHT, WIDTH, 3), 0.4, np.float32)
    gain = 1.0 / 2.2 * 0.4 ** (1.0 / 2.2 - 1.0) * 255.0
    noise = np.std(developed(bright, replace(PERFECT, shot_noise=1e-3), 1.0, np.random.default_rng(1)).astype(float))
    assert noise == pytest.approx(gain * np.sqrt(1e-3 * 0.4), rel=0.1)
    assert np.std(seen(dark)) == 0.0


def test_the_exposure_that_was_asked_for_is_that_of_the_middle_of_the_light():
    light = bars(1)
    assert np.median(light) * gain_for(light, replace(PERFECT, exposure=0.3)) == pytest.approx(0.3)
