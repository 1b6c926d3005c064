"""What the network sees of instruments and needles, as a small map."""

import numpy as np

from agents.perception import occluders
from agents.perception.occluders import instruments_in, map_image, map_shape, occluders_in
from agents.perception.segmentation.classes import Kind
from schemas.messages import Occluder
from shared.images import decode_image


def test_a_map_has_a_pixel_for_each_square_that_the_network_tells(monkeypatch):
    asked = []
    kinds = np.zeros((135, 240), np.uint8)
    kinds[:40], kinds[40:50], kinds[50:60] = Kind.INSTRUMENT, Kind.NEEDLE, Kind.THREAD
    monkeypatch.setattr(occluders, "kinds_of_squares", lambda image: asked.append(image.shape) or kinds)
    found = occluders_in(np.zeros((540, 960, 3), np.uint8))
    assert asked == [(270, 480, 3)]
    assert found.shape == map_shape((540, 960)) == (135, 240)
    expected = np.zeros((135, 240), np.uint8)
    expected[:40], expected[40:50] = Occluder.TOOL.value, Occluder.NEEDLE.value
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(decode_image(map_image(found)), found)
    hidden = instruments_in(found, (540, 960))
    assert hidden[:200].all()
    assert not hidden[200:].any()
