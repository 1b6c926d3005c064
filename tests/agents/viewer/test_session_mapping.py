"""What tells of plans, arms, times and the dataflow, mapping by mapping."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from agents.viewer.grasp_mapping import WeighedCaptures, captures_of, turns_of_z
from agents.viewer.live_mapping import LiveMapping
from agents.viewer.session_mapping import Dataflow, StageTimes
from schemas import topics
from schemas.messages import Alternative, InputHealth, OutputHealth
from tests.agents.viewer.conftest import held


@pytest.fixture
def plan(session_messages):
    others = (Alternative(0.5, 0.2, "out of reach"), Alternative(0.7, 0.6, "unseen"), Alternative(0.9, 0.1, "unseen"))
    return dataclasses.replace(session_messages[topics.PLAN], alternatives=others)


def test_captures_stand_on_the_thread_of_their_plan_in_the_colour_of_what_lost_them(plan, scene):
    considered = WeighedCaptures()
    considered.saw(scene.reconstruction)
    entities: dict[str, Any] = dict(considered.entities(plan))
    (points,) = entities["world/plan/psm1/considered"]
    true = np.column_stack([np.interp((0.5, 0.7, 0.9, 0.3), scene.share, axis) for axis in scene.curve.T])
    assert np.linalg.norm(np.array(held(points, "positions")) - true, axis=1).max() < 0.1
    out_of_reach, unseen, also_unseen, chosen = held(points, "colors")
    assert unseen == also_unseen
    assert len({out_of_reach, unseen, chosen}) == 3
    assert held(points, "labels") == ["20%", "60%", "10%", "80% chosen"]
    bars = {"plan/considered/out_of_reach", "plan/considered/unseen", "plan/considered/chosen"}
    assert bars <= entities.keys()
    # a reason keeps its colour, and its bars vanish with the next plan
    others = Alternative(0.2, 0.4, "another"), *plan.alternatives[:1]
    rejected = dataclasses.replace(plan, s_capture=None, s_goal=0.4, alternatives=others)
    assert [(capture.s, capture.why) for capture in captures_of(rejected)][-1] == (0.4, "goal")
    (before,), (gone,) = (some["plan/considered/unseen"] for some in (entities, dict(considered.entities(rejected))))
    assert held(gone, "color") == held(before, "color")
    assert max(held(gone, "values")[0]["buffer"]) == 0


def test_an_arm_that_is_no_psm_has_a_straight_shaft(session_messages):
    state = dataclasses.replace(session_messages[topics.ROBOT_STATE], kinematics="dh")
    (line,) = dict(LiveMapping().entities(state))["world/tool/psm1/shaft"]
    steps = np.diff(np.array(held(line, "strips")[0]), axis=0)
    behind = -(state.T_camera_base @ state.T_base_tool)[:3, 2]
    np.testing.assert_allclose(steps / np.linalg.norm(steps, axis=1)[:, None], [behind, behind], atol=1e-6)


@given(arrays.arrays(np.float64, (5, 3), elements=st.floats(-100, 100)))
def test_solid_parts_of_a_tool_point_along_it(direction):
    x, y, z, w = turns_of_z(direction).T
    turned = np.column_stack((2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)))
    length = np.linalg.norm(direction, axis=1)
    some = length > 1e-6
    assert np.allclose(turned[some], direction[some] / length[some, None], atol=1e-6)


def test_a_stage_takes_from_the_publication_of_its_input_to_its_own():
    stages = StageTimes()
    assert stages.saw(topics.FRAMES, 7, 10_000_000) is None
    assert stages.saw(topics.OBSERVATIONS, 7, 35_000_000) == pytest.approx(25.0)
    assert stages.saw(topics.SURFACE, 7, 40_000_000) == pytest.approx(30.0)
    assert stages.saw(topics.THREAD, 7, 41_000_000) == pytest.approx(6.0)
    assert stages.saw(topics.THREAD, 8, 41_000_000) is None


def test_the_dataflow_leads_from_who_publishes_to_who_reads_with_live_rates_and_tells_silence(session_messages):
    health, dataflow = session_messages[topics.HEALTH], Dataflow()

    def told(agent, instance="main", after_ns=0, inputs=(), outputs=()):
        account = {"agent": agent, "instance": instance, "at_ns": health.at_ns + after_ns, "fault": ""}
        return dict(dataflow.entities(dataclasses.replace(health, inputs=inputs, outputs=outputs, **account)))

    (table,) = dict(dataflow.entities(health))["dataflow/table"]
    assert "| perception | host | fault | 12 / 31 |" in held(table, "text")[0]
    told("camera", outputs=(OutputHealth("camera/frames", 29.5, 300),))
    for arm in ("psm1", "psm2"):
        heard = InputHealth("operator/heartbeat", 20.0, 1.0, 5, 0, 0, 0)
        told("robot_bridge", arm, inputs=(heard,), outputs=(OutputHealth("robot_bridge/state", 100.0, 900),))
    states = InputHealth("robot_bridge/state", 190.0, 1.0, 5, 0, 0, 0)
    last = told("planner", after_ns=10 * 10**9, inputs=(states,))
    nodes, edges = last["dataflow/graph"]
    labels = dict(zip(held(nodes, "node_ids"), held(nodes, "labels"), strict=True))
    assert {(edge["first"], edge["second"]) for edge in held(edges, "edges")} == {
        ("camera", "camera/frames"),
        ("camera/frames", "perception"),
        ("perception", "perception/observations"),
        # an operator without health, and arms with nodes of their own
        ("operator", "operator/heartbeat/psm1"),
        ("operator", "operator/heartbeat/psm2"),
        ("operator/heartbeat/psm1", "robot_bridge/psm1"),
        ("operator/heartbeat/psm2", "robot_bridge/psm2"),
        ("robot_bridge/psm1", "robot_bridge/state/psm1"),
        ("robot_bridge/psm2", "robot_bridge/state/psm2"),
        ("robot_bridge/state/psm1", "planner"),
        ("robot_bridge/state/psm2", "planner"),
    }
    assert labels["camera/frames"] == "frames  29.5 Hz  3 lost"
    assert labels["perception"] == "perception  12 ms"
    assert labels["operator/heartbeat/psm1"] == "heartbeat  20 Hz read"
    (text,) = held(last["dataflow/table"][0], "text")
    assert "| perception | host | silent |" in text
    assert "| planner | host | well |" in text
