"""The check of a pair's truth sees by how much a mask lies aside, and looks only where its middle means something."""

import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.scene.path_traced.pair import offset_from_truth

EYE = endoscope(320, 180).eyes[0]
RADIUS_MM, DEPTH_MM = 0.4, 80.0
HALF_PX = EYE.focal_px * RADIUS_MM / DEPTH_MM
SLANT = np.radians(25.0)


def line(offset_px=0.0, cross=False):
    """A strand across the image at a slant, and the share of each pixel that one so far aside of it covers."""
    along, across = np.array([np.cos(SLANT), np.sin(SLANT)]), np.array([-np.sin(SLANT), np.cos(SLANT)])
    middle = EYE.K[:2, 2]
    v, u = np.indices((180, 320))
    away = (np.dstack((u, v)) - middle) @ across
    cover = np.clip(HALF_PX + 0.5 - np.abs(away - offset_px), 0.0, 1.0)
    if cross:
        cover = np.maximum(cover, np.abs(u - middle[0]) < HALF_PX)
    pixels = middle + np.arange(-120.0, 120.0, 0.5)[:, None] * along
    points = np.column_stack(((pixels - middle) / EYE.focal_px * DEPTH_MM, np.full(len(pixels), DEPTH_MM)))
    return cover.astype(np.float32), points


@pytest.mark.parametrize("offset_px", [0.05, -0.3])
def test_a_mask_beside_its_truth_is_seen_to_be_so_to_a_hundredth_of_a_pixel_on_average(offset_px):
    cover, points = line(offset_px)
    found = offset_from_truth(cover, EYE, points, np.ones(len(points), bool), RADIUS_MM + 0.5)
    assert len(found) > 150
    assert found.mean() == pytest.approx(offset_px, abs=0.01)
    assert np.abs(found - offset_px).max() < 0.06


def test_nothing_is_said_beside_another_strand_of_a_few_pixels_or_where_the_thread_is_not_seen():
    cover, points = line(cross=True)
    seen = np.ones(len(points), bool)
    found = offset_from_truth(cover, EYE, points, seen, RADIUS_MM)
    clear = offset_from_truth(line()[0], EYE, points, seen, RADIUS_MM)
    assert 0.5 * len(clear) < len(found) < 0.95 * len(clear)
    assert np.abs(found).max() < 0.06
    seen[: len(seen) // 2] = False
    half = offset_from_truth(line()[0], EYE, points, seen, RADIUS_MM)
    assert 0.3 * len(clear) < len(half) < 0.6 * len(clear)
    short = points[:20]
    assert len(offset_from_truth(cover, EYE, short, np.ones(len(short), bool), RADIUS_MM)) == 0
