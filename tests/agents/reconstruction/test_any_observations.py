"""Every valid message of observations ends as a status.

Places come from the image and from disparities, as perception's do, and from anywhere else.
"""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agents.reconstruction.paper import reconstruct_paper
from shared.camera import backproject

PIXELS = st.tuples(st.floats(0, 960), st.floats(0, 540))
DISPARITIES_PX = st.integers(1, 120).map(float) | st.floats(0.01, 900)


@st.composite
def wanderings(draw, camera):
    """Random walks over the image, with repeats, jumps in depth and turns."""
    count = draw(st.integers(2, 60))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    step = draw(st.sampled_from((0.0, 0.1, 2.0, 10.0, 200.0)))
    walk = np.cumsum(rng.normal(0, step, (count, 2)), axis=0)
    px = np.clip(walk + np.array([480, 270]), 0, [960, 540])
    disparity_px = np.maximum(60 + np.cumsum(rng.normal(0, draw(st.sampled_from((0.0, 0.3, 5.0))), count)), 1)
    jumps = rng.random(count) < draw(st.sampled_from((0.0, 0.1, 0.5)))
    disparity_px = np.where(jumps, rng.uniform(1, 120, count), disparity_px)
    if draw(st.booleans()):
        disparity_px = np.round(disparity_px)
    index = np.arange(count)
    if draw(st.booleans()):
        index = np.sort(rng.integers(0, count, count))
    elif draw(st.booleans()):
        index = rng.permutation(count)
    return backproject(camera, px, camera.fx_px * camera.baseline / disparity_px)[index]


@st.composite
def lines(draw, camera):
    """Two places and evenly many between them: along the rows, along the line of sight, or across."""
    ends = np.array([draw(PIXELS), draw(PIXELS)])
    disparity_px = np.array([draw(DISPARITIES_PX), draw(DISPARITIES_PX)])
    along = draw(st.lists(st.sampled_from((0.0, 0.25, 0.5, 1.0)) | st.floats(0, 1), min_size=2, max_size=30))
    ends_camera = backproject(camera, ends, camera.fx_px * camera.baseline / disparity_px)
    return ends_camera[0] + np.array(along)[:, None] * (ends_camera[1] - ends_camera[0])


def anywhere():
    places = st.floats(-1e270, 1e270) | st.floats(-100, 100)
    depths = st.floats(1e-270, 1e270) | st.floats(1, 1000)
    return st.integers(0, 12).flatmap(
        lambda n: st.tuples(arrays(float, (n, 2), elements=places), arrays(float, n, elements=depths)).map(
            np.column_stack
        )
    )


@pytest.mark.slow
@given(data=st.data())
@settings(max_examples=40)
def test_any_observations_end_as_a_status(camera, observe, check_sound, data):
    points = data.draw(wanderings(camera) | lines(camera) | anywhere())
    n = len(points)
    scale = data.draw(st.sampled_from((1.0, 1.0, 1e-3, 1e3, 1e-25, 1e25)))
    unit = data.draw(st.sampled_from((None, 1e-3, 1.0, 1e-300, 1e300)))
    half_size_px = data.draw(st.sampled_from((2.0, 7.5, 1e-300, 1e300)))
    gaps = np.sort(
        np.array(data.draw(st.lists(st.integers(0, max(n - 2, 0)), max_size=min(3, max(n - 1, 0)))), np.int64)
    )
    other = dataclasses.replace(camera, baseline=camera.baseline * scale, metres_per_unit=unit)
    observations = observe(points * scale, other, half_size_px, gaps=gaps)
    check_sound(reconstruct_paper(observations), observations)
