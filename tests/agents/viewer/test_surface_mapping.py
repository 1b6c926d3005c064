"""Cells with a known depth become points at that depth; and a plan's nearest place to the tissue is shown."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import rerun as rr

from agents.viewer.grasp_mapping import plan_markdown
from agents.viewer.live_mapping import LiveMapping
from schemas import topics
from schemas.messages import FrameStamp, Phase, RectifiedStereo, Status, TissueClearance, TissueSurface

STAMP = FrameStamp(1, 2, 3, "")


def test_each_valid_cell_is_a_point_in_millimetres():
    camera = RectifiedStereo(640, 360, 600.0, 600.0, 319.5, 179.5, 5e-3, 1.0)
    depth, valid = np.array([[0.09, 0.0], [0.1, 0.11]]), np.array([[True, False], [True, True]])
    surface = TissueSurface(
        FrameStamp(1, 2, 3, ""), camera, np.array([319.5, 379.5]), np.array([179.5, 239.5]), depth, valid
    )
    ((path, (cloud,)),) = LiveMapping().entities(surface)
    assert path == "world/surface"
    assert isinstance(cloud, rr.Points3D)
    assert cloud.positions is not None
    points = np.array(cloud.positions.as_arrow_array().to_pylist())
    np.testing.assert_allclose(points, [[0, 0, 90], [0, 10, 100], [11, 11, 110]], atol=1e-4)


def colours_of(cloud):
    packed = np.array(cloud.colors.as_arrow_array().to_pylist(), np.uint32)
    return np.column_stack([packed >> shift & 255 for shift in (24, 16, 8)])


def test_the_surer_a_cell_the_greener_it_is_and_grey_where_nobody_tells():
    camera = RectifiedStereo(640, 360, 600.0, 600.0, 319.5, 179.5, 5e-3, 1.0)
    depth, deviation = np.full((2, 2), 0.1), np.array([[1e-4, 4e-4], [1e-3, 5e-3]])
    surface = TissueSurface(STAMP, camera, np.arange(2.0), np.arange(2.0), depth, depth > 0, deviation)
    ((_, (cloud,)),) = LiveMapping().entities(surface)
    red, green, _ = colours_of(cloud).T.astype(int)
    assert (np.diff(red - green) > 0).all()
    assert green[0] > red[0]
    assert red[3] > 2 * green[3]
    ((_, (cloud,)),) = LiveMapping().entities(dataclasses.replace(surface, deviation=None))
    assert len(set(map(tuple, colours_of(cloud)))) == 1


def contact(plan) -> Any:
    entities = dict(LiveMapping().entities(plan))
    (points,) = entities["world/plan/psm1/contact"]
    return points


def test_where_the_jaws_come_nearest_to_the_tissue_is_shown_and_said(session_messages):
    tissue = TissueClearance(STAMP, "", 1.0, -1.2e-3, 2e-4, np.array([0.01, 0.02, 0.09]), Phase.GRASP, 0.4)
    plan = dataclasses.replace(session_messages[topics.PLAN], tissue=tissue)
    points = contact(plan)
    np.testing.assert_allclose(points.positions.as_arrow_array().to_pylist(), [[10, 20, 90]], atol=1e-4)
    words = "jaws 1.2 ± 0.2 mm into the tissue, in grasp at 40%"
    assert points.labels.as_arrow_array().to_pylist() == [words]
    assert f"Tissue: {words}." in plan_markdown(plan)
    refused = dataclasses.replace(plan, status=Status.FAILED, reason="in the tissue", waypoints=())
    assert colours_of(contact(refused)).tolist() != colours_of(points).tolist()


@pytest.mark.parametrize("tissue", [None, TissueClearance(None, "not checked against tissue: none yet", 0.0)])
def test_what_was_not_checked_shows_no_place_and_empties_the_one_before(session_messages, tissue):
    plan = dataclasses.replace(session_messages[topics.PLAN], tissue=tissue)
    assert contact(plan).positions.as_arrow_array().to_pylist() == []
    assert ("not checked against tissue: none yet" in plan_markdown(plan)) == (tissue is not None)
