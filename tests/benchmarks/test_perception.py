"""The perception benchmark counts what is found, missed and false, and runs on a scene and on thread-free frames."""

import json
import os
import pathlib
import sys

import numpy as np
import pytest

from agents.cli.doctor.image_answers import answers_about
from benchmarks import perception
from benchmarks.centreline_share import shares
from benchmarks.perception_empty import thread_free
from benchmarks.perception_page import CROP_PX, ERROR, LARGER, PRECISION, RECALL, case_of, picture_of
from benchmarks.perception_pictures import MISSED
from benchmarks.perception_real import over
from benchmarks.scenes import scenes
from schemas.messages import Centrelines, Severity

DATA = pathlib.Path(__file__).parents[2] / "../shared/data"
ONE = np.ones


def line(points):
    count = len(points)
    return Centrelines(points, np.zeros(count, np.int64), 4 * ONE(count), 0.1 * ONE(count))


def straight(first, last, row):
    u = np.arange(first, last)
    return np.column_stack((u, np.full(len(u), float(row))))


TRUTH = np.column_stack((np.linspace(0, 100, 1001), np.full(1001, 50.0)))


def test_places_count_by_pixels_found_within_two_pixels_and_visible():
    visible = TRUTH[:, 0] < 60
    found = shares(line(np.concatenate((straight(0, 40, 51), straight(70, 80, 50)))), TRUTH, visible)
    # the last place that is found lies at 39, within 2 px of 40 and of what lies up to 40.7
    assert found.true == pytest.approx(60, abs=1)
    assert found.found == pytest.approx(41, abs=1)
    assert (found.right, found.given) == (40, 50)
    np.testing.assert_allclose(found.apart_px, 1.0)


def test_the_density_of_the_truth_does_not_weigh():
    crowded = np.sort(np.concatenate((np.linspace(0, 50, 5001), np.linspace(50, 100, 501))))
    truth = np.column_stack((crowded, np.full(len(crowded), 50.0)))
    found = shares(line(straight(0, 50, 50)), truth, ONE(len(truth), bool))
    assert found.found / found.true == pytest.approx(0.5, abs=0.03)


def test_nothing_found_is_no_recall_and_no_precision():
    none = Centrelines(np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    found = shares(none, TRUTH, ONE(len(TRUTH), bool))
    assert (found.found, found.right, found.given) == (0, 0, 0)
    assert found.true == pytest.approx(101, abs=1)


def apart(one, other):
    return np.abs(one.images[0].astype(int) - other.images[0]).mean()


@pytest.fixture(scope="module")
def without_thread():
    return list(thread_free(12, 3))


def test_thread_free_frames_differ_and_come_again(without_thread):
    first, (drawn, over_field) = without_thread, thread_free(2, 3)
    assert [one.kind for one in first] == 6 * ["drawn tissue"] + 6 * ["rendered fields"]
    assert apart(first[0], drawn) == apart(first[6], over_field) == 0
    noise = apart(first[0], first[1])
    assert noise > 0
    # another tissue, and another view of the same field, not only other noise
    assert apart(first[0], first[5]) > 3 * noise
    assert apart(first[6], first[10]) > 3 * noise


def test_a_mirrored_pair_is_still_a_stereo_pair(without_thread):
    for one in without_thread[9:11]:
        answers = answers_about(one.images, one.calibration)
        assert not [
            answer for answer in answers if answer.wrong is not None and answer.wrong.severity is Severity.FAULT
        ]


def test_a_folder_without_thread_free_scenes_is_said_to_be_one(tmp_path):
    with pytest.raises(ValueError, match="scenes render --config none"):
        list(thread_free(3, 1, [tmp_path]))


def test_a_thread_on_white_is_laid_over_another_ground_in_its_own_colour():
    image = np.full((40, 60, 3), 255, np.uint8)
    image[18:23] = 30, 20, 160
    laid, cover = over(image, np.full_like(image, 120), np.zeros(image.shape, np.float32))
    assert (laid[20] == (30, 20, 160)).all()
    assert (laid[:16] == 120).all()
    assert (cover[20] == 255).all()
    assert (cover[:16] == 0).all()
    # where thread and ground mix, nothing of the white ground is left
    assert laid[..., :2].max() == 120


def test_one_scene_is_run_with_its_goals(monkeypatch, tmp_path, capsys):
    if not DATA.is_dir() and "CI" not in os.environ:
        pytest.skip("the shared data folder is not beside this checkout")
    options = ["--data", DATA, "--only", "cfg_easy_paper", "--segmenters", "network", "--empty", "1"]
    options += ["--json", tmp_path / "figures.json", "--pictures", tmp_path]
    monkeypatch.setattr(sys, "argv", ["perception", *map(str, options)])
    perception.main()
    found = json.loads((tmp_path / "figures.json").read_text())["network"]
    (row,) = found["rows"]
    assert row["found"] / row["true"] > 0.9
    assert row["right"] / row["given"] > 0.9
    assert row["times_ms"]["near"] > 0
    assert found["thread-free"]["drawn tissue"]["frames"] == 1
    assert "centreline within 2 px, recall, worst scene" in capsys.readouterr().out
    assert (tmp_path / "network cfg_easy_paper.png").is_file()


@pytest.mark.skipif(not DATA.is_dir() and "CI" not in os.environ, reason="needs shared/data beside the checkout")
def test_each_measure_gets_a_picture_of_its_worst_place():
    load = next(load for name, _, load in scenes(DATA) if name == "crossing render sample_02")
    case = case_of(load(), "network")
    assert 0.7 < case.measures[RECALL] < 1.0
    for measure in (RECALL, PRECISION, ERROR):
        picture, said = picture_of(case, measure)
        assert picture.shape[0] == LARGER * CROP_PX[1]
        assert ("image at" in said) == (measure != ERROR)
    # what is missed is drawn beside the image as it is, not on it
    plain, drawn = np.hsplit(np.delete(picture_of(case, RECALL)[0], np.s_[-6:], axis=1), 2)
    assert (plain != MISSED).any(axis=2).all()
    assert (drawn == MISSED).all(axis=2).any()
