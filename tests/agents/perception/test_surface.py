"""What is told beside the thread: the tissue, against the depth that the renderer drew it at, and the needle."""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from agents.camera.scene_source import calibration_of
from agents.perception import instances
from agents.perception.agent import Perception, PerceptionConfig
from agents.perception.needle import needle_region
from agents.perception.surface import tissue_surface
from schemas.codec import decode, encode
from schemas.messages import FrameStamp, Occluder, TissueSurface
from schemas.topics import CALIBRATION, FRAMES, NEEDLE_SEEN, OBSERVATIONS, SURFACE, topic_of
from shared.images import decode_image
from shared.recording.mcap_file import read_recording
from shared.rendering.render import ENDOSCOPE, render_backdrop
from shared.runtime.agent import outputs_in
from tests.agents.perception.pictures import agent_with, frame_of, rendered, rendered_pair, replies

STAMP = FrameStamp(4, 5, 6, "made up")
SHAPE = 270, 480
SMALL = dataclasses.replace(ENDOSCOPE, image_width=SHAPE[1], image_height=SHAPE[0])
NOTHING = np.zeros(SHAPE, bool)


@functools.cache
def measured(config, seed) -> Any:
    """A scene's surface, where its thread is, and by how much each valid cell is off, with its deviation and place."""
    camera, pair = rendered(config, seed)
    thread = pair.coverage_left > 0
    surface: Any = tissue_surface(STAMP, camera, pair.left_bgr, pair.right_bgr, thread)
    surface = decode(TissueSurface, encode(surface))
    behind = render_backdrop(camera, "tissue", 95.0, seed)
    v, u = np.nonzero(surface.valid)
    at = np.round(surface.v_px[v]).astype(int), np.round(surface.u_px[u]).astype(int)
    return surface, thread, np.abs(surface.depth[v, u] - behind.depth_left_mm[at]), surface.deviation[v, u], at


@pytest.mark.slow
@pytest.mark.parametrize(("config", "seed"), [("easy", 12), ("medium", 32)])
def test_tissue_is_measured_to_a_millimetre_where_it_is_valid(config, seed):
    surface, thread, error, _, at = measured(config, seed)
    assert surface.valid.mean() > 0.7
    assert np.median(error) < 0.3
    assert np.percentile(error, 95) < 1.0
    # the thread does not stand out of the tissue
    beside = np.array([thread[r - 15 : r + 16, c - 15 : c + 16].any() for r, c in zip(*at, strict=True)])
    assert beside.sum() > 20
    assert np.percentile(error[beside], 90) < 1.5
    # the grid covers the image
    for middles, size in ((surface.u_px, thread.shape[1]), (surface.v_px, thread.shape[0])):
        step = np.diff(middles)[0]
        np.testing.assert_allclose(middles[0] + 0.5, step / 2)
        assert size - step < middles[-1] + step / 2 + 0.5 <= size


@pytest.mark.slow
def test_errors_are_as_large_as_they_are_stated():
    scenes = measured("easy", 12), measured("medium", 32)
    stated = np.concatenate([error / deviation for _, _, error, deviation, _ in scenes])
    assert 0.6 < (stated < 1).mean() < 0.75
    assert 0.93 < (stated < 2).mean() < 0.98
    assert (stated < 3).mean() > 0.985


def shifted_noise(disparity):
    """A textured plane that faces both eyes, at a disparity that need not be whole."""
    wide = cv2.GaussianBlur(np.random.default_rng(3).uniform(0, 255, (SHAPE[0], SHAPE[1] + 200)), (0, 0), 2.0)
    wide = (wide - wide.mean()) / wide.std() * 40 + 128
    eyes = [
        cv2.warpAffine(wide, np.array([[1.0, 0.0, -100.0 - by], [0.0, 1.0, 0.0]]), SHAPE[::-1])
        for by in (0.0, disparity)
    ]
    return [np.clip(np.rint(eye), 0, 255).astype(np.uint8)[..., None].repeat(3, axis=2) for eye in eyes]


@pytest.mark.parametrize("disparity", [20.0, 20.5, 41.3])
def test_no_disparity_is_drawn_to_a_whole_one(disparity):
    left, right = shifted_noise(disparity)
    surface = tissue_surface(STAMP, SMALL, left, right, NOTHING)
    found = SMALL.fx_px * SMALL.baseline / surface.depth[surface.valid]
    assert surface.valid.mean() > 0.8
    assert abs(np.median(found) - disparity) < 0.04


def test_a_plain_ground_is_nowhere_valid():
    plain = np.full((*SHAPE, 3), 128, np.uint8)
    surface = tissue_surface(STAMP, SMALL, plain, plain, NOTHING)
    assert surface.valid.mean() < 0.05
    assert (surface.depth[~surface.valid] == 0).all()


@pytest.mark.parametrize("shape", [(1, 1), (5, 200), (64, 64)])
def test_images_of_any_size_give_a_surface(shape):
    small = dataclasses.replace(ENDOSCOPE, image_width=shape[1], image_height=shape[0])
    image = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
    surface = tissue_surface(STAMP, small, image, image, np.zeros(shape, bool))
    assert decode(TissueSurface, encode(surface)).depth.shape == surface.valid.shape


TOOL_ROWS, TOOL_COLUMNS = 130, 300
"""Of a grey thing that reaches in from a corner, before the tissue."""


def with_tool(images, disparity):
    """Both images with the grey thing, and a texture on it by which it could be measured."""
    texture = np.random.default_rng(2).uniform(40, 180, (TOOL_ROWS, TOOL_COLUMNS + disparity))
    texture = cv2.GaussianBlur(texture, (0, 0), 2.0)
    texture = np.clip(110 + 4 * (texture - texture.mean()), 30, 190).astype(np.uint8)[..., None].repeat(3, axis=2)
    left, right = (image.copy() for image in images)
    left[:TOOL_ROWS, :TOOL_COLUMNS] = texture[:, :TOOL_COLUMNS]
    right[:TOOL_ROWS, : TOOL_COLUMNS - disparity] = texture[:, disparity:TOOL_COLUMNS]
    return left, right


def told(images) -> Any:
    """The surface that the second of two frames brings, and what was observed in it."""
    agent = agent_with(calibration_of(ENDOSCOPE))
    outputs = [outputs_in(replies(agent, frame_of(images, sequence))) for sequence in (0, 1)]
    found = {output.topic: decode(output.topic.message, encode(output.message)) for output in outputs[1]}
    assert found.keys() == {SURFACE, OBSERVATIONS}
    return found[SURFACE], found[OBSERVATIONS]


def grey_in(image):
    """A map of what has no colour: the network has learned no such instrument."""
    grey = (np.ptp(image.astype(int), axis=2) < 6).astype(np.uint8)
    closed = cv2.morphologyEx(grey, cv2.MORPH_OPEN, np.ones((15, 15), np.uint8))
    return (cv2.resize(closed, (240, 135), interpolation=cv2.INTER_NEAREST) * Occluder.TOOL.value).astype(np.uint8)


@pytest.mark.slow
def test_an_instrument_is_no_tissue_though_it_could_be_measured(monkeypatch):
    monkeypatch.setattr(instances, "occluders_in", grey_in)
    tissue_px = round(ENDOSCOPE.fx_px * ENDOSCOPE.baseline / 90.0)
    surface, observed = told(with_tool(rendered_pair(), tissue_px + 60))
    known = decode_image(observed.occluders.left)
    assert (known == Occluder.TOOL.value).mean() == pytest.approx(TOOL_ROWS * TOOL_COLUMNS / (540 * 960), rel=0.2)

    def within(beside_px):
        """Which cells lie within so many pixels of the grey thing."""
        return np.ix_(surface.v_px < TOOL_ROWS + beside_px, surface.u_px < TOOL_COLUMNS + beside_px)

    assert surface.valid[within(-12)].size > 20
    assert not surface.valid[within(-12)].any()
    elsewhere = np.ones_like(surface.valid)
    elsewhere[within(28)] = False
    assert surface.valid[elsewhere].mean() > 0.6


TISSUE = Path(__file__).parents[2] / "goldens" / "tissue.mcap"


def test_a_needle_is_looked_for_around_where_a_small_copy_shows_one_and_around_the_ends_of_the_thread():
    occluders = np.zeros((135, 240), np.uint8)
    occluders[20, 30], occluders[100, 200] = Occluder.NEEDLE.value, Occluder.TOOL.value
    where = needle_region((540, 960), occluders, np.array([[900.0, 80.0], [-5.0, 600.0]]))
    at = [(80, 120), (80, 900), (530, 10), (400, 800), (300, 480)]
    assert [bool(where[row, column]) for row, column in at] == [True, True, True, False, False]


@pytest.mark.parametrize("needle", [False, True])
def test_lines_of_a_needle_are_told_where_an_agent_wants_them(needle):
    perception, entries = Perception(PerceptionConfig(needle=needle)), read_recording(TISSUE)
    fed = [decode(topic_of(e.key).message, e.payload) for e in entries if topic_of(e.key) in (CALIBRATION, FRAMES)]
    told = [o.message for each in fed for o in outputs_in(replies(perception, each)) if o.topic is NEEDLE_SEEN]
    assert bool(told) is needle
    for seen in told:
        # there is none, and what is there is thread
        assert len(seen.left.lines.point_px) > 100
        assert seen.left.needle.mean() < 0.1
