"""A drawn instrument is found from 8 mm and 3 degrees off, followed, and lost with a reason; its outline is its own."""

import dataclasses
from typing import Any

import cv2
import numpy as np
import pytest

from agents.tool_tracker.acquisition import Begin, acquired, looking, prior, soft_pair
from agents.tool_tracker.correction import Correction, about, twist_about
from agents.tool_tracker.evidence import SHRINK, learnt
from agents.tool_tracker.lines import lined
from agents.tool_tracker.outline import outline, silhouette
from agents.tool_tracker.refinement import View, elsewhere, refined
from agents.tool_tracker.told import track_of
from agents.tool_tracker.track import MISSES, Following, Track, followed
from agents.tool_tracker.tubes import SHAFT, tubes
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER as PSM
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as T_TRUE
from shared.rigid_transforms import apply, exp_se3, inverse
from shared.scene.tool_view import Instrument, draw_solids, solids_of
from tests.rigs.drawn_tool import BEHIND, CAMERA, IN_MM, JAW, TOOL, joints, pair, pair_of

TIP = np.array([[0.0, 0.0, 0.0102]])


def seen(at_s: float, T_camera_base: np.ndarray) -> View:
    return View(CAMERA, (), T_camera_base, PSM.forward(joints(at_s)), JAW)


def test_the_outline_is_that_of_what_is_drawn():
    tool = Instrument()
    T_base_tool = PSM.forward(joints(0))
    for eye_x in (0.0, CAMERA.baseline):
        _, cover = draw_solids(BEHIND, IN_MM, solids_of(T_TRUE, T_base_tool, JAW, tool), tool, 1e3 * eye_x, 0)
        parts = tubes(T_TRUE, T_base_tool, JAW)
        found = outline(CAMERA, parts, eye_x)
        shaft = found.only(found.part == SHAFT)
        places = shaft.px[:, None] + np.array((-1.5, 1.5))[:, None] * shaft.normal[:, None]
        at = np.rint(places).astype(int)
        within, beyond = cover[at[:, 0, 1], at[:, 0, 0]], cover[at[:, 1, 1], at[:, 1, 0]]
        assert (within > 128).mean() > 0.95
        assert (beyond < 128).mean() > 0.95
        size = (90, 160)
        small = cv2.resize(cover, size[::-1], interpolation=cv2.INTER_AREA) > 128
        covered = silhouette(CAMERA, parts, eye_x, size) > 0
        assert (covered & small).sum() > 0.85 * (covered | small).sum()


def test_a_correction_turns_about_its_pivot():
    rng = np.random.default_rng(0)
    pivot, twist = rng.normal(0, 0.1, 3), rng.normal(0, 0.1, 6)
    np.testing.assert_allclose(twist_about(pivot, about(pivot, twist)), twist, atol=1e-12)
    only_turned = about(pivot, np.concatenate((np.zeros(3), twist[3:])))
    np.testing.assert_allclose(apply(only_turned, pivot[None])[0], pivot, atol=1e-12)


@pytest.fixture
def found(begun_session: Any) -> tuple[Track, float]:
    """A track that follows, and the time of its last view."""
    return track_of(begun_session.found), 0.2


@pytest.mark.slow
def test_it_is_found_and_followed_to_within_its_covariance(found: tuple[Track, float], registered: np.ndarray):
    track, at_s = found
    for _ in range(3):
        track = followed(track, soft_pair(*pair(at_s, round(10 * at_s))), seen(at_s, registered), 0.2, 5)
        at_s += 0.2
    assert track.consistent, track.reason
    assert track.correction is not None
    T_base_tool = PSM.forward(joints(at_s - 0.2))
    before = apply(registered @ T_base_tool, TIP)
    error = apply(track.correction.matrix, before)[0] - apply(T_TRUE @ T_base_tool, TIP)[0]
    assert np.linalg.norm(error) < 1e-3
    assert error @ np.linalg.solve(track.correction.point_covariance(before[0]), error) < 16


def test_it_is_lost_with_a_reason_where_it_is_not_seen_or_goes_elsewhere(
    found: tuple[Track, float], registered: np.ndarray
):
    track, at_s = found
    empty = soft_pair(*pair(at_s, 1, shown=False))
    for i in range(MISSES):
        assert track.state is Following.FOLLOWED
        track = followed(track, empty, seen(at_s, registered), 0.2, i)
        assert not track.consistent
    assert track.state is Following.LOST
    assert "of its outline is where it should be" in track.reason
    jumped = exp_se3(np.array((0.0, 0.03, 0.0, 0.0, 0.0, 0.0))) @ registered
    track = followed(found[0], soft_pair(*pair(at_s, 2)), seen(at_s, jumped), 0.2, 9)
    assert not track.consistent
    assert track.reason


def looked_at(tool: Instrument) -> View:
    """An instrument that is registered where it is, with colours learnt there."""
    soft = soft_pair(*pair_of(PSM.forward(joints(0)), JAW, 3, tool=tool))
    view, size = seen(0.0, T_TRUE), (CAMERA.image_height // SHRINK, CAMERA.image_width // SHRINK)
    parts = view.parts(np.eye(4))
    within = (silhouette(CAMERA, parts, eye_x, size).astype(np.float32) for eye_x in (0.0, CAMERA.baseline))
    return looking(view, soft, learnt(soft, tuple(within), False))


def known(metres: float, radians: float) -> Correction:
    """That the registration is right to so much."""
    return prior((T_TRUE @ PSM.forward(joints(0)))[:3, 3], metres, radians)


def depth_error_mm(shaft_radius: float) -> float:
    """How much too far an instrument of that radius is taken to be, which is thought to have 4.2 mm."""
    found = refined(looked_at(dataclasses.replace(TOOL, shaft_radius=shaft_radius)), known(0.003, 0.03))
    tip = apply(T_TRUE @ PSM.forward(joints(0)), TIP)
    return 1e3 * float((apply(found.correction.matrix, tip) - tip)[0, 2])


@pytest.mark.slow
def test_a_fit_farther_away_than_what_was_known_allows_is_taken_only_where_it_is_better_by_far():
    view = looked_at(TOOL)
    right = refined(view, known(0.003, 0.03))
    aside = right.correction.twist + np.array((0, 0, 0.006, 0, 0, 0))
    sure = Correction(aside, np.diag(np.repeat((0.0004, 0.006), 3) ** 2), right.correction.pivot)
    steps_m = (-0.006, 0.006)

    def depth_m(quality: float, before: Correction | None) -> float:
        beside = dataclasses.replace(
            right, correction=Correction(aside, right.correction.covariance, sure.pivot), quality=quality
        )
        return float(elsewhere(view, beside, steps_m, before).correction.twist[2])

    a_little_better, far_better = right.quality - 0.12, right.quality - 0.5
    assert depth_m(a_little_better, None) < aside[2] - 0.003
    assert depth_m(a_little_better, sure) > aside[2] - 0.002, "within five deviations of what was known"
    assert depth_m(far_better, sure) < aside[2] - 0.003


def test_depth_is_by_what_differs_between_the_eyes_and_not_by_how_thick_a_shaft_looks():
    assert abs(depth_error_mm(4.3) - depth_error_mm(4.1)) < 0.3, "by its width alone it would be four millimetres"


def test_edges_find_what_colour_cannot(registered: np.ndarray):
    """Over tissue as grey as the instrument."""
    T_base_tool = PSM.forward(joints(0))
    grey = [np.repeat(one[..., 1:2], 3, axis=2) for one in pair_of(T_base_tool, JAW, 3)]
    view = seen(0.0, registered)
    pivot = (registered @ T_base_tool)[:3, 3]
    soft = soft_pair(grey[0], grey[1])
    scores = lined(CAMERA, soft, view.parts(np.eye(4)), pivot)
    truth = twist_about(pivot, T_TRUE @ inverse(registered))
    drawn = np.repeat((0.006, 0.045), 3) * np.random.default_rng(0).standard_normal((300, 6))
    assert scores(truth[None])[0] > np.percentile(scores(drawn), 99)
    found, _ = acquired(soft, view, prior(pivot, 0.006, 0.045), np.random.default_rng(1), Begin.LINES)
    beside = found.correction.twist[:3] - truth[:3]
    assert np.linalg.norm(beside[:2]) < 1e-3
    assert abs(beside[2]) < 4 * np.sqrt(found.correction.covariance[2, 2])
