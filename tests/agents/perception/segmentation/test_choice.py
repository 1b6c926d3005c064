"""Which segmenter an unknown image is given to."""

import numpy as np
import pytest

from agents.perception.segmentation.choice import SEGMENTERS, suitable_segmenter
from agents.perception.segmenter_names import GIVEN_MASKS, PROMPTABLE, SEGMENTER_NAMES
from schemas import messages
from shared.scene.__main__ import make_scene
from shared.scene.render import render


def test_every_segmenter_has_its_name_and_gives_coverage_of_the_images_size():
    assert {GIVEN_MASKS, PROMPTABLE, *SEGMENTERS} == set(SEGMENTER_NAMES)
    assert messages.GIVEN_MASKS == GIVEN_MASKS
    image = np.random.default_rng(2).integers(0, 256, (54, 96, 3), dtype=np.uint8)
    for segment in SEGMENTERS.values():
        found = segment(image)
        assert (found.shape, found.dtype) == ((54, 96), np.uint8)


@pytest.mark.slow
def test_plain_ground_is_thresholded_and_tissue_is_given_to_the_network():
    for background, expected in (("plain", "threshold"), ("tissue", "network")):
        pair = render(make_scene("medium", background, 7))
        assert [suitable_segmenter(image) for image in (pair.left_bgr, pair.right_bgr)] == [expected] * 2
    on_white = np.full((480, 640, 3), 255, np.uint8)
    on_white[100:400, 300:312] = (120, 60, 130)
    assert suitable_segmenter(on_white) == "threshold"
    mostly_black = np.zeros((480, 640, 3), np.uint8)
    mostly_black[:, 500:] = np.linspace(20, 200, 480)[:, None, None]
    assert suitable_segmenter(mostly_black) == "network"
