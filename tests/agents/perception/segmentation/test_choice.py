"""Which segmenter an unknown image is given to."""

import numpy as np
import pytest

from agents.perception.segmentation.choice import SEGMENTERS, suitable_segmenter
from agents.perception.segmenter_names import GIVEN_MASKS, PROMPTABLE, SEGMENTER_NAMES
from shared.scene.__main__ import make_scene
from shared.scene.render import render


@pytest.mark.parametrize(("background", "expected"), [("plain", "threshold"), ("tissue", "network")])
def test_plain_ground_is_thresholded_and_tissue_is_given_to_the_network(background, expected):
    pair = render(make_scene("medium", background, 7))
    assert suitable_segmenter(pair.left_bgr) == expected
    assert suitable_segmenter(pair.right_bgr) == expected


def test_a_cut_out_thread_on_white_is_plain():
    image = np.full((480, 640, 3), 255, np.uint8)
    image[100:400, 300:312] = (120, 60, 130)
    assert suitable_segmenter(image) == "threshold"


def test_an_image_of_which_most_is_black_is_not_plain():
    image = np.zeros((480, 640, 3), np.uint8)
    image[:, 500:] = np.linspace(20, 200, 480)[:, None, None]
    assert suitable_segmenter(image) == "network"


def test_every_segmenter_gives_coverage_of_the_images_size():
    image = np.random.default_rng(2).integers(0, 256, (54, 96, 3), dtype=np.uint8)
    for segment in SEGMENTERS.values():
        found = segment(image)
        assert (found.shape, found.dtype) == ((54, 96), np.uint8)


def test_every_segmenter_has_its_name():
    assert {GIVEN_MASKS, PROMPTABLE, *SEGMENTERS} == set(SEGMENTER_NAMES)
