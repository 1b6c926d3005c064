"""An arm from its table: the PSM's own table, and that of an arm that is quite another."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from shared.kinematics.arm import Problem
from shared.kinematics.dh import DhArm
from shared.kinematics.dh_file import read_dh
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER, forward
from shared.rigid_transforms import transform

FILE = Path(__file__).parents[3] / "deploy" / "generic_arm.toml"
TOLD = tomllib.loads(FILE.read_text())
ARM, START = read_dh(TOLD), np.array(TOLD["start"])
PSM = DhArm(
    LARGE_NEEDLE_DRIVER.links,
    transform(np.array(LARGE_NEEDLE_DRIVER.R_wrist_tool, float), np.zeros(3)),
    LARGE_NEEDLE_DRIVER.jaw_limit,
    LARGE_NEEDLE_DRIVER.jaw_max_speed,
    0.1,
)
PSM_START = np.array((0.18, 0.04, 0.132, 0.0, 0.3, 0.2))


@pytest.mark.parametrize(("arm", "start"), [(ARM, START), (PSM, PSM_START)])
def test_joints_along_a_way_are_found_again_in_the_posture_that_the_arm_has(arm, start):
    way = start + np.linspace(0, 1, 100)[:, None] * np.array((0.2, 0.1, -0.05, 0.3, -0.2, 0.3))
    found = arm.follow(arm.forward(way), start)
    assert not found.problem.any()
    assert np.abs(found.joints - way).max() < 1e-7


def test_the_table_of_the_psm_is_the_psm():
    lower, upper = LARGE_NEEDLE_DRIVER.limits.T
    joints = np.random.default_rng(1).uniform(lower, upper, (50, 6))
    assert np.abs(PSM.forward(joints) - forward(joints)).max() < 1e-12
    shaft_m = PSM_START[2] + LARGE_NEEDLE_DRIVER.shaft_offset
    bent = np.stack([PSM_START] * 2)
    bent[1, 4] = np.arccos(-LARGE_NEEDLE_DRIVER.links[5].a / shaft_m)
    for arm in (PSM, LARGE_NEEDLE_DRIVER):
        well, singular = arm.dexterity(bent)
        assert singular < 1e-7 < 0.5 < well


@pytest.mark.slow
def test_poses_by_themselves_are_reached_and_what_no_joints_reach_is_refused():
    joints = np.random.default_rng(2).uniform(0.8 * ARM.limits[:, 0], 0.8 * ARM.limits[:, 1], (8, 6))
    found = ARM.reach(ARM.forward(joints))
    solved = found.problem == Problem.NONE
    assert solved.sum() >= 7
    assert np.abs(ARM.forward(found.joints[solved]) - ARM.forward(joints)[solved]).max() < 1e-8
    far, sheared, broken = (ARM.forward(START) for _ in range(3))
    far[0, 3], sheared[0, 0], broken[1, 3] = 5.0, 2.0, np.nan
    problems = ARM.reach(np.stack((far, sheared, broken))).problem
    assert list(problems) == [Problem.WRIST_FOLDED, Problem.NO_ROTATION, Problem.NOT_FINITE]
    followed = ARM.follow(np.stack((ARM.forward(START), far)), START)
    assert list(followed.problem) == [Problem.NONE, Problem.WRIST_FOLDED]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"joints": TOLD["joints"][:5]}, "5 joints"),
        ({"jaw": {}}, "limit"),
        ({"T_last_tool": [[2, 0, 0, 0]] * 4}, "T_last_tool"),
        ({"length_m": 0}, "length_m"),
    ],
)
def test_a_file_that_describes_no_arm_is_refused_by_name(change, words):
    with pytest.raises(ValueError, match=words):
        read_dh(TOLD | change)
