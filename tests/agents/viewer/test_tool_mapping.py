"""An instrument's outlines lie over the images, its figures are in millimetres, and a change of status is said."""

import dataclasses
from typing import Any

import numpy as np

from agents.viewer.live_mapping import LiveMapping
from schemas import topics
from schemas.messages import ToolStatus


def shown(mapping, message) -> dict[str, Any]:
    """What is logged of a message, by path."""
    return dict(mapping.entities(message))


def test_an_instrument_is_drawn_where_it_was_found_and_is_told_lost_once(session_messages):
    told, mapping = session_messages[topics.TOOL], LiveMapping()
    entities = shown(mapping, told)
    assert mapping.tracked
    for path, px in (
        ("world/left/tool/psm1/registered", told.registered_left_px),
        ("world/left/tool/psm1/found", told.found_left_px),
        ("world/right/tool/psm1/found", told.found_right_px),
    ):
        (points,) = entities[path]
        np.testing.assert_allclose(points.positions.as_arrow_array().to_pylist(), px)
    (off,) = entities["tool/off/psm1"]
    assert off.scalars.as_arrow_array().to_pylist() == [4.0]
    assert "lanes/tool_psm1" in entities
    assert "lanes/tool_psm1" not in shown(mapping, told), "it is the same still"
    lost = dataclasses.replace(
        told, status=ToolStatus.LOST, reason="lost: too little in view", T_correction=None, candidates=()
    )
    entities = shown(mapping, lost)
    (words,) = entities["log/tool_tracker/psm1"]
    assert "too little in view" in words.text.as_arrow_array().to_pylist()[0]
    assert "tool/off/psm1" not in entities


def test_an_arm_that_is_no_psm_has_a_straight_shaft_and_numbered_joints(session_messages):
    state = dataclasses.replace(session_messages[topics.ROBOT_STATE], kinematics="dh")
    entities = shown(LiveMapping(), state)
    (line,) = entities["world/tool/psm1/shaft"]
    (strip,) = line.strips.as_arrow_array().to_pylist()
    steps = np.diff(np.array(strip), axis=0)
    behind = -(state.T_camera_base @ state.T_base_tool)[:3, 2]
    np.testing.assert_allclose(steps / np.linalg.norm(steps, axis=1)[:, None], [behind, behind], atol=1e-6)
