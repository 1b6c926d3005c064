"""What a message says that it shows is drawn without a line of the viewer's own for it."""

import dataclasses

import numpy as np

from agents.viewer.live_mapping import LiveMapping
from schemas import topics
from schemas.messages import Status


def test_a_needle_is_drawn_with_its_ends_and_goes_when_it_is_not_known_any_more(session_messages):
    pose = session_messages[topics.NEEDLE]
    mapping = LiveMapping()
    drawn = dict(mapping.entities(pose))
    assert {"world/shown/needle/arc", "world/shown/needle/point", "needle/radius_mm", "lanes/needle"} <= drawn.keys()
    lost = dataclasses.replace(
        pose, status=Status.FAILED, reason="it is hidden", T_camera_needle=None, radius=0.0, arc_rad=0.0
    )
    gone = dict(mapping.entities(lost))
    assert {path for path in drawn if path.startswith("world/shown")} <= gone.keys()
    assert "log/needle" in gone
    # said once, not with every frame
    again = dict(mapping.entities(lost))
    assert "log/needle" not in again
    # a place whose covariance has axes in any order is drawn as a rotation of an ellipsoid
    tilted = dataclasses.replace(pose, covariance=np.diag([1e-8, 4e-8, 9e-8, 0, 0, 0, 0, 0]))
    assert "world/shown/needle/swage" in dict(mapping.entities(tilted))
