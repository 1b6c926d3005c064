"""What tells of plans, matches, times and the dataflow, mapping by mapping."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from agents.viewer.grasp_mapping import Considered, captures_of, turns_of_z
from agents.viewer.seen_mapping import distinctness, match_entities
from agents.viewer.session_mapping import Arrivals, Dataflow, StageTimes
from schemas import topics
from schemas.messages import Alternative, InputHealth, OutputHealth


def column(entity: Any, component: str) -> Any:
    """What an archetype holds, as a list."""
    return getattr(entity[1][0], component).as_arrow_array().to_pylist()


def named(entities: Any, path: str) -> Any:
    (found,) = [entity for entity in entities if entity[0] == path]
    return found


@pytest.fixture
def plan(session_messages):
    others = (Alternative(0.5, 0.2, "out of reach"), Alternative(0.7, 0.6, "unseen"), Alternative(0.9, 0.1, "unseen"))
    return dataclasses.replace(session_messages[topics.PLAN], alternatives=others)


def test_captures_stand_on_the_thread_of_their_plan_in_the_colour_of_what_lost_them(plan, scene):
    considered = Considered()
    considered.saw(scene.reconstruction)
    entities = considered.entities(plan)
    path, (points,) = named(entities, "world/plan/psm1/considered")
    places = np.array(points.positions.as_arrow_array().to_pylist())
    shares = np.concatenate(([0], np.cumsum(np.linalg.norm(np.diff(scene.curve, axis=0), axis=1)))) / scene.length
    for place, s in zip(places, (0.5, 0.7, 0.9, 0.3), strict=True):
        true = np.array([np.interp(s, shares, axis) for axis in scene.curve.T])
        assert np.linalg.norm(place - true) < 0.1
    colour = points.colors.as_arrow_array().to_pylist()
    assert colour[1] == colour[2]
    assert len(set(colour)) == 3
    assert points.labels.as_arrow_array().to_pylist() == ["20%", "60%", "10%", "80% chosen"]
    bars = {path for path, _ in entities} - {path}
    assert bars >= {"plan/considered/out_of_reach", "plan/considered/unseen", "plan/considered/chosen"}


def test_a_reason_keeps_its_colour_and_its_bars_vanish_with_the_next_plan(plan, scene):
    considered = Considered()
    considered.saw(scene.reconstruction)
    before = named(considered.entities(plan), "plan/considered/unseen")
    others = Alternative(0.2, 0.4, "another"), *plan.alternatives[:1]
    rejected = dataclasses.replace(plan, s_capture=None, s_goal=0.4, alternatives=others)
    assert [(capture.s, capture.why) for capture in captures_of(rejected)][-1] == (0.4, "goal")
    after = considered.entities(rejected)
    gone = named(after, "plan/considered/unseen")
    assert column(gone, "color") == column(before, "color")
    assert max(gone[1][0].values.as_arrow_array().to_pylist()[0]["buffer"]) == 0


def test_matches_are_told_apart_by_how_much_the_second_best_costs():
    cost = np.array([[1.0, 4.0], [2.0, 2.0], [3.0, 1.0], [1.0, np.inf], [np.nan, 1.0], [0.0, 0.0]])
    assert distinctness(cost) == pytest.approx([0.75, 0.0, 0.0, 1.0, np.nan, np.nan], nan_ok=True)


def test_every_matched_pixel_is_in_the_histogram_unless_it_costs_far_more_than_others(scene):
    matched = scene.observations.matched_px
    best = np.linspace(1.0, 2.0, len(matched))
    observations = dataclasses.replace(scene.observations, match_cost=np.column_stack((best, 2.0 * best)))
    entities = match_entities(observations)
    for name in ("best", "second"):
        (bars,) = named(entities, f"match/histogram/{name}")[1]
        assert sum(bars.values.as_arrow_array().to_pylist()[0]["buffer"]) == len(matched)
    assert column(named(entities, "match/cost/best"), "scalars") == [1.5]
    assert column(named(entities, "match/kept"), "scalars") == [scene.observations.inlier.mean()]


def test_a_stage_takes_from_the_publication_of_its_input_to_its_own():
    stages = StageTimes()
    assert stages.saw(topics.FRAMES, 7, 10_000_000) is None
    assert stages.saw(topics.OBSERVATIONS, 7, 35_000_000) == pytest.approx(25.0)
    assert stages.saw(topics.SURFACE, 7, 40_000_000) == pytest.approx(30.0)
    assert stages.saw(topics.THREAD, 7, 41_000_000) == pytest.approx(6.0)
    assert stages.saw(topics.THREAD, 8, 41_000_000) is None


def test_the_least_time_of_arrival_of_each_second_tells_of_a_clock_that_is_ahead():
    arrivals = Arrivals()
    told = []
    for number in range(31):
        received_ns = number * 100_000_000
        took_ns = (-40 + number % 10) * 1_000_000
        told += arrivals.count("suturegrasp/test/camera/main/frames", received_ns - took_ns, received_ns)
    assert [path for path, _ in told] == ["clock/arrival_ms/camera"] * 3
    assert [column(entity, "scalars")[0] for entity in told] == pytest.approx([-40.0] * 3)


def graph_of(entities: Any) -> Any:
    nodes, edges = dict(entities)["dataflow/graph"]
    ids = nodes.node_ids.as_arrow_array().to_pylist()
    labels = dict(zip(ids, nodes.labels.as_arrow_array().to_pylist(), strict=True))
    return labels, {(edge["first"], edge["second"]) for edge in edges.edges.as_arrow_array().to_pylist()}


def test_the_dataflow_leads_from_who_publishes_to_who_reads_with_live_rates(session_messages):
    health = session_messages[topics.HEALTH]
    camera = dataclasses.replace(
        health, agent="camera", fault="", inputs=(), outputs=(OutputHealth("camera/frames", 29.5, 300),)
    )
    dataflow = Dataflow()
    dataflow.entities(health)
    labels, edges = graph_of(dataflow.entities(camera))
    assert edges == {
        ("camera", "camera/frames"),
        ("camera/frames", "perception"),
        ("perception", "perception/observations"),
    }
    assert labels["camera/frames"] == "frames  29.5 Hz  3 lost"
    assert labels["perception"] == "perception  12 ms"


def test_arms_have_nodes_of_their_own_and_an_operator_without_health_is_there(session_messages):
    health = session_messages[topics.HEALTH]
    heard = InputHealth("operator/heartbeat", 20.0, 1.0, 5, 0, 0, 0)
    said = OutputHealth("robot_bridge/state", 100.0, 900)
    arms = [
        dataclasses.replace(health, agent="robot_bridge", instance=arm, inputs=(heard,), outputs=(said,))
        for arm in ("psm1", "psm2")
    ]
    read = InputHealth("robot_bridge/state", 190.0, 1.0, 5, 0, 0, 0)
    planner = dataclasses.replace(health, agent="planner", inputs=(read,), outputs=())
    dataflow = Dataflow()
    for arm in arms:
        dataflow.entities(arm)
    labels, edges = graph_of(dataflow.entities(planner))
    for arm in ("psm1", "psm2"):
        assert ("operator", f"operator/heartbeat/{arm}") in edges
        assert (f"operator/heartbeat/{arm}", f"robot_bridge/{arm}") in edges
        assert (f"robot_bridge/state/{arm}", "planner") in edges
        assert labels[f"operator/heartbeat/{arm}"] == "heartbeat  20 Hz read"


def test_the_table_of_the_dataflow_tells_silence_and_faults(session_messages):
    health = session_messages[topics.HEALTH]
    later = dataclasses.replace(health, agent="camera", at_ns=health.at_ns + 10 * 10**9, fault="")
    dataflow = Dataflow()
    _, (first,) = named(dataflow.entities(health), "dataflow/table")
    assert "| perception | host | fault | 12 / 31 |" in first.text.as_arrow_array().to_pylist()[0]
    _, (table,) = named(dataflow.entities(later), "dataflow/table")
    (text,) = table.text.as_arrow_array().to_pylist()
    assert "| perception | host | silent |" in text
    assert "| camera | host | well |" in text


@given(arrays.arrays(np.float64, (5, 3), elements=st.floats(-100, 100)))
def test_capsules_point_along_their_parts(direction):
    x, y, z, w = turns_of_z(direction).T
    turned = np.column_stack((2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)))
    length = np.linalg.norm(direction, axis=1)
    some = length > 1e-6
    assert np.allclose(turned[some], direction[some] / length[some, None], atol=1e-6)
