"""Suture pads and phantoms: cuts are deep and dark, and thread lies over them."""

import numpy as np
import pytest

from agents.cli.lab.scenes import endoscope
from shared.rendering.path_traced.pad import Cut, carve, lens_cover, pad_ground, phantom_ground

RIG = endoscope(160, 90)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("drawn", [pad_ground, phantom_ground])
def test_thread_lies_on_a_pad_nowhere_behind_its_surface(drawn, seed):
    ground, again = (drawn(RIG.widest, 90.0, np.random.default_rng(seed)) for _ in range(2))
    assert (ground.bed.depth_mm <= ground.surface.depth_mm + 0.1).all()
    assert ground.albedo.min() >= 0.004 and ground.albedo.max() <= 0.9
    np.testing.assert_array_equal(again.albedo, ground.albedo)
    np.testing.assert_array_equal(again.surface.depth_mm, ground.surface.depth_mm)


def test_a_cut_is_as_wide_as_it_is_told_and_deeper_and_darker_towards_its_middle():
    line = np.column_stack((np.linspace(20.0, 180.0, 60), np.full(60, 50.0)))
    cover = lens_cover((100, 200), [line], 12.0, 0.5)
    assert cover[:, 100].sum() == pytest.approx(13.0, abs=1.0)
    assert cover[:, 30].sum() < cover[:, 100].sum()
    flat, white = np.full((100, 200), 80.0, np.float32), np.full((100, 200, 3), 0.5, np.float32)
    depth, albedo, within = carve(Cut([line], 2.0, 1.5, (0.04, 0.02, 0.02)), flat, white, 6.0, 0.5)
    assert depth[50, 100] - 80.0 == pytest.approx(1.5, abs=0.2)
    assert depth[50, 100] > depth[46, 100] > depth[20, 100] == 80.0
    assert albedo[50, 100].max() < 0.05 < albedo[20, 100].max() == 0.5
    assert within[50, 100] == 1.0 and within[20, 100] == 0.0
