"""Lines of known scenes are told from thread, and the fit says how it does on others."""

import re
import sys

import cv2
import numpy as np
import pytest

from agents.perception.training import line_odds
from tests.agents.perception.segmentation.test_network import scene

pytestmark = pytest.mark.renders


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    made = []
    for name, scenes in {
        "fitted": [("medium", "black", 7032), ("crossing", "green", 7034)],
        "judged": [("hard", "violet", 7035)],
    }.items():
        folder = tmp_path_factory.mktemp(name)
        for config, colour, seed in scenes:
            pair = scene(config, colour, seed)
            cv2.imwrite(str(folder / f"{config}_left.png"), pair.left_bgr)
            cv2.imwrite(str(folder / f"{config}_mask_left.png"), pair.coverage_left)
        made.append(folder)
    # what shows less than thread does, and is none
    pair = scene("easy", "white", 7036)
    cv2.imwrite(str(made[0] / "faint_left.png"), cv2.GaussianBlur(pair.left_bgr, (0, 0), 3))
    cv2.imwrite(str(made[0] / "faint_mask_left.png"), np.zeros_like(pair.coverage_left))
    return made


def test_the_fit_tells_thread_by_its_score_and_says_how_it_does_on_other_scenes(folders, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["line_odds", "--scenes", str(folders[0]), "--judged", str(folders[1])])
    line_odds.main()
    printed = capsys.readouterr().out
    (weights,) = re.findall(r"\[(.*)\]", printed)
    of_ground, *others = (float(each) for each in weights.split(","))
    assert of_ground > 0
    assert len(others) == len(line_odds.WEIGHTS) - 1
    ((said, thread),) = re.findall(r"0\.9 to 1\.0: .* said (\S+), thread (\S+)", printed)
    assert float(said) > 0.9
    assert float(thread) > 0.9
