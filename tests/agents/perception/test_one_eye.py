"""Lines that one eye alone shows: dropped where the other eye would show them too if they were thread."""

import numpy as np
import pytest

from agents.perception.candidates import in_common, seen_by_both
from schemas.messages import Centrelines, Occluder, no_centrelines
from shared.disparities import disparities

WIDTH, HEIGHT = 960, 540
DISPARITY = 60.0
NOTHING = np.zeros((135, 240), np.uint8)
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


def occluder(columns, rows=slice(None), kind=Occluder.TOOL):
    found = NOTHING.copy()
    found[rows, columns] = kind.value
    return found


def pair(eye, way):
    """Both eyes show the thread, and one of them a line more."""
    shown, other = lines(THREAD, way, shift=eye * DISPARITY), lines(THREAD, shift=(1 - eye) * DISPARITY)
    return (other, shown) if eye else (shown, other)


def seen(both, occluders):
    common = in_common(both, disparities(WIDTH))
    assert common is not None
    return seen_by_both(both, common, occluders, WIDTH, disparities(WIDTH).about_px)


def length_in_common_px(both):
    common = in_common(both, disparities(WIDTH))
    return 0.0 if common is None else common.length_px


def kept(eye, way, occluders):
    return len(np.unique(seen(pair(eye, way), occluders)[eye].piece)) == 2


@pytest.mark.parametrize("eye", [0, 1])
@pytest.mark.parametrize("occluders", [None, (NOTHING, NOTHING)], ids=["nobody knows of instruments", "none is there"])
def test_a_line_that_one_eye_alone_shows_is_no_thread(eye, occluders):
    found = seen(pair(eye, LONE), occluders)
    for line, thread in zip(found, (lines(THREAD), lines(THREAD, shift=DISPARITY)), strict=True):
        np.testing.assert_array_equal(line.point_px, thread.point_px)


def test_what_both_eyes_show_stays():
    both = lines(THREAD, LONE), lines(THREAD, LONE, shift=DISPARITY)
    assert seen(both, (NOTHING, NOTHING)) == both


@pytest.mark.parametrize("eye", [0, 1])
def test_a_line_that_an_instrument_hides_in_the_other_eye_stays(eye):
    """It lies apart from the instrument in its own eye, and where that is in the other one."""
    elsewhere = (LONE[0][0] + (60 if eye else -60)) // 4
    hides = occluder(slice(elsewhere - 20, elsewhere + 40))
    assert kept(eye, LONE, (hides, NOTHING) if eye else (NOTHING, hides))


def test_no_thread_is_hidden_by_a_needle():
    assert not kept(0, LONE, (NOTHING, occluder(slice(None), kind=Occluder.NEEDLE)))


@pytest.mark.parametrize("eye", [0, 1])
def test_a_line_that_lies_beyond_the_other_image_stays(eye):
    way = [(940, 100), (950, 200)] if eye else [(10, 100), (30, 200)]
    shifted = [(u + 60, v) for u, v in way] if eye else way
    assert kept(eye, shifted, (NOTHING, NOTHING))


@pytest.mark.parametrize("kind", [Occluder.TOOL, Occluder.UNKNOWN])
def test_a_line_upon_an_instrument_that_the_other_eye_does_not_show_is_none_of_thread(kind):
    """Though the place lies upon the instrument in the other eye too: thread upon it would lie before it."""
    upon = occluder(slice(150, None), kind=kind)
    assert not kept(0, LONE, (upon, upon))
    assert not kept(1, LONE, (upon, upon))


def test_a_line_that_only_begins_upon_an_instrument_stays_where_that_hides_the_rest():
    begins, hides = occluder(slice(0, 180)), occluder(slice(0, 180))
    assert kept(0, LONE, (begins, hides))


def test_a_line_near_what_both_eyes_see_stays():
    """It may be the same thread, of which one eye shows more."""
    on = [(425, 495), (433, 525)]
    assert kept(0, on, (NOTHING, NOTHING))


def test_nothing_is_dropped_where_the_eyes_show_different_things():
    shown = lines(THREAD, LONE), lines([(800, 20), (850, 50)], shift=DISPARITY)
    assert seen(shown, None) == shown


ALONG_ROWS = [(300, 200), (420, 200)]


@pytest.mark.parametrize("way", [THREAD, LONE, ALONG_ROWS], ids=["a long line", "a short one", "one along the rows"])
def test_what_both_eyes_have_in_common_is_as_long_as_it_is(way):
    both = lines(way), lines(way, shift=DISPARITY)
    assert length_in_common_px(both) == pytest.approx(len(both[0].piece), rel=0.15)


def test_what_each_eye_shows_elsewhere_is_not_in_common():
    lower = [(700, 400), (760, 460)]
    assert length_in_common_px((lines(LONE), lines(lower, shift=DISPARITY))) == 0.0
    # in its rows, but where no thread could be seen from there: to the right of it
    assert length_in_common_px((lines(LONE), lines(LONE, shift=-DISPARITY))) == 0.0
    assert length_in_common_px((lines(THREAD, LONE), lines(LONE, lower, shift=DISPARITY))) < len(lines(LONE).piece) + 12


@pytest.mark.parametrize("eye", [0, 1])
def test_nothing_is_in_common_where_one_eye_shows_nothing(eye):
    shown, nothing = lines(LONE), no_centrelines()
    assert length_in_common_px((nothing, shown) if eye else (shown, nothing)) == 0.0
