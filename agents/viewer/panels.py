"""The views that layouts are put together from."""

from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb
from jaxtyping import Float64

from agents.viewer import colours
from agents.viewer.recording_layout import FLAT, VIEWPOINT

TYPICAL_MM = 95.0
"""Where a thread is looked for before one has been seen: the middle of an endoscope's working range."""

DRAWN_ON_IMAGES = ("world/thread/curve", "world/thread/other_course", "world/thread/ends", "world/shown/**")
OF_GRASP = ("world/plan/**", "world/tool/**")

HIDDEN_IN_SPACE = ("world/observations/matched", "world/thread/control_points")
"""What crowds the thread; the eye symbol in the blueprint panel brings it back."""

ONLY_ON_IMAGES = (*FLAT, "world/left/match_cost", "world/left/tool/**", "world/right/tool/**")
NEWEST_FREE = rrb.Corner2D.LeftTop
"""Where a legend hides what is oldest."""


@dataclass(frozen=True)
class Scene:
    """What is known of what is to be shown, as far as a layout depends on it.

    Fields:
        middle_camera: what the eye turns about, in the unit of space; None before a thread was seen.
        unit: of space.
        raw_images: whether the camera's images are not rectified.
        matched: whether perception matches pixels, as the paper's method does.
        posterior: whether the reconstruction predicts how far it may be off.
        tracked: whether an instrument is looked for in the images.
    """

    middle_camera: Float64[np.ndarray, "3"] | None = None
    unit: str = "mm"
    raw_images: bool = False
    matched: bool = False
    posterior: bool = True
    tracked: bool = False


def space(scene: Scene, closer: float, without: tuple[str, ...] = ()) -> rrb.Spatial3DView:
    """Space, looked at from behind the cameras; `closer` is below 1 for an eye nearer to the thread."""
    return rrb.Spatial3DView(
        origin="world",
        name=f"space, {scene.unit}",
        contents=["$origin/**", *(f"- {path}" for path in (*ONLY_ON_IMAGES, *without))],
        background=colours.BACKGROUND,
        line_grid=False,
        overrides={path: rrb.EntityBehavior(visible=False) for path in HIDDEN_IN_SPACE},
        eye_controls=_eye(scene.middle_camera, closer),
    )


def eye(
    side: str, scene: Scene, grasp: bool = True, name: str = "", without: tuple[str, ...] = ()
) -> rrb.View | rrb.Tabs:
    """One image with the thread, and with plan and tool where asked for; and the raw one, where there is such."""
    observed = ["world/observations/points"] if side == "left" else []
    hidden = [f"- world/{side}/match_cost", *(f"- {path}" for path in without)]
    shown = ["$origin/**", *DRAWN_ON_IMAGES, *(OF_GRASP if grasp else ()), *observed, *hidden]
    view = rrb.Spatial2DView(origin=f"world/{side}", name=name or side, contents=shown)
    if not scene.raw_images:
        return view
    return rrb.Tabs(rrb.Spatial2DView(origin=f"camera/raw/{side}", name=f"{side}, not rectified"), view)


def score() -> rrb.Spatial2DView:
    """How much of each pixel the segmenter takes for thread."""
    return rrb.Spatial2DView(origin="perception/score", name="score of the segmenter, left")


def match_cost() -> rrb.Spatial2DView:
    """The matched pixels over the left image, and nothing else."""
    return rrb.Spatial2DView(
        origin="world/left",
        name="matches: green where no other costs as little",
        contents=["world/left", "world/left/image", "world/left/match_cost"],
    )


def curves(
    origin: str,
    name: str,
    contents: str | list[str] = "$origin/**",
    legend: bool = True,
    between: tuple[float, float] | None = None,
) -> rrb.TimeSeriesView:
    """Numbers over time; without a legend, a curve tells its name where the mouse is on it."""
    looks = rrb.PlotLegend(NEWEST_FREE, visible=legend)
    axis = None if between is None else rrb.ScalarAxis(range=between)
    return rrb.TimeSeriesView(origin=origin, name=name, contents=contents, plot_legend=looks, axis_y=axis)


def shares(scene: Scene) -> rrb.TimeSeriesView:
    """What of the thread is unseen, what of the centrelines left over, and what of the matched pixels kept."""
    contents = ["$origin/**", *(["match/kept"] if scene.matched else [])]
    return curves("share", "shares of the thread and its images", contents, between=(-0.02, 1.0))


def deviation(scene: Scene) -> rrb.TimeSeriesView:
    """The deviation over time, without the chart that lies beside it."""
    return curves("deviation", f"deviation, {scene.unit}", ["deviation/mean", "deviation/worst"])


def bars(origin: str, name: str, legend: bool = False, corner: rrb.Corner2D = rrb.Corner2D.LeftTop) -> rrb.BarChartView:
    """A chart along the thread, or of how often what occurs."""
    looks = rrb.PlotLegend(corner, visible=legend)
    return rrb.BarChartView(origin=origin, name=name, plot_legend=looks)


def lanes(name: str = "what is going on", contents: list[str] | None = None) -> rrb.StateTimelineView:
    """What each stage, arm and grasp is at."""
    return rrb.StateTimelineView(origin="lanes", name=name, contents=contents or ["$origin/**"])


def words(name: str = "log", contents: list[str] | None = None) -> rrb.TextLogView:
    """What was said."""
    columns = rrb.TextLogColumns(timeline_columns=["capture_time"], text_log_columns=["LogLevel", "Body"])
    return rrb.TextLogView(origin="log", name=name, contents=contents or ["$origin/**"], columns=columns)


def document(origin: str, name: str) -> rrb.TextDocumentView:
    """A text."""
    return rrb.TextDocumentView(origin=origin, name=name)


def dataflow() -> rrb.GraphView:
    """Agents and topics."""
    return rrb.GraphView(origin="dataflow/graph", name="dataflow, with what is published per second")


def _eye(middle_camera: Float64[np.ndarray, "3"] | None, closer: float) -> rrb.EyeControls3D:
    middle = np.array([0.0, 0.0, TYPICAL_MM]) if middle_camera is None else middle_camera
    position = middle + closer * middle[2] * np.array(VIEWPOINT)
    return rrb.EyeControls3D(position=position, look_target=middle, eye_up=[0.0, -1.0, 0.0])
