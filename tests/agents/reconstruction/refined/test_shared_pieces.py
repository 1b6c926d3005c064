"""A loop whose strands cross at a small angle, so that a stretch of them is one centreline."""

import dataclasses

import numpy as np
import pytest

from agents.reconstruction.refined.crossings import crossings_of
from agents.reconstruction.refined.method import course_and_fit, course_of
from agents.reconstruction.refined.posterior import point_covariance
from agents.reconstruction.refined.result import SAMPLED
from shared.camera import project
from shared.disparities import disparities

WIDTH, RADIUS, TO = 6.0, 8.0, 1.3 * np.pi
"""In pixels, in millimetres, and the last angle; strands cross at π."""
STATED_PX = 0.5


def loop(angle, parting):
    """A turn and some more about a point, in millimetres; the strands there part in proportion to the angle."""
    radius = RADIUS + parting * angle**2
    return np.column_stack((radius * np.cos(angle), radius * np.sin(angle), 95 + 2 * np.sin(angle)))


def seen_by(eye, camera, make_lines, parting):
    """Pieces before, in and after the loop, and the one that both strands share."""

    def px(angle):
        return project(camera, loop(angle, parting))[eye]

    # within this angle of the crossing, strands are less than a width apart
    near = WIDTH / (4000.0 / 95.0 * parting * np.pi)
    along = np.linspace(np.pi - near, np.pi + near, 400)
    first, second = px(along - 2 * np.pi), px(along)
    stretches = (-TO, -np.pi - near), (-np.pi + near, np.pi - near), (np.pi + near, TO)
    shared = 0.5 * (first + second)
    lines = make_lines(*(px(np.linspace(*stretch, 2000)) for stretch in stretches), shared, width=WIDTH)
    on = lines.piece == len(stretches)
    apart = np.interp(np.linspace(0, 1, on.sum()), np.linspace(0, 1, 400), np.linalg.norm(first - second, axis=1))
    width, deviation = lines.width_px.copy(), lines.deviation_px.copy()
    width[on] += apart
    deviation[on] = STATED_PX
    return dataclasses.replace(lines, width_px=width, deviation_px=deviation), on, apart


@pytest.fixture(params=[0.12, 0.18], ids=["slanting", "less slanting"])
def seen(request, camera, make_lines):
    return [seen_by(eye, camera, make_lines, request.param) for eye in (0, 1)]


def crossings(left, right, camera):
    _, fit = course_and_fit(left, right, camera, disparities(camera.image_width))
    return crossings_of(camera, fit.curve, SAMPLED, point_covariance(fit, camera, SAMPLED))


def test_the_strands_cross_once(seen, camera):
    (left, _, _), (right, _, _) = seen
    assert len(crossings(left, right, camera)) == 1


def test_points_of_the_shared_piece_say_what_one_place_says_that_errs_by_half_of_what_it_is_too_wide(seen, camera):
    (left, on, apart), (right, _, _) = seen
    course = course_of(left, right, camera, disparities(camera.image_width)).left
    shared = on[course.index]
    assert shared.sum() == 2 * on.sum()
    of_piece = course.index[shared] - np.flatnonzero(on)[0]
    np.testing.assert_allclose(
        course.deviation_px[shared], np.hypot(STATED_PX, 0.5 * apart[of_piece] * np.sqrt(on.sum() / 6)), atol=1e-6
    )
    assert (course.deviation_px[~shared] <= 0.1 + 1e-9).all()


def test_a_thread_that_passes_nothing_twice_keeps_what_is_stated(threads, camera, see):
    left, right = (see(threads["winding"], eye) for eye in (0, 1))
    assert course_of(left, right, camera, disparities(camera.image_width)).left.deviation_px == pytest.approx(0.1)
