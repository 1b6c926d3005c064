"""Threads that a tool's edge covers obliquely, with the middle and the width of what remains of them in sight."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.reconstruction.refined.covered_ends import DOUBT, hidden_of, with_covered_ends
from schemas.messages import Centrelines, Image, ImageEncoding, Occluder, Occluders
from shared.images import encode_image

WIDTH, RADIUS, LENGTH = 5.0, 150.0, 120


def bent(make_lines, radius=RADIUS):
    """A thread on an arc, for every pixel a point and the unit vector across."""
    angle = np.arange(LENGTH) / radius
    out = np.column_stack((np.sin(angle), 1.0 - np.cos(angle)))
    lines = make_lines(radius * out, width=WIDTH, deviation=0.02)
    return lines, np.column_stack((-np.sin(angle), np.cos(angle)))[: len(lines.piece)]


def narrowed(lines, across, missing, one_sided=1.0):
    """The same points, with so much less width at the first and last of them, from one side or from both."""
    moved = lines.point_px + 0.5 * one_sided * missing[:, None] * across
    return dataclasses.replace(lines, point_px=moved, width_px=lines.width_px - missing)


def at_both_ends(most, count, over):
    missing = np.zeros(count)
    missing[: over + 1] = np.linspace(most, 0.0, over + 1)
    return np.maximum(missing, missing[::-1])


@pytest.mark.parametrize(("most", "over"), [(1.5, 4), (4.0, 12)])
def test_points_beside_a_cover_err_by_half_of_what_it_hides(make_lines, most, over):
    lines, across = bent(make_lines)
    missing = at_both_ends(most, len(across), over)
    found = with_covered_ends(narrowed(lines, across, missing))
    wrong = missing > (1 - 0.95) * WIDTH
    error = 0.5 * missing[wrong]
    assert (found.deviation_px[wrong] > 0.75 * error).all()
    assert (found.deviation_px[wrong] < 1.05 * np.hypot(error, 0.02)).all()
    np.testing.assert_array_equal(found.deviation_px[~wrong], lines.deviation_px[~wrong])


def test_a_tip_that_narrows_on_both_sides_is_where_it_seems(make_lines):
    lines, across = bent(make_lines)
    missing = at_both_ends(4.0, len(across), 8)
    found = with_covered_ends(narrowed(lines, across, missing, one_sided=0.0))
    assert (found.deviation_px <= 1.01 * np.hypot(0.02, 1.5 * DOUBT * 0.5 * missing)).all()


def test_a_short_piece_that_is_covered_all_along_is_told_by_the_width_of_the_thread(make_lines):
    long, across = bent(make_lines)
    count, shift = 30, np.array([0.0, 50.0])
    missing = 1.0 + at_both_ends(1.5, count, 10)
    both = make_lines(long.point_px, long.point_px[:count] + shift, width=WIDTH, deviation=0.02)
    short = np.flatnonzero(both.piece == 1)[:count]
    point, width = both.point_px.copy(), both.width_px.copy()
    point[short] += 0.5 * missing[:, None] * across[:count]
    width[short] -= missing
    found = with_covered_ends(dataclasses.replace(both, point_px=point, width_px=width)).deviation_px
    assert (found[short] >= 0.5 * missing * DOUBT).all()
    assert np.median(found[short] / missing) > 0.4
    np.testing.assert_array_equal(found[both.piece == 0], both.deviation_px[both.piece == 0])


@given(st.lists(st.integers(1, 9), min_size=0, max_size=4), st.integers(0, 2**31))
def test_deviations_never_shrink_whatever_the_lines(counts, seed):
    rng = np.random.default_rng(seed)
    n = sum(counts)
    lines = Centrelines(
        rng.uniform(0, 100, (n, 2)),
        np.repeat(np.arange(len(counts)), counts),
        rng.uniform(0.1, 9, n),
        rng.uniform(0.01, 1, n),
    )
    found = with_covered_ends(lines)
    assert (found.deviation_px >= lines.deviation_px * (1 - 1e-12)).all()
    assert np.isfinite(found.deviation_px).all()
    np.testing.assert_array_equal(found.point_px, lines.point_px)


def encoded(regions):
    return encode_image(regions, ImageEncoding.PNG)


def test_what_is_unseen_upon_an_instrument_is_hidden_and_an_end_before_one_may_go_on():
    tool = np.zeros((54, 96), np.uint8)
    tool[:, 40:50], tool[:, 80:] = Occluder.TOOL.value, Occluder.UNKNOWN.value
    line = np.column_stack((np.arange(100.0, 796.0, 4.0), np.full(174, 270.0)))
    unseen = (line[:, 0] > 300) & (line[:, 0] < 450)
    nothing = np.zeros_like(tool)
    found = hidden_of((line, line), unseen, Occluders(encoded(tool), encoded(nothing), 0), 960)
    assert found is not None
    np.testing.assert_array_equal(found.places, (line[:, 0] >= 400) & (line[:, 0] < 450))
    assert found.ends.tolist() == [False, True]
    turned = hidden_of((line[::-1], line[::-1]), unseen, Occluders(encoded(nothing), encoded(tool), 0), 960)
    assert turned is not None
    assert turned.ends.tolist() == [True, False]
    away = line[line[:, 0] < 740]
    ended = hidden_of((away, away), unseen[: len(away)], Occluders(encoded(tool), encoded(nothing), 0), 960)
    assert ended is not None
    assert ended.ends.tolist() == [False, False]


def test_without_a_word_on_instruments_or_with_a_broken_one_nothing_is_called_hidden():
    line, unseen = np.column_stack((np.arange(9.0), np.zeros(9))), np.ones(9, bool)
    broken = Image(ImageEncoding.PNG, 9, 9, 1, b"no image")
    colour = encoded(np.zeros((5, 9, 3), np.uint8))
    assert hidden_of((line, line), unseen, None, 960) is None
    assert hidden_of((line, line), unseen, Occluders(broken, broken, 0), 960) is None
    assert hidden_of((line, line), unseen, Occluders(colour, colour, 0), 960) is None
