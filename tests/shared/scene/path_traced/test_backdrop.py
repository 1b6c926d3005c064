"""A traced field lies on disk as the light renderer takes it; needs the extra `sim`."""

import cv2
import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.scene.backdrop_files import read_backdrop, write_backdrop
from shared.scene.path_traced.backdrop import traced_backdrop

pytest.importorskip("mitsuba", reason="path tracing needs the extra sim: make sim")
pytestmark = pytest.mark.renders


@pytest.mark.parametrize("seed", [3, 2**32 + 3], ids=["a small seed", "more than Mitsuba takes"])
def test_its_depth_carries_the_left_image_into_the_right_one(tmp_path, seed):
    rig = endoscope(320, 180)
    write_backdrop(tmp_path, rig.near_enough, traced_backdrop("paper", seed, rig, 2), {"seed": seed})
    field = read_backdrop(tmp_path, rig.near_enough)
    v, u = np.indices((180, 320), dtype=np.float32)
    disparity = rig.near_enough.fx_px * rig.baseline_mm / field.depth_left_mm
    carried = cv2.remap(field.right_bgr, (u - disparity).astype(np.float32), v, cv2.INTER_LINEAR)
    inner = (slice(10, -10), slice(40, -10))
    grey = [image[inner].mean(axis=2).ravel() for image in (field.left_bgr, carried)]
    assert np.corrcoef(grey)[0, 1] > 0.97
    asis = field.right_bgr[inner].mean(axis=2).ravel()
    assert np.corrcoef(grey[0], asis)[0, 1] < 0.9
