"""Masks are the same after they have travelled."""

import numpy as np
import pytest

from agents.perception.mask_image import drawn_mask_image, mask_image
from shared.images import decode_image


@pytest.mark.parametrize("shape", [(1, 1), (3, 7), (5, 8), (270, 481)])
def test_a_drawn_mask_decodes_to_itself(shape):
    mask = np.where(np.random.default_rng(3).random(shape) < 0.3, 255, 0).astype(np.uint8)
    for each in (mask, np.zeros_like(mask), np.full_like(mask, 255)):
        np.testing.assert_array_equal(decode_image(drawn_mask_image(each)), each)


def test_coverage_keeps_its_levels():
    coverage = np.arange(256, dtype=np.uint8).reshape(8, 32)
    np.testing.assert_array_equal(decode_image(mask_image(coverage)), coverage)
