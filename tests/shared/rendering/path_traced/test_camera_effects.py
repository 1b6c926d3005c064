"""What a camera does to traced light: each effect alone, on light that is known."""

from dataclasses import replace

import numpy as np
import pytest

from shared.rendering.path_traced.camera_effects import Effects, developed, gain_for

PERFECT = Effects(blur_px=0.0, bloom=0.0, veil=0.0, vignette=0.0, shot_noise=0.0, read_noise=0.0, sharpening=0.0)
HEIGHT, WIDTH = 120, 960


def bars(axis):
    """Dark and bright bars, 40 px wide, across the rows (axis 1) or the columns."""
    index = np.indices((HEIGHT, WIDTH))[axis] // 40 % 2
    return np.repeat((0.05 + 0.4 * index.astype(np.float32))[..., None], 3, axis=2)


BARS = bars(1)


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


def test_noise_is_read_noise_in_the_dark_and_grows_with_light_and_exposure_is_that_of_the_middle():
    slope = 1.0 / 2.2 * 0.4 ** (1.0 / 2.2 - 1.0) * 255.0
    assert np.std(coloured(flat(0.4), shot_noise=1e-3)) == pytest.approx(slope * np.sqrt(1e-3 * 0.4), rel=0.1)
    assert np.std(seen(flat(0.05))) == 0.0
    assert np.median(BARS) * gain_for(BARS, replace(PERFECT, exposure=0.3)) == pytest.approx(0.3)
