"""Rows that a calibration leaves apart: as a turned camera has them, found from a thread, and left alone without."""

import dataclasses

import cv2
import numpy as np
import pytest

from agents.reconstruction.refined.posterior import point_covariance
from agents.reconstruction.refined.projection import row_offsets_px
from agents.reconstruction.refined.refinement import Start, refined
from shared.calibration.uncertainty import ERRORS
from shared.curve_distance import curve_distance

DENSE = np.linspace(0, 1, 2000)
TURN = np.radians(0.15)


def turned(px, camera, axis):
    """Where a camera that is turned by a small angle sees what it would see at these pixels."""
    K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
    R, _ = cv2.Rodrigues(TURN * np.eye(3)["xyz".index(axis)])
    seen = np.column_stack((px, np.ones(len(px)))) @ (K @ R @ np.linalg.inv(K)).T
    return seen[:, :2] / seen[:, 2:]


@pytest.mark.parametrize(("axis", "terms"), [("x", (-1, 0, 0, 0)), ("y", (0, 0, 0, 1)), ("z", (0, 1, 0, 0))])
def test_a_turned_camera_moves_rows_as_the_terms_say(camera, axis, terms):
    rng = np.random.default_rng(0)
    px = rng.uniform(0, 1, (200, 2)) * (camera.image_width, camera.image_height)
    lower_px = turned(px, camera, axis)[:, 1] - px[:, 1]
    told_px = row_offsets_px(px, TURN * camera.fy_px * np.array(terms, float), camera)
    assert np.abs(lower_px).max() > 0.25
    assert np.abs(lower_px - told_px).max() < (0.25 if axis == "x" else 0.02)


def seen_by_turned_cameras(sight, camera, axis):
    """The same sightings with half the turn in either camera, as a rectification leaves it."""
    px = sight.point_px.copy()
    for eye, sign in ((0, -0.5), (1, 0.5)):
        here = sight.eye == eye
        px[here] += sign * (turned(px[here], camera, axis) - px[here])
    return dataclasses.replace(sight, point_px=px)


def test_rows_of_a_camera_turned_about_the_line_of_sight_are_taken_out(waving_spline, sight_of, camera):
    sight = seen_by_turned_cameras(sight_of(waving_spline, count=300, noise_px=0.1), camera, "z")
    loose = np.diag((np.array(ERRORS) == "roll") * TURN**2)
    fit = refined(Start(waving_spline, sight, of_calibration=loose), camera)
    assert fit.row_offset_px[1] == pytest.approx(TURN * camera.fx_px, rel=0.4)
    exact = refined(Start(waving_spline, sight, of_calibration=0 * loose), camera)
    assert not exact.row_offset_px.any()
    assert exact.row_doubt is None
    with_terms, without = (curve_distance(f.curve.at(DENSE), waving_spline.at(DENSE)).mean for f in (fit, exact))
    assert with_terms < 0.6 * without
    # what they leave uncertain is part of the posterior
    assert fit.row_doubt is not None
    assert np.linalg.eigvalsh(fit.row_doubt.T @ fit.row_doubt).max() > 0


@pytest.mark.parametrize("seed", range(2))
def test_rows_that_are_level_stay_so(waving_spline, sight_of, camera, seed):
    sight = sight_of(waving_spline, count=300, noise_px=0.2, deviation_px=0.2, seed=seed)
    fit = refined(Start(waving_spline, sight), camera)
    assert np.abs(fit.row_offset_px).max() < 0.15


def test_on_a_straight_thread_the_rows_are_what_the_calibration_says(make_spline, sight_of, camera):
    straight = make_spline(lambda t: np.column_stack((-20 + 40 * t, 12 - 24 * t, 95 + 0 * t)), 20)
    fit = refined(Start(straight, sight_of(straight, count=300, noise_px=0.1, row_offset_px=0.6)), camera)
    # the images do not tell it from depth, which is then as uncertain as the rows are
    assert abs(fit.row_offset_px[0]) < 0.3
    covariance = point_covariance(fit, camera, np.array([0.5]))[0]
    off = fit.curve.at(np.array([0.5]))[0, 2] - 95
    assert abs(off) > 0.5
    assert abs(off) < 4 * np.sqrt(covariance[2, 2])
