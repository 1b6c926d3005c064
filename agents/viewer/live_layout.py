"""How a session is laid out, for what one is there for: operating, perception, a grasp, or timing."""

from collections.abc import Callable, Sequence

import rerun.blueprint as rrb

from agents.viewer import panels
from agents.viewer.panels import Scene

CLOSER = 0.75
"""How much nearer than in a picture of one reconstruction the eye is: there is less room."""

DEFAULT = "operate"


def live_layout(name: str, scene: Scene) -> rrb.Blueprint:
    """The layout of that name; all of them show the same recording, on one timeline."""
    return rrb.Blueprint(
        LAYOUTS[name](scene),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="capture_time"),
    )


SEEING = [f"lanes/{stage}" for stage in ("perception", "reconstruction", "track")]
WORKING = ["$origin/**", "- lanes/track"]
GRASPING = ["$origin/**", *(f"- {path}" for path in SEEING)]


def operate(scene: Scene) -> rrb.Vertical:
    """Space and both eyes; below them trust, latency, what is going on, and the log."""
    return rrb.Vertical(
        rrb.Horizontal(
            panels.space(scene, CLOSER),
            rrb.Vertical(panels.eye("left", scene), panels.eye("right", scene)),
            column_shares=[3, 2],
        ),
        rrb.Horizontal(
            rrb.Tabs(
                panels.curves("residual_px", "residual, px"),
                *([panels.deviation(scene)] if scene.posterior else []),
                panels.shares(scene),
                *([panels.curves("tool", "tools: off their registration, and deviation, mm")] if scene.tracked else []),
                active_tab=0,
            ),
            rrb.Tabs(
                panels.curves("latency", "latency since capture, ms"),
                panels.curves("health/lost", "lost or refused, by input", legend=False),
                panels.curves("viewer", "of the viewer"),
                active_tab=0,
            ),
            rrb.Tabs(
                panels.lanes(contents=WORKING),
                panels.document("plan/report", "plan"),
                panels.document("plan/check", "seen after the grasp"),
                active_tab=0,
            ),
            panels.words(),
            column_shares=[3, 3, 4, 4],
        ),
        row_shares=[2, 1],
    )


def perception(scene: Scene) -> rrb.Vertical:
    """Both images with what was seen in them, and how well the curve explains it."""
    eyes = [panels.eye(side, scene, grasp=False) for side in ("left", "right")]
    confidence = panels.bars("confidence", "confidence along s")
    stages = panels.curves("stage_ms", "from a stage's input to its result, ms")
    trust: list[Sequence[rrb.View | rrb.Container]] = [
        [panels.curves("residual_px", "residual, px"), panels.shares(scene)]
    ]
    if scene.matched:
        eyes.append(panels.match_cost())
        costs = panels.curves("match/cost", "match costs, median of a frame")
        trust.append(
            [panels.bars("match/histogram", "matched pixels by cost", legend=True, corner=rrb.Corner2D.RightTop), costs]
        )
    if scene.posterior:
        along = panels.bars("deviation/along_s", f"deviation along s, {scene.unit}")
        trust += [[along, confidence], [panels.deviation(scene), stages]]
    else:
        trust.append([confidence, stages])
    spoke = [f"log/{agent}/**" for agent in ("perception", "tool_tracker", "needle", "reconstruction")]
    said = panels.words("log of what is seen", spoke)
    words = rrb.Tabs(panels.document("perception/verdict", "verdict on the images, and threads"), said, active_tab=0)
    trust.append([rrb.Tabs(panels.score(), panels.lanes(contents=SEEING), active_tab=0), words])
    return rrb.Vertical(
        rrb.Horizontal(*eyes),
        rrb.Horizontal(*(rrb.Vertical(*column) for column in trust), column_shares=[3] * (len(trust) - 1) + [4]),
        row_shares=[4, 5] if scene.matched else [5, 4],
    )


def grasp(scene: Scene) -> rrb.Horizontal:
    """The plan in space and in the left image, why others lost, and how the arm carries it out."""
    return rrb.Horizontal(
        rrb.Vertical(
            panels.space(scene, 0.5, without=("world/surface",)),
            rrb.Horizontal(
                panels.lanes(contents=GRASPING),
                panels.bars("plan/considered", "captures along s: success in %, by what lost them", legend=True),
            ),
            row_shares=[5, 3],
        ),
        rrb.Vertical(
            panels.eye("left", scene),
            rrb.Tabs(
                panels.document("plan/report", "plan"),
                panels.document("plan/check", "seen after the grasp"),
                active_tab=0,
            ),
            rrb.Tabs(
                panels.curves("robot/jaw_deg", "jaw, degrees"),
                panels.curves("robot/joints", "joints, rad and m"),
                panels.words(),
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
            panels.dataflow(),
            rrb.Vertical(
                panels.curves("latency", "latency since capture, ms"),
                panels.curves("stage_ms", "from a stage's input to its result, ms"),
            ),
            column_shares=[3, 2],
        ),
        rrb.Horizontal(
            rrb.Tabs(
                panels.document("dataflow/table", "health"),
                panels.curves("health/rate_hz", "published, Hz"),
                panels.curves("health/step_ms", "step times, ms"),
                active_tab=0,
            ),
            rrb.Tabs(
                panels.curves("health/lost", "lost or refused, by input", legend=False),
                panels.curves("health/replaced", "replaced by newer", legend=False),
                panels.curves("viewer", "of the viewer"),
                active_tab=0,
            ),
            rrb.Tabs(
                panels.curves("clock", "arrival, ms"),
                panels.curves("health/age_ms", "age of inputs, ms", legend=False),
                active_tab=0,
            ),
            panels.words(),
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
