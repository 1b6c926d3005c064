"""How Rerun lays out a session for what one is there for, such as operating or timing."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb
from jaxtyping import Float64

from agents.viewer import colours
from agents.viewer.entity import SIDES
from agents.viewer.polyline import EXAGGERATION

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


TYPICAL_MM = 95.0
"""Where a thread is looked for before one has been seen: the middle of an endoscope's working range."""

THREAD_DRAWN = ("world/thread/curve", "world/thread/strands", "world/thread/other_course", "world/thread/ends")
DRAWN_ON_IMAGES = (*THREAD_DRAWN, "world/shown/**")
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
        pulled: whether thread is pulled through tissue.
    """

    middle_camera: Float64[np.ndarray, "3"] | None = None
    unit: str = "mm"
    raw_images: bool = False
    matched: bool = False
    posterior: bool = True
    tracked: bool = False
    pulled: bool = False


def space(scene: Scene, closer: float, without: tuple[str, ...] = ()) -> rrb.Spatial3DView:
    """Space, looked at from behind the cameras; `closer` is below 1 for an eye nearer to the thread."""
    name, controls = f"space, {scene.unit}", middle_in_sight(scene.middle_camera, closer)
    return space_below("world", name, controls, without=(*ONLY_ON_IMAGES, *without), hidden=HIDDEN_IN_SPACE)


def space_below(
    origin: str, name: str, controls: rrb.EyeControls3D, without: Iterable[str], hidden: Iterable[str] = ()
) -> rrb.Spatial3DView:
    """Space below an entity, but for what is left out; what is hidden can be made visible again."""
    return rrb.Spatial3DView(
        origin=origin,
        name=name,
        contents=["$origin/**", *(f"- {path}" for path in without)],
        background=colours.BACKGROUND,
        line_grid=False,
        overrides={path: rrb.EntityBehavior(visible=False) for path in hidden},
        eye_controls=controls,
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


CLOSER = 0.75
"""How much nearer than in a picture of one reconstruction the eye is: there is less room."""


def middle_in_sight(middle_camera: Float64[np.ndarray, "3"] | None, closer: float = CLOSER) -> rrb.EyeControls3D:
    """An eye on the middle of the thread; before one was seen, on where threads mostly are."""
    middle = np.array([0.0, 0.0, TYPICAL_MM]) if middle_camera is None else middle_camera
    return looking_at(middle, closer * middle[2])


def looking_at(target: Float64[np.ndarray, "3"], distance: float) -> rrb.EyeControls3D:
    """An eye behind the cameras, to the right and above, so that depth can be seen."""
    position = target + distance * np.array(VIEWPOINT)
    return rrb.EyeControls3D(position=position, look_target=target, eye_up=[0.0, -1.0, 0.0])


def arranged(views: rrb.Container, timeline: str = "capture_time") -> rrb.Blueprint:
    """Views without Rerun's own panels about them."""
    return rrb.Blueprint(
        views,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline),
    )


DEFAULT = "operate"


def live_layout(name: str, scene: Scene) -> rrb.Blueprint:
    """The layout of that name; all of them show the same recording, on one timeline."""
    return arranged(LAYOUTS[name](scene))


SEEING = [f"lanes/{stage}" for stage in ("perception", "reconstruction", "track")]
WORKING = ["$origin/**", "- lanes/track"]
GRASPING = ["$origin/**", *(f"- {path}" for path in SEEING)]


def operate(scene: Scene) -> rrb.Vertical:
    """Space and both eyes; below them trust, latency, what is going on, and the log."""
    return rrb.Vertical(
        rrb.Horizontal(
            space(scene, CLOSER),
            rrb.Vertical(eye("left", scene), eye("right", scene)),
            column_shares=[3, 2],
        ),
        rrb.Horizontal(
            rrb.Tabs(
                curves("residual_px", "residual, px"),
                *([deviation(scene)] if scene.posterior else []),
                shares(scene),
                *([curves("tool", "tools: off their registration, and deviation, mm")] if scene.tracked else []),
                *([curves("tail", "tail and what ran of it, mm")] if scene.pulled else []),
                active_tab=0,
            ),
            rrb.Tabs(
                curves("latency", "latency since capture, ms"),
                curves("health/lost", "lost or refused, by input", legend=False),
                curves("viewer", "of the viewer"),
                active_tab=0,
            ),
            rrb.Tabs(
                lanes(contents=WORKING),
                document("plan/report", "plan"),
                document("plan/check", "seen after the grasp"),
                active_tab=0,
            ),
            words(),
            column_shares=[3, 3, 4, 4],
        ),
        row_shares=[2, 1],
    )


def perception(scene: Scene) -> rrb.Vertical:
    """Both images with what was seen in them, and how well the curve explains it."""
    eyes = [eye(side, scene, grasp=False) for side in ("left", "right")]
    confidence = bars("confidence", "confidence along s")
    stages = curves("stage_ms", "from a stage's input to its result, ms")
    trust: list[Sequence[rrb.View | rrb.Container]] = [[curves("residual_px", "residual, px"), shares(scene)]]
    if scene.matched:
        eyes.append(match_cost())
        costs = curves("match/cost", "match costs, median of a frame")
        trust.append(
            [bars("match/histogram", "matched pixels by cost", legend=True, corner=rrb.Corner2D.RightTop), costs]
        )
    if scene.posterior:
        along = bars("deviation/along_s", f"deviation along s, {scene.unit}")
        trust += [[along, confidence], [deviation(scene), stages]]
    else:
        trust.append([confidence, stages])
    spoke = [f"log/{agent}/**" for agent in ("perception", "tool_tracker", "needle", "reconstruction")]
    said = words("log of what is seen", spoke)
    verdict = rrb.Tabs(document("perception/verdict", "verdict on the images, and threads"), said, active_tab=0)
    trust.append([rrb.Tabs(score(), lanes(contents=SEEING), active_tab=0), verdict])
    return rrb.Vertical(
        rrb.Horizontal(*eyes),
        rrb.Horizontal(*(rrb.Vertical(*column) for column in trust), column_shares=[3] * (len(trust) - 1) + [4]),
        row_shares=[4, 5] if scene.matched else [5, 4],
    )


def grasp(scene: Scene) -> rrb.Horizontal:
    """The plan in space and in the left image, why others lost, and how the arm carries it out."""
    return rrb.Horizontal(
        rrb.Vertical(
            space(scene, 0.5, without=("world/surface",)),
            rrb.Horizontal(
                lanes(contents=GRASPING),
                bars("plan/considered", "captures along s: success in %, by what lost them", legend=True),
            ),
            row_shares=[5, 3],
        ),
        rrb.Vertical(
            eye("left", scene),
            rrb.Tabs(
                document("plan/report", "plan"),
                document("plan/check", "seen after the grasp"),
                active_tab=0,
            ),
            rrb.Tabs(
                curves("robot/jaw_deg", "jaw, degrees"),
                curves("robot/joints", "joints, rad and m"),
                words(),
                active_tab=0,
            ),
            row_shares=[5, 5, 4],
        ),
        column_shares=[3, 2],
    )


def timing(_: Scene) -> rrb.Vertical:
    """The dataflow with its rates, latencies, losses, clocks and health."""
    return rrb.Vertical(
        rrb.Horizontal(
            dataflow(),
            rrb.Vertical(
                curves("latency", "latency since capture, ms"),
                curves("stage_ms", "from a stage's input to its result, ms"),
            ),
            column_shares=[3, 2],
        ),
        rrb.Horizontal(
            rrb.Tabs(
                document("dataflow/table", "health"),
                curves("health/rate_hz", "published, Hz"),
                curves("health/step_ms", "step times, ms"),
                active_tab=0,
            ),
            rrb.Tabs(
                curves("health/lost", "lost or refused, by input", legend=False),
                curves("health/replaced", "replaced by newer", legend=False),
                curves("viewer", "of the viewer"),
                active_tab=0,
            ),
            rrb.Tabs(
                curves("clock", "arrival, ms"),
                curves("health/age_ms", "age of inputs, ms", legend=False),
                active_tab=0,
            ),
            words(),
            column_shares=[5, 3, 3, 4],
        ),
        row_shares=[5, 3],
    )


LAYOUTS: dict[str, Callable[[Scene], rrb.Container]] = {
    "operate": operate,
    "perception": perception,
    "grasp": grasp,
    "timing": timing,
}
