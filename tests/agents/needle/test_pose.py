"""Needles that are drawn as lines: where they are found, and what is said where they cannot be."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.needle import NeedleConfig
from agents.needle.agent import Needle
from agents.needle.pose import NO_NEEDLE, NO_UNIT, TOO_LITTLE, needle_pose
from schemas.codec import encode
from schemas.messages import (
    Centrelines,
    FrameStamp,
    ImageEncoding,
    NeedleObservations,
    NeedleView,
    RectifiedStereo,
    Status,
    no_centrelines,
)
from schemas.topics import NEEDLE, NEEDLE_SEEN
from shared.camera import project
from shared.images import encode_image
from shared.rigid_transforms import exp_so3
from shared.runtime.agent import Received

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)
RADIUS_MM = 7.0


@dataclasses.dataclass
class Drawn:
    """A needle of half a circle with some thread, in the camera frame, in mm, turned about the axes in turn."""

    by: tuple[float, float, float]
    arc_rad: float = np.pi

    @property
    def turn(self):
        return np.linalg.multi_dot(exp_so3(np.diag(self.by)))

    @property
    def needle(self):
        angle = np.linspace(0.0, self.arc_rad, 400)
        return self.placed(RADIUS_MM * np.column_stack((np.cos(angle), np.sin(angle), np.zeros(400))))

    @property
    def thread(self):
        """It leaves the needle in its direction, and bends the other way."""
        s = np.linspace(0.0, 12.0, 200)[1:]
        return self.placed(np.column_stack((RADIUS_MM + s**2 / 16.0, -s, s**2 / 40.0)))

    def placed(self, points):
        return points @ self.turn.T + (2.0, -1.0, 95.0)

    def observed(self, hidden_px=0.0, seed=1):
        """What both eyes see of it; all within so many pixels of its point is hidden by an instrument."""
        rng = np.random.default_rng(seed)
        left, right = (self.view(eye, hidden_px, rng) for eye in (0, 1))
        return NeedleObservations(FrameStamp(3, 1, 1, "c"), CAMERA, left, right)

    def view(self, eye, hidden_px, rng):
        thread, needle = (project(CAMERA, points)[eye] for points in (self.thread[::-1], self.needle))
        line, is_needle = evenly(np.vstack((thread, needle))), np.ones(len(evenly(needle)), bool)
        is_needle = np.append(np.zeros(len(line) - len(is_needle), bool), is_needle)
        shown = np.linalg.norm(line - needle[-1], axis=1) >= hidden_px
        line, is_needle = line[shown], is_needle[shown]
        v, u = np.mgrid[:135, :240]
        hides = np.hypot(4 * u - needle[-1, 0], 4 * v - needle[-1, 1]) < hidden_px + 8
        instruments = encode_image((hides & (hidden_px > 0)).astype(np.uint8), ImageEncoding.PNG)
        point_px, count = line + rng.normal(0.0, 0.2, line.shape), len(line)
        width_px = np.where(is_needle, 8.0, 3.0) + rng.normal(0.0, 0.1, count)
        lines = Centrelines(point_px, np.zeros(count, np.int64), width_px, np.full(count, 0.2))
        colour = np.where(is_needle[:, None], (190, 190, 190), (120, 40, 90)).astype(np.uint8)
        return NeedleView(lines, np.where(is_needle, 0.9, 0.02), colour, instruments)


def evenly(px):
    """Points of a line a pixel apart."""
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(px, axis=0), axis=1))]
    return np.column_stack([np.interp(np.arange(0.0, length[-1]), length, axis) for axis in px.T])


def errors(pose, drawn):
    """Of swage and point in mm, and of the plane in degrees."""
    swage, point = pose.at(np.array([0.0, pose.arc_rad]))
    plane = np.degrees(np.arccos(min(1.0, abs(drawn.turn[:, 2] @ pose.T_camera_needle[:3, 2]))))
    return np.linalg.norm(swage - drawn.needle[0]), np.linalg.norm(point - drawn.needle[-1]), plane


@settings(max_examples=6, deadline=None)
@given(st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(-3.1, 3.1)))
def test_a_needle_in_view_is_found_wherever_it_lies_and_its_swage_told_from_its_point(by):
    drawn = Drawn(by)
    pose = needle_pose(drawn.observed())
    assert pose.status is Status.OK, pose.reason
    assert (errors(pose, drawn) < np.array((0.6, 1.0, 4.0))).all()
    assert pose.ends_seen.all()
    assert pose.radius == pytest.approx(RADIUS_MM, rel=0.05)


def test_a_point_behind_an_instrument_is_told_with_what_that_leaves_open():
    drawn = Drawn((0.3, 0.1, 0.5))
    shown, hidden = (needle_pose(drawn.observed(px)) for px in (0.0, 40.0))
    assert (shown.ends_seen.tolist(), hidden.ends_seen.tolist()) == ([True, True], [True, False])
    deviations = [np.sqrt(np.trace(pose.covariance_at(pose.arc_rad))) for pose in (shown, hidden)]
    assert deviations[1] > 2.0 > deviations[0]
    # who says how long the needle is knows where it ends, seen or not, and so does who saw it before
    for told in (needle_pose(drawn.observed(40.0), arc_deg=180.0), needle_pose(drawn.observed(40.0), last=shown)):
        assert errors(told, drawn)[1] < 1.0


def test_what_cannot_be_known_is_refused_with_its_reason():
    drawn = Drawn((0.2, -0.2, 1.0))
    observed = drawn.observed()
    unitless = dataclasses.replace(CAMERA, metres_per_unit=None)
    nothing = NeedleView(no_centrelines(), np.zeros(0), np.zeros((0, 3), np.uint8), observed.left.instruments)
    thread = dataclasses.replace(observed.left, needle=np.zeros(len(observed.left.needle)))
    for seen, reason in (
        (dataclasses.replace(observed, camera=unitless), NO_UNIT),
        (dataclasses.replace(observed, right=nothing), NO_NEEDLE),
        (dataclasses.replace(observed, left=thread, right=thread), NO_NEEDLE),
        (Drawn(drawn.by, arc_rad=1.6).observed(), TOO_LITTLE),
    ):
        pose = needle_pose(seen)
        assert (pose.status, pose.reason, pose.T_camera_needle) == (Status.FAILED, reason, None)


def test_the_agent_says_the_same_again_and_goes_on_from_its_last_pose_alone():
    drawn, live, replayed = Drawn((0.3, 0.1, 0.5)), Needle(), Needle()
    first, second = drawn.observed(seed=1), drawn.observed(40.0, seed=2)
    poses = [output.message for seen in (first, second) for output in live.step(Received(NEEDLE_SEEN, "", 0, seen))]
    assert list(replayed.step(Received(NEEDLE, "", 0, poses[0]))) == []
    (again,) = replayed.step(Received(NEEDLE_SEEN, "", 1, second))
    assert encode(again.message) == encode(poses[1])
    (alone,) = Needle(NeedleConfig(radius_mm=RADIUS_MM)).step(Received(NEEDLE_SEEN, "", 0, second))
    assert encode(alone.message) != encode(poses[1])
