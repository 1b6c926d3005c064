"""The surface that perception tells of while frames come: of tissue alone, also where rows had to be put in line."""

import functools
from typing import Any

import cv2
import numpy as np
import pytest

from agents.camera.scene_source import calibration_of
from agents.perception import told_apart
from agents.perception.agent import Perception
from schemas.codec import decode, encode
from schemas.messages import FrameStamp, ImageEncoding, Occluder, StereoFrame
from schemas.topics import CALIBRATION, FRAMES, SURFACE, key
from shared.images import decode_image, encode_image
from shared.runtime.agent import Received, outputs_in
from shared.scene.__main__ import make_scene
from shared.scene.render import render

TOOL = slice(0, 130), slice(0, 300)
"""Rows and columns of a grey thing that reaches in from a corner, before the tissue."""
NEARER_PX = 60
"""By how much more it is displaced than the tissue."""


@functools.cache
def scene():
    drawn = make_scene("easy", "tissue", 12)
    pair = render(drawn)
    assert not pair.coverage_left[TOOL].any()
    return drawn.camera, pair


def with_tool(left, right, disparity):
    """Both images with the grey thing, and a texture on it by which it could be measured."""
    rows, columns = (part.stop for part in TOOL)
    rng = np.random.default_rng(2)
    texture = cv2.GaussianBlur(rng.uniform(40, 180, (rows, columns + disparity)), (0, 0), 2.0)
    texture = np.clip(110 + 4 * (texture - texture.mean()), 30, 190).astype(np.uint8)[..., None].repeat(3, axis=2)
    left, right = left.copy(), right.copy()
    left[TOOL], right[:rows, : columns - disparity] = texture[:, :columns], texture[:, disparity:columns]
    return left, right


def told(change=lambda left, right: (left, right)) -> Any:
    """The surface that the second of two frames brings, and what was observed in it."""
    camera, pair = scene()
    images = change(pair.left_bgr, pair.right_bgr)
    agent = Perception()
    list(agent.step(Received(CALIBRATION, key("lab", CALIBRATION), 0, calibration_of(camera))))
    outputs: list[Any] = []
    for sequence in (0, 1):
        left, right = (encode_image(image, ImageEncoding.RAW) for image in images)
        frame = StereoFrame(FrameStamp(sequence, 10**6 * sequence, 10**6 * sequence, ""), left, right)
        outputs = outputs_in(agent.step(Received(FRAMES, key("lab", FRAMES), sequence, frame)))
    found = {output.topic: decode(output.topic.message, encode(output.message)) for output in outputs}
    surface = found.pop(SURFACE)
    (observed,) = found.values()
    return surface, observed


def cells(surface, where):
    """Which cells of the grid lie well within rows and columns of the image."""
    rows, columns = where
    v, u = np.meshgrid(surface.v_px, surface.u_px, indexing="ij")
    return (v > rows.start + 12) & (v < rows.stop - 12) & (u > columns.start + 12) & (u < columns.stop - 12)


def grey_in(image):
    """A map of what has no colour: the network has learned no such instrument."""
    grey = (np.ptp(image.astype(int), axis=2) < 6).astype(np.uint8)
    closed = cv2.morphologyEx(grey, cv2.MORPH_OPEN, np.ones((15, 15), np.uint8))
    return (cv2.resize(closed, (240, 135), interpolation=cv2.INTER_NEAREST) * Occluder.TOOL.value).astype(np.uint8)


@pytest.mark.slow
def test_an_instrument_is_no_tissue_though_it_could_be_measured(monkeypatch):
    monkeypatch.setattr(told_apart, "occluders_in", grey_in)
    tool_disparity = round(scene()[0].fx_px * scene()[0].baseline / 90.0) + NEARER_PX
    surface, observed = told(lambda left, right: with_tool(left, right, tool_disparity))
    known = decode_image(observed.occluders.left)
    assert (known == Occluder.TOOL.value).mean() == pytest.approx(130 * 300 / (540 * 960), rel=0.2)
    on_tool = cells(surface, TOOL)
    assert on_tool.sum() > 20
    assert not surface.valid[on_tool].any()
    elsewhere = surface.valid[~cells(surface, (slice(-40, 170), slice(-40, 340)))]
    assert elsewhere.mean() > 0.6


@pytest.mark.slow
def test_tissue_is_measured_after_rows_were_put_in_line():
    rows, (straight, _) = 4, told()
    moved, observed = told(lambda left, right: (left, np.roll(right, rows, axis=0)))
    assert observed.rows_moved_up == rows
    both = straight.valid & moved.valid
    assert both.sum() > 0.9 * straight.valid.sum()
    assert np.median(np.abs(straight.depth[both] - moved.depth[both])) < 0.05
