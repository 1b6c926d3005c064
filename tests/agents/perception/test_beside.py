"""What is begun as a frame comes gives the same as if it had been done afterwards."""

import dataclasses

import numpy as np

from agents.camera.scene_source import calibration_of
from agents.perception.agent import Perception
from agents.perception.beside import Beside, tissue, tissue_beside
from agents.perception.rectification import rectification
from agents.perception.rectified_pair import decoded_pair, rectified_pair
from schemas.messages import FrameStamp, ImageEncoding, StereoFrame
from schemas.topics import CALIBRATION, FRAMES
from shared.images import encode_image
from shared.runtime.agent import Output, Received
from shared.scene.__main__ import make_scene
from shared.scene.render import render

STAMP = FrameStamp(3, 100_000_000, 100_000_000, "")


def test_a_disparity_counts_only_where_its_rows_were_in_line_as_they_turned_out_to_be():
    scene = make_scene("easy", "tissue", 12)
    images, calibration = render(scene), calibration_of(scene.camera)
    left, right = (encode_image(image, ImageEncoding.RAW) for image in (images.left_bgr, images.right_bgr))
    frame = StereoFrame(STAMP, left, right)
    agent = Perception()
    list(agent.step(Received(CALIBRATION, str(CALIBRATION), 0, calibration)))
    first = next(out for out in agent.step(Received(FRAMES, str(FRAMES), 0, frame)) if isinstance(out, Output))
    pair = rectified_pair(decoded_pair(frame), rectification(calibration))
    moved = dataclasses.replace(first.message, rows_moved_up=3)

    afterwards = tissue(STAMP, pair, moved, Beside())
    begun_alike, begun_otherwise = (tissue(STAMP, pair, moved, tissue_beside(pair, rows)) for rows in (3, 0))

    for surface in (begun_alike, begun_otherwise):
        np.testing.assert_array_equal(surface.depth, afterwards.depth)
        np.testing.assert_array_equal(surface.valid, afterwards.valid)
    unmoved = tissue(STAMP, pair, first.message, tissue_beside(pair, 0))
    assert (unmoved.valid != afterwards.valid).any()
