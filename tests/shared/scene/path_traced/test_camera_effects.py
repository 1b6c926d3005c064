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
    light = bars(1)
    expected = np.rint(255.0 * toned(light)).mean(axis=2)
    np.testing.assert_allclose(seen(light), expected, atol=0.51)


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
