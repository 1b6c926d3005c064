"""What the right image shows of thread along the rows, of which nothing but its end can be matched."""

import numpy as np
import pytest

from agents.reconstruction.refined.method import course_of
from agents.reconstruction.refined.sightings import LEVEL_PX

BEND = 0.5
"""Share of the hook that lies across the rows; the rest runs along them."""


def hook(t):
    """Across the rows, then round a bend along them to the end, where depth still changes; in millimetres."""
    down, along = np.minimum(t / BEND, 1.0), np.maximum(t - BEND, 0.0) / (1.0 - BEND)
    return np.column_stack((-15 + 3 * down + 26 * along, -14 + 24 * down + 0.5 * along**2, 95 - 3 * along))


def seen_twice(see, lower_px=0.0, cut=(0.42, 0.56)):
    """Both centrelines, a stretch about the bend hidden, and the flat piece of the right one so much lower."""
    left, right = (see(hook, eye, ((0.0, cut[0]), (cut[1], 1.0))) for eye in (0, 1))
    flat = right.piece == 1
    right.point_px.flags.writeable = True
    right.point_px[flat, 1] += np.linspace(lower_px, 0.0, int(flat.sum()))
    return left, right


def flat_places(course):
    """Of the flat piece: the places of its ends on the course, the thread's own first, and its right points'."""
    ends = course.left.along_px[course.left.piece == 1][[0, -1]] / course.left.along_px[-1]
    own, cut = sorted(ends, key=lambda s: min(s, 1.0 - s))
    right = course.sight.s[course.sight.eye == 1]
    return own, cut, np.sort(right[(right >= min(ends) - 0.02) & (right <= max(ends) + 0.02)])


def test_past_a_gap_both_eyes_show_thread_along_the_rows_from_its_end_on_equally_far(see, of_lines):
    left, right = seen_twice(see)
    course = course_of(of_lines(left, right))
    own, cut, s = flat_places(course)
    matched = {float(s): int(i) for s, i in zip(course.aligned.along_px, course.aligned.right_index, strict=True)}
    assert matched[own * course.left.along_px[-1]] == len(right.piece) - 1
    assert np.abs(s - own).max() == pytest.approx(abs(cut - own), abs=0.03)
    assert np.diff(s).max() < 0.02


def test_what_leaves_the_rows_of_the_left_image_is_not_followed(see, of_lines):
    own, cut, s = flat_places(course_of(of_lines(*seen_twice(see, lower_px=3 * LEVEL_PX))))
    # a third of it, from the thread's end on, lies in about the same rows
    assert 0.2 < np.abs(s - own).max() / abs(cut - own) < 0.5
