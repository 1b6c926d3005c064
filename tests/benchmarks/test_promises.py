"""What is possible at best is told from what plans promise, and what eyes err alike from what they err apart."""

import numpy as np
import pytest

from benchmarks.eyes_alike import off_of
from benchmarks.promises import Promise, print_bound, print_found, skill
from schemas.messages import Centrelines, RectifiedStereo
from shared.camera import project

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5e-3, 1.0)


def test_the_bound_of_a_sweep_says_what_nobody_can_promise_better(capsys):
    print_bound([0.0, 4.0], 1.5, 1)
    wide = next(line for line in capsys.readouterr().out.splitlines() if "75°" in line)
    none, most, by_size, knowing = (float(word.strip("%")) for word in wide.replace("│", " ").split()[1:])
    assert none == 100.0
    assert 40.0 < most < 50.0
    low = most / 100
    assert by_size == pytest.approx(skill(low * (1 - low) / 2, (1 + low) / 2), abs=0.002)
    assert by_size <= knowing < 1.0


def test_promises_that_come_true_on_average_have_all_the_skill_that_the_size_gives(capsys):
    found = [
        Promise("one", goal, size, rate, 0.0, (rate,) * 4)
        for goal in range(3)
        for size, rate in ((1.0, 0.9), (4.0, 0.5))
    ]
    print_found(found)
    out = capsys.readouterr().out
    assert out.count("0.1700") == 2
    assert "+0.0%" in out


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_errors_that_both_eyes_have_in_common_are_told_from_those_by_which_they_differ(sign):
    truth = np.column_stack((np.linspace(-0.02, 0.02, 4000), np.zeros(4000), np.full(4000, 0.09)))
    lines = []
    for px, up in zip(project(CAMERA, truth), (1.0, sign), strict=True):
        points = px[::4] + np.array([0.0, 0.1 * up])
        count = len(points)
        lines.append(Centrelines(points, np.zeros(count, np.int64), np.full(count, 3.0), np.full(count, 0.1)))
    off = off_of(truth, (lines[0], lines[1]), CAMERA)
    common, differing = np.abs(off.common).mean(), np.abs(off.differing).mean()
    assert (common, differing) == pytest.approx((np.sqrt(2), 0.0) if sign > 0 else (0.0, np.sqrt(2)), abs=1e-6)
    assert off.slope_deg.max() < 1e-6
