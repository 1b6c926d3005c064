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
    times = np.zeros(SHAPE, int)
    for box in boxes_around(where):
        times[box.inner] += 1
        for inner, outer, size in zip(box.inner, box.outer, SHAPE, strict=True):
            assert max(0, inner.start - CONTEXT_PX) >= outer.start >= 0
            assert min(size, inner.stop + CONTEXT_PX) <= outer.stop <= size
    assert (times[where] == 1).all()
    assert times.max(initial=0) <= 1


@given(PLACES)
def test_the_inner_box_is_found_again_in_the_outer(places):
    image = np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE)
    for box in boxes_around(mask_of(places)):
        np.testing.assert_array_equal(image[box.outer][box.inner_in_outer], image[box.inner])


def test_a_diagonal_is_looked_at_in_several_boxes_of_less_area_than_the_one_around_it():
    where = np.zeros((540, 960), bool)
    for step in range(500):
        where[step : step + 20, step : step + 20] = True
    boxes = boxes_around(where)
    assert len(boxes) > 1
    assert sum(box.area for box in boxes) < 0.7 * 540 * 540


def test_nothing_needs_no_box():
    assert boxes_around(np.zeros(SHAPE, bool)) == []
