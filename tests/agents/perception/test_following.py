"""A thread that moves a little is followed along its centrelines; whatever else happens has its pixels looked at."""

import functools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.interpolate import make_lsq_spline
from scipy.spatial import KDTree

from agents.camera.scene_source import calibration_of
from agents.perception.centrelines.along import Pieces, evenly_spaced
from agents.perception.centrelines.centrelines import thread_lines
from agents.perception.following.appearance import some_of_observed
from agents.perception.following.follow import Followed, every_second, follow, trail_of
from agents.perception.following.prediction import expected
from agents.perception.segmentation.network import segment_network
from schemas.codec import encode
from schemas.messages import Centrelines, FrameStamp, Status, Trail
from shared.camera import project
from shared.images import decode_image
from shared.rendering.render import ENDOSCOPE
from tests.agents.perception.pictures import agent_with, fed, frame_of, moved, rendered, rendered_pair


@functools.cache
def looked_for(config="medium", seed=32):
    """The left image, and the thread in it, looked for pixel by pixel."""
    image = rendered(config, seed)[1].left_bgr
    found = thread_lines(image, segment_network(image))
    return image, Followed(found.centrelines, trail_of(image, found.centrelines, found.loose_start, found.loose_end))


def followed(image, last):
    """What one eye's image shows of its thread, or why it shows none."""
    where = expected(ENDOSCOPE, [(every_second(last.lines), last.trail)], None, 0, 0)
    found = where if isinstance(where, str) else follow([image], where)
    return found if isinstance(found, str) else found[0]


def followed_while_it_moves(image, found):
    """What shows of a thread that moves twelve times, or why it is looked for anew on the way."""
    now = found
    for step in range(1, 13):
        now = followed(moved([image], 3 * step, -2 * step)[0], now)
        if isinstance(now, str):
            break
    return now


def farthest(point, line):
    return float(np.asarray(KDTree(line).query(point)[0]).max())


@pytest.mark.slow
@pytest.mark.parametrize(("config", "seed", "most"), [("medium", 32, 0.97), ("crossing", 33, 0.93)])
def test_a_thread_that_moves_stays_followed_to_a_fraction_of_a_pixel(config, seed, most):
    image, found = looked_for(config, seed)
    now = followed_while_it_moves(image, found)
    assert not isinstance(now, str), now
    there = found.lines.point_px + np.array((36, -24))
    away = np.asarray(KDTree(there).query(now.lines.point_px)[0])
    back = np.asarray(KDTree(now.lines.point_px).query(there)[0])
    # neighbours lie a pixel apart, so that the nearest one is up to half of one away along the thread
    assert np.median(away) < 0.4
    # no curve tells where it crosses itself now, so that pieces end beside the crossing of before
    assert (away < 1.0).mean() > most
    assert (back < 1.0).mean() > most
    assert now.lines.piece[-1] == found.lines.piece[-1]
    assert now.trail.loose_start.tolist() == found.trail.loose_start.tolist()


def covered(image, point, radius=25):
    """The image with a grey disc over a place of the thread."""
    return cv2.circle(image.copy(), tuple(int(part) for part in np.rint(point)), radius, (150, 150, 150), cv2.FILLED)


def test_what_hides_part_of_the_thread_cuts_it_there_and_the_rest_is_followed():
    image, found = looked_for()
    point = found.lines.point_px
    for at, pieces in ((point[len(point) // 2], 2), (point[0], 1)):
        now = followed(covered(image, at), found)
        assert not isinstance(now, str), now
        assert len(np.unique(now.lines.piece)) == pieces
        assert np.linalg.norm(now.lines.point_px - at, axis=1).min() > 24
        # all but what is hidden, and what lies close beside it
        seen = np.linalg.norm(point - at, axis=1) > 25 + 14
        assert farthest(point[seen], now.lines.point_px) < 4


def test_a_thread_that_is_not_where_it_is_expected_is_to_be_looked_for():
    image, found = looked_for()
    assert isinstance(followed(moved([image], 0, 60)[0], found), str)
    assert isinstance(followed(np.full_like(image, 120), found), str)
    # all points, as older versions sent them, are no trail to follow
    assert expected(ENDOSCOPE, [(found.lines, found.trail)], None, 0, 0) == "points as older versions sent them"


@pytest.mark.slow
def test_observations_say_from_which_frame_a_thread_was_followed_and_an_agent_that_is_fed_them_goes_on_alike():
    def shown(sequence, right=0, hide=None):
        images = moved(rendered_pair("medium", 32), right, 0)
        return frame_of([image if hide is None else covered(image, hide) for image in images], sequence)

    agent, other = (agent_with(calibration_of(ENDOSCOPE), "network") for _ in range(2))
    found = fed(agent, *(shown(k, 3 * k) for k in range(4)))
    assert {o.status for o in found} == {Status.OK}
    assert [(o.looked_sequence, o.segmented_sequence) for o in found] == [(0, 0)] * 4
    assert decode_image(found[-1].mask_left).any()
    middle = found[-1].centrelines_left.point_px[len(found[-1].centrelines_left.point_px) // 2]
    hidden, anew = fed(agent, shown(4, 12, middle), shown(5, 72))
    assert (hidden.segmented_sequence, anew.segmented_sequence) == (0, 5)
    assert np.linalg.norm(hidden.centrelines_left.point_px - middle, axis=1).min() > 25
    (again,) = fed(other, found[2], shown(3, 9))
    assert encode(replace(again, surface_sequence=None)) == encode(replace(found[3], surface_sequence=None))


FRAME_NS = 33_000_000
U = np.linspace(0.0, 1.0, 1200)
ARC = np.column_stack((30 * (U - 0.5), 12 * np.sin(3 * U), 100 + 4 * U))
V = U - 0.5
LOOP = np.column_stack((50 * V - 12 * np.sin(2 * np.pi * V), 9 * np.cos(2 * np.pi * V), np.full(len(U), 100.0)))


def thread_along(points, velocity=None) -> Any:
    """As much of a reconstruction as prediction asks of one: a track that runs along these points."""
    knots = np.concatenate((np.zeros(3), np.linspace(0, 1, 25), np.ones(3)))
    along = np.append(0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    control_points = make_lsq_spline(along / along[-1], points, knots).c
    if velocity is not None:
        velocity = np.tile(np.asarray(velocity, float), (len(control_points), 1))
    shape = {"knots": knots, "control_points_camera": control_points, "velocity_camera": velocity}
    rows = {"row_offset_px": 0.0, "row_slopes_px": None}
    return SimpleNamespace(track=SimpleNamespace(stamp=FrameStamp(1, 0, 0, ""), **shape, **rows))


def observed(*curves):
    """What an eye saw of these lines, every second pixel, each piece with a colour of its own."""
    rough = Pieces(np.repeat(np.arange(len(curves)), [len(curve) for curve in curves]))
    point, pieces = evenly_spaced(np.concatenate(curves), rough, 2.0)
    colours = 40 + 10 * pieces.number[some_of_observed(pieces)]
    n, yes = len(point), np.ones(len(curves), bool)
    length = 2.0 * (np.bincount(pieces.number) - 1)
    return (
        Centrelines(point, pieces.number, np.full(n, 5.0), np.ones(n)),
        Trail(yes, yes, length, np.tile(colours[:, None, None], (1, 3, 3)).astype(np.uint8), yes, yes),
    )


def predicted(thread, *eyes, now_ns=0) -> Any:
    found = expected(ENDOSCOPE, eyes, thread, 0, now_ns)
    assert not isinstance(found, str)
    return found


def test_what_was_hidden_is_looked_for_with_the_rest():
    left, right = project(ENDOSCOPE, ARC)
    eyes = observed(left[:500], left[700:]), observed(right[:450], right[700:])
    for found, line in zip(predicted(thread_along(ARC), *eyes), (left, right), strict=True):
        assert farthest(found.lines.point_px, line) < 0.5
        assert farthest(line, found.lines.point_px) < 3.0
        assert found.lines.piece.max() == 0
        assert not found.was_seen.all()
        assert found.was_seen.mean() > 0.7


def test_a_curve_that_is_off_is_brought_to_where_it_was_seen_last_and_goes_on_moving_as_it_did():
    eyes = project(ENDOSCOPE, ARC)
    off = [line + np.array((1.0, 7.0)) for line in eyes]
    for found, line in zip(predicted(thread_along(ARC), *map(observed, off)), off, strict=True):
        # along itself the thread shows no motion
        assert farthest(found.lines.point_px[5:-5], line) < 1.0
    there = project(ENDOSCOPE, ARC + np.array((0.0, 2.0, 0.0)))
    thread = thread_along(ARC, np.array((0.0, 2.0, 0.0)) / (1e-9 * FRAME_NS))
    for found, line in zip(predicted(thread, *map(observed, eyes), now_ns=FRAME_NS), there, strict=True):
        assert farthest(found.lines.point_px, line) < 0.5


def test_a_thread_that_crosses_itself_is_cut_there_and_each_strand_keeps_to_its_own_side():
    found = predicted(thread_along(LOOP), *map(observed, project(ENDOSCOPE, LOOP)))[0]
    assert found.lines.piece.max() == 2
    assert found.trail.loose_start.tolist() == [True, False, False]
    assert found.trail.loose_end.tolist() == [False, False, True]
    for k in range(3):
        own = found.lines.piece == k
        apart = np.asarray(KDTree(found.lines.point_px[~own]).query(found.lines.point_px[own])[0])
        assert (found.reach_px[own] <= apart / 2 + 1e-9).all()


@pytest.mark.parametrize("thread", [thread_along(ARC), None])
def test_what_is_none_of_the_curve_is_looked_for_where_it_was(thread):
    left, right = project(ENDOSCOPE, ARC)
    other = np.column_stack((np.linspace(100, 250, 200), np.full(200, 480.0)))
    found = predicted(thread, observed(left, other), observed(right, other))[0]
    assert farthest(other, found.lines.point_px) < 3.0
    assert farthest(left, found.lines.point_px) < 3.0
    assert len(np.unique(found.trail.colour_bgr)) == 2


def test_what_is_too_short_or_no_thread_tells_nothing_of_where_to_look():
    eyes = [observed(line) for line in project(ENDOSCOPE, ARC)]
    none = Centrelines(np.zeros((0, 2)), np.zeros(0, int), np.zeros(0), np.zeros(0))
    assert expected(ENDOSCOPE, [(none, eyes[0][1]), eyes[1]], None, 0, 0) == "no pieces"
    short = observed(np.column_stack((np.linspace(100, 106, 10), np.full(10, 50.0))))
    assert expected(ENDOSCOPE, [short, short], None, 0, 0) == "no piece is long enough"
    far = predicted(thread_along(ARC, (1e12, 0.0, 0.0)), *eyes, now_ns=FRAME_NS)[0]
    assert np.array_equal(far.lines.point_px, predicted(None, *eyes)[0].lines.point_px)
