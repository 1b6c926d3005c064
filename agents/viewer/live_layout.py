"""How the live view is laid out: space and both eyes above, curves, lanes and words below."""

import numpy as np
import rerun.blueprint as rrb
from jaxtyping import Float64

from agents.viewer import colours
from agents.viewer.recording_layout import FLAT, VIEWPOINT

TYPICAL_MM = 95.0
"""Where a thread is looked for before one has been seen: the middle of an endoscope's working range."""

DRAWN_ON_IMAGES = (
    "world/thread/curve",
    "world/thread/ends",
    "world/plan/**",
    "world/tool/**",
)


HIDDEN_IN_SPACE = ("world/observations/matched", "world/thread/control_points")
"""What crowds the thread; the eye symbol in the blueprint panel brings it back."""

CLOSER = 0.75
"""How much nearer than in a picture of one reconstruction the eye is: there is less room."""


def live_layout(middle_camera: Float64[np.ndarray, "3"] | None, unit: str, raw_images: bool) -> rrb.Blueprint:
    """The layout; `middle_camera` is what the eye turns about, in the unit of space."""
    space = rrb.Spatial3DView(
        origin="world",
        name=f"space, {unit}",
        contents=["$origin/**", *(f"- {path}" for path in FLAT)],
        background=colours.BACKGROUND,
        line_grid=False,
        overrides={path: rrb.EntityBehavior(visible=False) for path in HIDDEN_IN_SPACE},
        eye_controls=_eye(np.array([0.0, 0.0, TYPICAL_MM]) if middle_camera is None else middle_camera),
    )
    eyes = rrb.Vertical(*(_eye_view(side, raw_images) for side in ("left", "right")))
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(space, eyes, column_shares=[3, 2]),
            rrb.Horizontal(_quality(unit), _curves(), _lanes(), _words(), column_shares=[3, 3, 3, 4]),
            row_shares=[5, 2],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="capture_time"),
    )


def _eye(middle: Float64[np.ndarray, "3"]) -> rrb.EyeControls3D:
    position = middle + CLOSER * middle[2] * np.array(VIEWPOINT)
    return rrb.EyeControls3D(position=position, look_target=middle, eye_up=[0.0, -1.0, 0.0])


def _eye_view(side: str, raw_images: bool) -> rrb.View | rrb.Tabs:
    shown = ["$origin/**", *DRAWN_ON_IMAGES, *(["world/observations/points"] if side == "left" else [])]
    view = rrb.Spatial2DView(origin=f"world/{side}", name=side, contents=shown)
    if not raw_images:
        return view
    return rrb.Tabs(rrb.Spatial2DView(origin=f"camera/raw/{side}", name=f"{side}, not rectified"), view)


def _quality(unit: str) -> rrb.Tabs:
    return rrb.Tabs(
        _plot("residual_px", "residual, px"),
        _plot("deviation", f"deviation, {unit}"),
        _plot("share", "shares unseen, left over"),
        rrb.BarChartView(origin="deviation/along_s", name=f"deviation along s, {unit}"),
        rrb.BarChartView(origin="confidence", name="confidence along s"),
        active_tab=0,
    )


def _curves() -> rrb.Tabs:
    return rrb.Tabs(
        _plot("latency", "latency since capture, ms"),
        _plot("step_ms", "step time, ms"),
        _plot("health/rate_hz", "published, Hz"),
        _plot("health/lost", "lost or refused"),
        _plot("health/replaced", "replaced by newer"),
        _plot("viewer", "of the viewer"),
        _plot("robot", "joints, jaw"),
        active_tab=0,
    )


def _plot(origin: str, name: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin=origin, name=name)


def _lanes() -> rrb.Tabs:
    return rrb.Tabs(
        rrb.StateTimelineView(origin="lanes", name="what is going on"),
        rrb.TextDocumentView(origin="plan/report", name="plan"),
        active_tab=0,
    )


def _words() -> rrb.TextLogView:
    columns = rrb.TextLogColumns(timeline_columns=["capture_time"], text_log_columns=["LogLevel", "Body"])
    return rrb.TextLogView(origin="log", name="log", columns=columns)
