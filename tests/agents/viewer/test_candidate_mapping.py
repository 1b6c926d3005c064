"""What perception tells apart lies where it was seen, each kind in its own colour, and the verdict says it in words."""

import dataclasses
from typing import Any

import cv2
import numpy as np
import pytest

from agents.viewer import colours
from agents.viewer.live_mapping import LiveMapping
from agents.viewer.seen_mapping import candidate_entities, occluder_entities, score_entities, verdict
from schemas.messages import (
    Centrelines,
    ImageEncoding,
    Judgement,
    Occluder,
    Occluders,
    RightEye,
    Severity,
    Status,
    ThreadCandidate,
)
from shared.images import encode_image

PLACES = {Occluder.TOOL: 10, Occluder.NEEDLE: 30, Occluder.UNKNOWN: 50}
"""Rows of a map of 54 by 96 in which each kind begins, and goes on for eight."""
ROWS_DOWN = 20
LOWER = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, ROWS_DOWN]])


@pytest.fixture
def observations(scene):
    """Two threads, and each kind of occluder in the left image and in the right one."""
    kinds = np.zeros((60, 96), np.uint8)
    for kind, row in PLACES.items():
        kinds[row : row + 8, 20:40] = kind.value
    image = encode_image(kinds, ImageEncoding.PNG)
    thread = ThreadCandidate(
        0.9, np.array([[5.0, 5.0], [9.0, 7.0]]), np.array([[3.0, 5.0], [7.0, 7.0]]), 4.0, np.array([20, 30, 40])
    )
    other = dataclasses.replace(thread, score=0.25)
    return dataclasses.replace(scene.observations, candidates=(thread, other), occluders=Occluders(image, image, 0))


def drawn(entity) -> np.ndarray:
    (shown,) = entity
    blob = np.array(shown.blob.as_arrow_array().to_pylist()[0], np.uint8)
    return np.asarray(cv2.imdecode(blob, cv2.IMREAD_UNCHANGED))


def lines(entity) -> Any:
    (shown,) = entity
    return np.array(shown.strips.as_arrow_array().to_pylist())


def test_the_threads_of_a_right_image_that_was_moved_lie_where_it_shows_them(observations):
    shown = dict(candidate_entities(observations, LOWER))
    left, right = lines(shown["world/left/candidates"]), lines(shown["world/right/candidates"])
    np.testing.assert_allclose(left[0], [[5.5, 5.5], [9.5, 7.5]])
    np.testing.assert_allclose(right - left, np.broadcast_to([-2.0, ROWS_DOWN], left.shape))


def test_each_kind_of_what_may_hide_thread_has_its_colour_where_it_lies(observations):
    shown = dict(occluder_entities(observations, LOWER))
    height, width = observations.camera.image_height, observations.camera.image_width
    for side, down in (("left", 0), ("right", ROWS_DOWN)):
        image = drawn(shown[f"world/{side}/occluders"])
        assert image.shape == (height, width, 4)
        for kind, row in PLACES.items():
            v, u = round((row + 4) * height / 60) + down, round(30 * width / 96)
            if v < height:
                assert tuple(image[v, u, :3][::-1]) == colours.OCCLUDERS[kind]
        first = np.flatnonzero(image[:, round(30 * width / 96), 3])[0]
        assert first == pytest.approx(10 * height / 60 + down, abs=2)


def test_the_verdict_says_what_is_wrong_what_to_do_which_threads_there_are_and_how_the_eyes_lie(observations):
    def said(**changed):
        return verdict(dataclasses.replace(observations, **changed))

    wrong = said(judgements=(Judgement("blurred", Severity.WARNING, "the left image is out of focus", "focus"),))
    assert "WARNING blurred: the left image is out of focus" in wrong
    assert "Remedy: focus" in wrong
    assert "Thread 1 (meant): score 0.90" in wrong
    assert "Thread 2: score 0.25" in wrong
    right = said(judgements=(), occluders=None)
    assert "Nothing is wrong with the images." in right
    assert "nobody looked, or the ground is of one colour" in right
    assert "put in line" not in right
    assert "disparities of" not in right
    failed = said(status=Status.FAILED, reason="no thread was found in the left image")
    assert "No thread:** no thread was found in the left image" in failed
    turned = said(right_eye=RightEye(-2.4, -0.147, 0.9997), disparities_px=np.array([192.4, 575.1]))
    assert "put in line: -2.40 px lower, turned by -0.147 degrees" in turned
    assert "disparities of 192 to 575 px" in turned


def test_a_running_session_shows_threads_what_hides_them_the_score_and_the_verdict(observations):
    score = encode_image(np.full((54, 96), 200, np.uint8), ImageEncoding.JPEG)
    session = LiveMapping()
    shown: dict[str, Any] = dict(session.entities(dataclasses.replace(observations, score_map=score)))
    expected = dict(candidate_entities(observations)) | dict(occluder_entities(observations))
    np.testing.assert_array_equal(lines(shown["world/left/candidates"]), lines(expected["world/left/candidates"]))
    np.testing.assert_array_equal(drawn(shown["world/right/occluders"]), drawn(expected["world/right/occluders"]))
    ((score_shown,), (words,)) = shown["perception/score"], shown["perception/verdict"]
    assert bytes(score_shown.blob.as_arrow_array().to_pylist()[0]) == score.data
    assert "Thread 1 (meant): score 0.90" in words.text.as_arrow_array().to_pylist()[0]
    later: dict[str, Any] = dict(session.entities(dataclasses.replace(observations, candidates=())))
    assert lines(later["world/left/candidates"]).size == 0
    assert "perception/score" not in later, "the last one stands"


def test_each_piece_of_thread_shows_its_log_odds_on_the_score(observations):
    width, height = observations.camera.image_width, observations.camera.image_height
    score = np.full((54, 96), 200, np.uint8)
    score[:, 48:] = 40
    along = np.concatenate([np.linspace(0.1, 0.4, 20), np.linspace(0.6, 0.9, 20)])
    point = np.column_stack((along * width, np.full(40, 0.5 * height)))
    lines = Centrelines(point, np.repeat([0, 1], 20), np.full(40, 3.0), np.full(40, 0.1))
    message = dataclasses.replace(
        observations, score_map=encode_image(score, ImageEncoding.PNG), centrelines_left=lines
    )
    shown: dict[str, Any] = dict(score_entities(message))
    assert shown["perception/score/pieces"][0].labels.as_arrow_array().to_pylist() == ["+1.3", "-1.7"]
