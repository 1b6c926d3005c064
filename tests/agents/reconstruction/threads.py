"""Threads whose every point is known, in millimetres, what both images show of them, and observations of them."""

import dataclasses

import numpy as np

from agents.reconstruction.refined.projection import Curve, fitted
from agents.reconstruction.refined.sightings import Sightings
from schemas.messages import Centrelines, FrameStamp, Image, ImageEncoding, RectifiedStereo, Status, ThreadObservations
from shared.camera import project
from shared.splines import clamped_uniform_knots

CAMERA = RectifiedStereo(960, 540, 1000.0, 1010.0, 479.5, 269.5, 5.5, 1e-3)
NOTHING = np.zeros((0, 3))


def winding(t):
    """A thread that stays clear of the rows' direction."""
    return np.column_stack((-12 + 22 * t + 3 * np.sin(5 * t), 18 - 36 * t, 95 + 5 * np.cos(4 * t)))


def waving(t):
    """A thread that runs along the rows at every crest."""
    return np.column_stack((-24 + 48 * t, 9 * np.sin(7 * t), 92 + 6 * np.cos(4 * t)))


def even(points, step=1.0):
    """A polyline resampled at even steps."""
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    at = np.linspace(0, along[-1], max(2, round(along[-1] / step) + 1))
    return np.column_stack([np.interp(at, along, column) for column in points.T])


def lines_of(*pieces, width=3.0, deviation=0.1):
    """Centrelines of pieces (u, v), a point for each pixel."""
    points = [even(np.asarray(piece, np.float64)) for piece in pieces]
    count = sum(map(len, points))
    numbers = np.repeat(np.arange(len(points)), [len(p) for p in points])
    return Centrelines(np.concatenate(points).reshape(-1, 2), numbers, np.full(count, width), np.full(count, deviation))


def see(curve, eye, shown=((0.0, 1.0),), camera=CAMERA):
    """What one eye sees of a thread: a piece for each stretch of t that is shown."""
    return lines_of(*(project(camera, curve(np.linspace(low, high, 2000)))[eye] for low, high in shown))


def spline_of(curve, spans=22):
    """The thread as a spline of constant speed."""
    points = even(curve(np.linspace(0, 1, 5001)), 1e-3)
    share = np.linspace(0, 1, 5 * (spans + 3))
    points = np.column_stack([np.interp(share, np.linspace(0, 1, len(points)), column) for column in points.T])
    return Curve(clamped_uniform_knots(spans + 3), fitted(spans, points))


def sight_of(spline, count=150, noise_px=0.0, deviation_px=0.1, seed=0, row_offset_px=0.0):
    """Points of both images at known parameters, the ends marked as such."""
    s = np.linspace(0, 1, count)
    px = np.concatenate(project(CAMERA, spline.at(s)))
    px[:, 1] += np.repeat([-0.5, 0.5], count) * row_offset_px
    px += np.random.default_rng(seed).normal(0, noise_px, px.shape)
    is_end = np.zeros(2 * count, bool)
    is_end[[0, count - 1, count, 2 * count - 1]] = True
    return Sightings(px, np.full(2 * count, deviation_px), np.repeat([0, 1], count), np.tile(s, 2), is_end)


def dense(blocks):
    """The sum of the blocks (12, 12) of four neighbouring control points."""
    m = len(blocks) + 3
    H = np.zeros((3 * m, 3 * m))
    for k, block in enumerate(blocks):
        H[3 * k : 3 * k + 12, 3 * k : 3 * k + 12] += block
    return H


def observed(points=NOTHING, camera=CAMERA, half_size_px=2.0, **changes):
    """Observations of places, or of nothing, as perception makes them."""
    mask = Image(ImageEncoding.RAW, 1, 1, 1, b"\0")
    observations = ThreadObservations(
        stamp=FrameStamp(7, 100, 200, "calibration"),
        camera=camera,
        status=Status.OK,
        reason="",
        segmenter="by hand",
        points_camera=np.asarray(points, np.float64),
        half_size_px=np.full((len(points), 2), half_size_px),
        matched_px=NOTHING,
        match_cost=np.zeros((0, 2)),
        inlier=np.zeros(0, bool),
        mask_left=mask,
        mask_right=mask,
    )
    return dataclasses.replace(observations, **changes)


def observed_lines(left, right, camera=CAMERA, **changes):
    """Observations with these centrelines."""
    return observed(camera=camera, centrelines_left=left, centrelines_right=right, **changes)


def observed_curve(curve, shown=((0.0, 1.0),), camera=CAMERA, **changes):
    """Observations of a thread of which these stretches are shown."""
    left, right = (see(curve, eye, shown, camera) for eye in (0, 1))
    return observed_lines(left, right, camera, **changes)
