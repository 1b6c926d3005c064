"""Places along a thread."""

import numpy as np
import pytest

from shared import arc_length, splines
from shared.along_thread import nearly_even


def test_places_by_chords_are_as_even_as_arc_length_has_them():
    control = np.array(
        [[-20.0, 0, 80], [-15, 9, 78], [-1, -12, 84], [3, 11, 90], [11, -3, 80], [12, 4, 70], [25, 0, 80]]
    )
    knots, count = splines.clamped_uniform_knots(len(control)), 201
    parameters, length = nearly_even(knots, control, 3, count, chords_per_span=150)
    assert length == pytest.approx(arc_length.length(knots, control, 3), rel=1e-4)
    off = splines.evaluate(knots, control, 3, parameters) - splines.evaluate(
        knots, control, 3, arc_length.even_parameters(knots, control, 3, count)
    )
    assert np.abs(off).max() < 2e-3, "mm, of 90"
