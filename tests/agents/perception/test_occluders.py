"""What makes a region an instrument: that it is large, far greyer than the ground, and sharply bounded."""

import cv2
import numpy as np

from agents.perception.occluders import DARK, STEP, ZERO, occluders_in, redness
from schemas.messages import Occluder

WIDTH, HEIGHT = 640, 360
GROUND, STEEL = np.array((70.0, 80.0, 160.0)), np.array((110.0, 112.0, 115.0))


def test_redness_is_the_nearest_whole_number_of_steps_of_the_logarithm():
    red, others = (part.astype(np.uint8) for part in np.mgrid[:256, :256])
    ratio = np.log((red + DARK) / (others + DARK)) / STEP + ZERO
    found = redness(np.dstack((others, others, red)))
    assert np.abs(found - ratio.clip(0, 255)).max() < 0.5 + 1e-4
    # blue and green count alike
    mixed = redness(np.dstack((np.full_like(red, 10), np.full_like(red, 90), red)))
    np.testing.assert_array_equal(mixed, redness(np.dstack((np.full_like(red, 50), np.full_like(red, 50), red))))


def seen(steel, others=()):
    """What is found where so much of each pixel is steel (0 to 1), with rectangles of other colours."""
    rng = np.random.default_rng(1)
    image = GROUND + steel[..., None] * (STEEL - GROUND)
    for (rows, columns), colour in others:
        image[rows, columns] = colour
    noisy = np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)
    found = occluders_in(noisy, np.zeros((HEIGHT, WIDTH), np.uint8))
    assert found is not None
    return cv2.resize(found, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)


def reaching_in(rows=60, columns=300):
    """A bar from the left border."""
    steel = np.zeros((HEIGHT, WIDTH))
    steel[150 : 150 + rows, :columns] = 1.0
    return steel


def test_a_bar_of_steel_is_one():
    found = seen(reaching_in())
    assert (found[155:205, :290] == Occluder.TOOL.value).all()
    assert (found > 0).mean() < 1.2 * reaching_in().mean()


def test_what_is_small_is_none():
    both = reaching_in()
    both[30:44, 600:] = 1.0
    found = seen(both)
    assert found[155:205, :290].all()
    assert not found[:100, 500:].any()


def test_what_goes_over_into_the_ground_is_none():
    soft = cv2.GaussianBlur(reaching_in(120, 300), (0, 0), 30.0)
    assert not seen(soft / soft.max()).any()


def test_what_is_only_somewhat_greyer_than_the_ground_is_none():
    """Pale tissue, with as sharp a border, beside a true instrument and without one."""
    pale = (slice(20, 120), slice(400, 640)), GROUND + 0.5 * (STEEL - GROUND)
    beside = seen(reaching_in(), [pale])
    assert not beside[30:110, 420:620].any()
    assert (beside[155:205, :290] == Occluder.TOOL.value).all()
    faint = (slice(20, 120), slice(400, 640)), GROUND + 0.15 * (STEEL - GROUND)
    assert not seen(np.zeros((HEIGHT, WIDTH)), [faint]).any()
    alone = (slice(20, 120), slice(400, 640)), GROUND + 0.44 * (STEEL - GROUND)
    assert not seen(np.zeros((HEIGHT, WIDTH)), [alone]).any()


def test_a_glint_upon_an_instrument_is_part_of_it_and_one_on_tissue_is_none():
    glints = [((slice(170, 180), slice(60, 120)), 250.0), ((slice(20, 60), slice(400, 640)), 250.0)]
    found = seen(reaching_in(), glints)
    assert (found[155:205, :290] == Occluder.TOOL.value).mean() > 0.97
    assert not found[:100, 350:].any()
