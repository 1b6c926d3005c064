"""The reconstruction agent: one thread for each message of observations, whatever became of it."""

import dataclasses

import numpy as np
import pytest

from agents.reconstruction.agent import Reconstruction
from agents.reconstruction.methods import METHODS
from schemas.codec import decode, encode
from schemas.messages import (
    Centrelines,
    FrameStamp,
    Image,
    ImageEncoding,
    RectifiedStereo,
    Status,
    ThreadObservations,
    ThreadReconstruction,
)
from schemas.topics import OBSERVATIONS, THREAD, key
from shared.camera import project
from shared.runtime.agent import Received, Tick

CAMERA = RectifiedStereo(640, 480, 600.0, 600.0, 319.5, 239.5, 0.005, 1.0)
MASK = Image(ImageEncoding.RAW, 640, 480, 1, bytes(640 * 480))


def centreline(curve, eye):
    """What one eye sees of a curve, a point for each pixel."""
    px = project(CAMERA, curve)[eye]
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(px, axis=0), axis=1))))
    at = np.arange(0.0, along[-1])
    px = np.column_stack([np.interp(at, along, px[:, axis]) for axis in (0, 1)])
    return Centrelines(px, np.zeros(len(px), np.int64), np.full(len(px), 3.0), np.full(len(px), 0.1))


def observations(sequence=3, status=Status.OK, points=12):
    x = np.linspace(-0.01, 0.01, points)
    curve = np.column_stack([x, 0.004 * np.sin(300 * x), 0.09 + 0.2 * x])
    return ThreadObservations(
        stamp=FrameStamp(sequence, 5, 6, "c"),
        camera=CAMERA,
        status=status,
        reason="" if status is Status.OK else "no thread was found in the left image",
        segmenter="threshold",
        points_camera=curve if status is Status.OK else np.zeros((0, 3)),
        half_size_px=np.ones((points if status is Status.OK else 0, 2)),
        matched_px=np.zeros((0, 3)),
        match_cost=np.zeros((0, 2)),
        inlier=np.zeros(0, bool),
        mask_left=MASK,
        mask_right=MASK,
        centrelines_left=centreline(curve, 0),
        centrelines_right=centreline(curve, 1),
    )


def fed(agent, message):
    outputs = list(agent.step(Received(OBSERVATIONS, key("lab", OBSERVATIONS), 0, message)))
    assert [output.topic for output in outputs] == [THREAD]
    return decode(ThreadReconstruction, encode(outputs[0].message))


@pytest.mark.parametrize("method", METHODS)
def test_observations_become_a_thread_of_the_same_frame(method):
    thread = fed(Reconstruction(method), observations())
    assert (thread.status, thread.reason) == (Status.OK, "")
    assert (thread.stamp, thread.method) == (FrameStamp(3, 5, 6, "c"), method)
    assert len(thread.regions.s) >= 8


def test_what_failed_before_it_fails_on_with_the_reason():
    thread = fed(Reconstruction(), observations(status=Status.FAILED))
    assert thread.status is Status.FAILED
    assert "no thread was found in the left image" in thread.reason


@pytest.mark.parametrize(("method", "tracking"), [("refined", False), ("paper", False), ("paper", True)])
def test_without_tracking_nothing_is_kept_from_one_message_to_the_next(method, tracking):
    agent = Reconstruction(method, tracking)
    alone = encode(METHODS[method](observations()))
    fed(agent, observations(status=Status.FAILED))
    fed(agent, dataclasses.replace(observations(), points_camera=observations().points_camera + 0.001))
    assert encode(fed(agent, observations())) == alone


def test_ticks_are_not_its_business():
    assert list(Reconstruction().step(Tick(1))) == []


def test_an_unknown_method_is_the_callers_mistake():
    with pytest.raises(KeyError):
        Reconstruction("magic")
