"""Boxes around what is to be looked at, for masks of any form."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agents.perception.segmentation.boxes import CONTEXT_PX, boxes_around

SHAPE = 200, 340
PLACES = st.lists(
    st.tuples(st.integers(0, SHAPE[0] - 1), st.integers(0, SHAPE[1] - 1), st.integers(1, 90), st.integers(1, 90)),
    max_size=6,
)


def mask_of(places):
    where = np.zeros(SHAPE, bool)
    for row, column, height, width in places:
        where[row : row + height, column : column + width] = True
    return where


@given(PLACES)
def test_every_pixel_lies_in_one_inner_box_and_its_surroundings_in_the_outer(places):
    where = mask_of(places)
    image = np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE)
    times = np.zeros(SHAPE, int)
    for box in boxes_around(where):
        times[box.inner] += 1
        for inner, outer, size in zip(box.inner, box.outer, SHAPE, strict=True):
            assert max(0, inner.start - CONTEXT_PX) >= outer.start >= 0
            assert min(size, inner.stop + CONTEXT_PX) <= outer.stop <= size
        np.testing.assert_array_equal(image[box.outer][box.inner_in_outer], image[box.inner])
    assert (times[where] == 1).all()
    assert times.max(initial=0) <= 1
    # nothing needs no box
    assert where.any() or not times.any()
