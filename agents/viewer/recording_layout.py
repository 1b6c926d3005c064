"""How the recording of one reconstruction is laid out: space and both eyes above, a chart and words below."""

import numpy as np
import rerun.blueprint as rrb

from agents.viewer import colours
from agents.viewer.polyline import thread_polyline
from agents.viewer.quality_mapping import EXAGGERATION, SIDES
from agents.viewer.report import unit_text
from schemas.messages import ThreadReconstruction
from shared.camera import depth_of_disparity

VIEWPOINT = (0.55, -0.4, -0.75)
"""Where one looks at the thread from, seen from there, as a multiple of its distance: right, above, and behind."""

FLAT = (
    "world/left/bounds",
    "world/right/image",
    *(
        f"world/{side}/{what}"
        for side in SIDES
        for what in (
            "mask",
            "centrelines",
            "candidates",
            "candidates/scores",
            "occluders",
            f"residuals_x{EXAGGERATION}",
        )
    ),
)
"""What belongs to the images alone, and would only hide the thread in space."""


def layout(reconstruction: ThreadReconstruction) -> rrb.Blueprint:
    """How the viewer is laid out: space to the left, both eyes and words to the right, confidence below."""
    unit = unit_text(reconstruction.camera.metres_per_unit)
    seen = ["world/thread/curve", "world/thread/other_course", "world/thread/ends"]
    left = rrb.Spatial2DView(
        origin="world/left", name="left", contents=["$origin/**", *seen, "world/observations/points"]
    )
    right = rrb.Spatial2DView(origin="world/right", name="right", contents=["$origin/**", *seen])
    space = rrb.Spatial3DView(
        origin="world",
        name=f"space, {unit}",
        contents=["$origin/**", *(f"- {path}" for path in FLAT)],
        background=colours.BACKGROUND,
        line_grid=False,
        eye_controls=_eye(reconstruction),
    )
    chart = rrb.Tabs(
        rrb.BarChartView(origin="deviation/along_s", name=f"deviation across the thread along s, {unit}"),
        rrb.BarChartView(origin="confidence", name="confidence along s"),
        rrb.Spatial2DView(origin="perception/score", name="score of the segmenter"),
        active_tab=0 if len(reconstruction.posterior_s) else 1,
    )
    words = rrb.TextDocumentView(origin="report", name="report")
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(space, rrb.Vertical(left, right), column_shares=[3, 2]),
            rrb.Horizontal(chart, words, column_shares=[3, 2]),
            row_shares=[3, 1],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="frame"),
    )


def distance_of(reconstruction: ThreadReconstruction) -> float:
    """How far away things are: the thread's depth, or what one disparity of a twentieth of the width would be."""
    thread = thread_polyline(reconstruction)
    if thread is not None:
        return float(np.median(thread.points_camera[:, 2]))
    camera = reconstruction.camera
    return float(depth_of_disparity(camera, np.array([0.05 * camera.image_width]))[0])


def _eye(reconstruction: ThreadReconstruction) -> rrb.EyeControls3D:
    """Look at the thread from behind the cameras, from the right and above, so that depth can be seen."""
    thread = thread_polyline(reconstruction)
    distance = distance_of(reconstruction)
    target = np.array([0.0, 0.0, distance]) if thread is None else thread.points_camera.mean(axis=0)
    position = target + distance * np.array(VIEWPOINT)
    return rrb.EyeControls3D(position=position, look_target=target, eye_up=[0.0, -1.0, 0.0])
