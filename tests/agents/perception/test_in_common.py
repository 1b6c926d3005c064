"""How much of thread both eyes show, whatever it looks like."""

import numpy as np
import pytest

from agents.perception.candidates import length_in_common_px
from schemas.messages import Centrelines, no_centrelines
from shared.disparities import disparities

REACH = disparities(960)
DISPARITY = 60.0
THREAD = [(300, 60), (420, 480)]
LONE = [(700, 200), (760, 260)]


def lines(*ways, shift=0.0):
    """Straight lines with points a pixel apart."""
    parts = []
    for (u, v), (u2, v2) in ways:
        t = np.linspace(0.0, 1.0, round(np.hypot(u2 - u, v2 - v)))[:, None]
        parts.append((1 - t) * (u - shift, v) + t * (u2 - shift, v2))
    point = np.concatenate(parts)
    piece = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return Centrelines(point, piece, np.full(len(point), 4.0), np.full(len(point), 0.1))


ALONG_ROWS = [(300, 200), (420, 200)]


@pytest.mark.parametrize("way", [THREAD, LONE, ALONG_ROWS], ids=["a long line", "a short one", "one along the rows"])
def test_what_both_eyes_have_in_common_is_as_long_as_it_is(way):
    both = lines(way), lines(way, shift=DISPARITY)
    assert length_in_common_px(both, REACH) == pytest.approx(len(both[0].piece), rel=0.15)


def test_what_each_eye_shows_elsewhere_is_not_in_common():
    lower = [(700, 400), (760, 460)]
    assert length_in_common_px((lines(LONE), lines(lower, shift=DISPARITY)), REACH) == 0.0
    # in its rows, but where no thread could be seen from there: to the right of it
    assert length_in_common_px((lines(LONE), lines(LONE, shift=-DISPARITY)), REACH) == 0.0
    assert (
        length_in_common_px((lines(THREAD, LONE), lines(LONE, lower, shift=DISPARITY)), REACH)
        < len(lines(LONE).piece) + 12
    )


@pytest.mark.parametrize("eye", [0, 1])
def test_nothing_is_in_common_where_one_eye_shows_nothing(eye):
    shown, nothing = lines(LONE), no_centrelines()
    assert length_in_common_px((nothing, shown) if eye else (shown, nothing), REACH) == 0.0
