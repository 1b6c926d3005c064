"""What perception and tool tracker see lies where it was seen, in colours and words of its own."""

import dataclasses
from typing import Any

import cv2
import numpy as np
import pytest

from agents.viewer import colours
from agents.viewer.grasp_mapping import plan_markdown
from agents.viewer.live_mapping import LiveMapping
from agents.viewer.seen_mapping import (
    candidate_entities,
    distinctness,
    match_entities,
    occluder_entities,
    verdict,
)
from schemas import messages, topics
from schemas.messages import Occluder, Status
from shared.images import encode_image
from tests.agents.viewer.conftest import HEIGHT, STAMP, WIDTH, held

PLACES = {Occluder.TOOL: 10, Occluder.NEEDLE: 30, Occluder.UNKNOWN: 50}
"""Rows of a map of 60 by 96 in which each kind begins, and goes on for eight."""
ROWS_DOWN = 20
LOWER = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, ROWS_DOWN]])


def shown(mapping, message) -> dict[str, Any]:
    """What is logged of a message, by path."""
    return dict(mapping.entities(message))


@pytest.fixture
def observations(scene):
    """Two threads, and each kind of occluder in the left image and in the right one."""
    kinds = np.zeros((60, 96), np.uint8)
    for kind, row in PLACES.items():
        kinds[row : row + 8, 20:40] = kind.value
    image = encode_image(kinds, messages.ImageEncoding.PNG)
    left_px = np.array([[5.0, 5.0], [9.0, 7.0]])
    thread = messages.ThreadCandidate(0.9, left_px, left_px - [2.0, 0.0], 4.0, np.array([20, 30, 40]))
    other = dataclasses.replace(thread, score=0.25)
    return dataclasses.replace(
        scene.observations, candidates=(thread, other), occluders=messages.Occluders(image, image, 0)
    )


def test_threads_and_what_may_hide_them_lie_where_a_right_image_that_was_moved_shows_them(observations):
    lines = dict(candidate_entities(observations, LOWER))
    for side, px in (("left", [[5.5, 5.5], [9.5, 7.5]]), ("right", [[3.5, 25.5], [7.5, 27.5]])):
        np.testing.assert_allclose(held(lines[f"world/{side}/candidates"][0], "strips")[0], px)
    for (_, entity), down in zip(occluder_entities(observations, LOWER), (0, ROWS_DOWN), strict=True):
        image = cv2.imdecode(np.array(held(entity[0], "blob")[0], np.uint8), cv2.IMREAD_UNCHANGED)
        assert image is not None
        assert image.shape == (HEIGHT, WIDTH, 4)
        u = round(30 * WIDTH / 96)
        for kind, row in PLACES.items():
            v = round((row + 4) * HEIGHT / 60) + down
            if v < HEIGHT:
                assert tuple(image[v, u, :3][::-1]) == colours.OCCLUDERS[kind]
        assert np.flatnonzero(image[:, u, 3])[0] == pytest.approx(10 * HEIGHT / 60 + down, abs=2)


def test_the_verdict_says_what_is_wrong_what_to_do_which_threads_there_are_and_how_the_eyes_lie(observations):
    blurred = messages.Judgement("blurred", messages.Severity.WARNING, "the left image is out of focus", "focus")
    for changed, expected in (
        ({"judgements": (blurred,)}, "WARNING blurred: the left image is out of focus Remedy: focus"),
        ({}, "Thread 1 (meant): score 0.90"),
        ({}, "Thread 2: score 0.25"),
        ({"judgements": ()}, "Nothing is wrong with the images."),
        ({"occluders": None}, "nobody looked, or the ground is of one colour"),
        ({"status": Status.FAILED, "reason": "no thread was found"}, "No thread:** no thread was found"),
        (
            {"right_eye": messages.RightEye(-2.4, -0.147, 0.9997)},
            "put in line: -2.40 px lower, turned by -0.147 degrees",
        ),
        ({"disparities_px": np.array([192.4, 575.1])}, "disparities of 192 to 575 px"),
    ):
        assert expected in verdict(dataclasses.replace(observations, **changed))
    assert "put in line" not in verdict(observations)
    assert "disparities of" not in verdict(observations)


def test_a_running_session_shows_threads_what_hides_them_the_verdict_and_the_score_with_its_log_odds(observations):
    score = np.full((54, 96), 200, np.uint8)
    score[:, 48:] = 40
    along = np.concatenate([np.linspace(0.1, 0.4, 20), np.linspace(0.6, 0.9, 20)])
    point = np.column_stack((along * WIDTH, np.full(40, 0.5 * HEIGHT)))
    lines = messages.Centrelines(point, np.repeat([0, 1], 20), np.full(40, 3.0), np.full(40, 0.1))
    score_map = encode_image(score, messages.ImageEncoding.PNG)
    session = LiveMapping()
    first = shown(session, dataclasses.replace(observations, score_map=score_map, centrelines_left=lines))
    assert len(held(first["world/left/candidates"][0], "strips")) == 2
    assert len(held(first["world/right/occluders"][0], "blob")) == 1
    assert "Thread 1 (meant): score 0.90" in held(first["perception/verdict"][0], "text")[0]
    assert bytes(held(first["perception/score"][0], "blob")[0]) == score_map.data
    assert held(first["perception/score/pieces"][0], "labels") == ["+1.3", "-1.7"]
    later = shown(session, dataclasses.replace(observations, candidates=()))
    assert held(later["world/left/candidates"][0], "strips") == []
    assert "perception/score" not in later, "the last one stands"


def test_matches_are_told_apart_by_how_much_the_second_best_costs_and_each_is_in_the_histogram(scene):
    cost = np.array([[1.0, 4.0], [2.0, 2.0], [3.0, 1.0], [1.0, np.inf], [np.nan, 1.0], [0.0, 0.0]])
    assert distinctness(cost) == pytest.approx([0.75, 0.0, 0.0, 1.0, np.nan, np.nan], nan_ok=True)
    count = len(scene.observations.matched_px)
    best = np.linspace(1.0, 2.0, count)
    entities = dict(
        match_entities(dataclasses.replace(scene.observations, match_cost=np.column_stack((best, 2.0 * best))))
    )
    for name in ("best", "second"):
        assert sum(held(entities[f"match/histogram/{name}"][0], "values")[0]["buffer"]) == count
    assert held(entities["match/cost/best"][0], "scalars") == [1.5]
    assert held(entities["match/kept"][0], "scalars") == [scene.observations.inlier.mean()]


def colours_of(cloud):
    packed = np.array(held(cloud, "colors"), np.uint32)
    return np.column_stack([packed >> shift & 255 for shift in (24, 16, 8)]).astype(int)


def test_each_cell_of_tissue_whose_depth_is_known_is_a_point_the_greener_the_surer():
    camera = messages.RectifiedStereo(640, 360, 600.0, 600.0, 319.5, 179.5, 5e-3, 1.0)
    depth, valid = np.array([[0.09, 0.0], [0.1, 0.11]]), np.array([[True, False], [True, True]])
    deviation = np.array([[1e-4, 0.0], [5e-4, 5e-3]])
    surface = messages.TissueSurface(
        STAMP, camera, np.array([319.5, 379.5]), np.array([179.5, 239.5]), depth, valid, deviation
    )
    (cloud,) = shown(LiveMapping(), surface)["world/surface"]
    np.testing.assert_allclose(held(cloud, "positions"), [[0, 0, 90], [0, 10, 100], [11, 11, 110]], atol=1e-4)
    red, green, _ = colours_of(cloud).T
    assert (np.diff(red - green) > 0).all()
    assert green[0] > red[0]
    assert red[2] > 2 * green[2]
    (cloud,) = shown(LiveMapping(), dataclasses.replace(surface, deviation=None))["world/surface"]
    assert np.ptp(colours_of(cloud), axis=0).max() == 0, "nobody tells how sure they are"


def test_where_the_jaws_come_nearest_to_the_tissue_is_shown_and_said_and_where_that_was_not_checked(session_messages):
    def contact(**changed):
        plan = dataclasses.replace(session_messages[topics.PLAN], **changed)
        return shown(LiveMapping(), plan)["world/plan/psm1/contact"][0], plan_markdown(plan)

    tissue = messages.TissueClearance(
        STAMP, "", 1.0, -1.2e-3, 2e-4, np.array([0.01, 0.02, 0.09]), messages.Phase.GRASP, 0.4
    )
    points, report = contact(tissue=tissue)
    np.testing.assert_allclose(held(points, "positions"), [[10, 20, 90]], atol=1e-4)
    (words,) = held(points, "labels")
    assert words == "jaws 1.2 ± 0.2 mm into the tissue, in grasp at 40%"
    assert f"Tissue: {words}." in report
    refused, _ = contact(tissue=tissue, status=Status.FAILED, reason="in the tissue", waypoints=())
    assert colours_of(refused).tolist() != colours_of(points).tolist()
    for unchecked in (None, messages.TissueClearance(None, "not checked against tissue: none yet", 0.0)):
        points, report = contact(tissue=unchecked)
        assert held(points, "positions") == []
        assert ("not checked against tissue: none yet" in report) == (unchecked is not None)


def test_an_instrument_is_drawn_where_it_was_found_and_is_told_lost_once(session_messages):
    told, mapping = session_messages[topics.TOOL], LiveMapping()
    entities = shown(mapping, told)
    assert mapping.scene.tracked
    for path, px in (
        ("world/left/tool/psm1/registered", told.registered_left_px),
        ("world/left/tool/psm1/found", told.found_left_px),
        ("world/right/tool/psm1/found", told.found_right_px),
    ):
        np.testing.assert_allclose(held(entities[path][0], "positions"), px)
    assert held(entities["tool/off/psm1"][0], "scalars") == [4.0]
    assert "lanes/tool_psm1" in entities
    assert "lanes/tool_psm1" not in shown(mapping, told), "it is the same still"
    lost = dataclasses.replace(
        told, status=messages.ToolStatus.LOST, reason="lost: too little in view", T_correction=None, candidates=()
    )
    entities = shown(mapping, lost)
    assert "too little in view" in held(entities["log/tool_tracker/psm1"][0], "text")[0]
    assert "tool/off/psm1" not in entities


def test_what_a_message_says_that_it_shows_is_drawn_and_goes_when_it_is_not_known_any_more(session_messages):
    pose, mapping = session_messages[topics.NEEDLE], LiveMapping()
    drawn = shown(mapping, pose)
    assert {"world/shown/needle/arc", "world/shown/needle/point", "needle/radius_mm", "lanes/needle"} <= drawn.keys()
    lost = dataclasses.replace(
        pose, status=Status.FAILED, reason="it is hidden", T_camera_needle=None, radius=0.0, arc_rad=0.0
    )
    gone = shown(mapping, lost)
    assert {path for path in drawn if path.startswith("world/shown")} <= gone.keys()
    assert "log/needle" in gone
    assert "log/needle" not in shown(mapping, lost), "it is said once"
    # a place whose covariance has axes in any order is drawn as a rotation of an ellipsoid
    tilted = dataclasses.replace(pose, covariance=np.diag([1e-8, 4e-8, 9e-8, 0, 0, 0, 0, 0]))
    assert "world/shown/needle/swage" in shown(mapping, tilted)
