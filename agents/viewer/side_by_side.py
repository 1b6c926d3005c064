"""A recording and its replay in one Rerun file.

recorded, replayed      what each shows, with the paths of live_mapping below
difference              how far they are apart: a curve for each field of each topic
"""

import math
import pathlib
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float64

from agents.viewer import colours
from agents.viewer.entity import BY_FRAME, Moment, Thinning, reconstruction_in_mm
from agents.viewer.layout import FLAT, VIEWPOINT
from agents.viewer.live_mapping import LiveMapping
from agents.viewer.showing import moment_of
from agents.viewer.sinks import file_sink
from schemas.messages import Status, ThreadReconstruction
from schemas.topics import Topic
from shared.images import ImageDataError

RECORDED, REPLAYED, DIFFERENCE = "recorded", "replayed", "difference"
SIDES = (RECORDED, REPLAYED)
TYPICAL_MM = 95.0
CLOSER = 0.75
DRAWN_ON_IMAGES = (
    "world/thread/curve",
    "world/thread/other_course",
    "world/thread/ends",
    "world/plan/**",
    "world/tool/**",
)
CROWDING = ("world/observations/matched", "world/thread/control_points")


class SideBySide:
    """A file that both sides are shown in, in the order in which messages are handed over."""

    def __init__(self, path: pathlib.Path, name: str, curves: tuple[str, ...]) -> None:
        """Begin a file; `curves` are the paths of the differences to be shown, one view for each.

        Raises:
            ViewerError: where it cannot be written.
        """
        self._curves = curves
        self._sink = file_sink(path, name, side_by_side_layout(None, curves))
        self._mappings = {side: LiveMapping() for side in SIDES}
        self._thinning = {side: Thinning() for side in SIDES}
        self._laid_out = False

    def show(self, side: str, topic: Topic, key: str, message: Any, published_ns: int) -> None:
        """Show a message on one side; of fast topics without frames only as many as an eye can follow."""
        if topic not in BY_FRAME and not self._thinning[side].keeps(topic, key, published_ns):
            return
        try:
            entities = self._mappings[side].entities(message)
        except ImageDataError:
            return
        below = [(f"{side}/{path}", archetypes) for path, archetypes in entities]
        self._sink.log(moment_of(message, published_ns), below)
        if isinstance(message, ThreadReconstruction) and message.status is Status.OK and not self._laid_out:
            self._laid_out = True
            middle = np.median(reconstruction_in_mm(message).control_points_camera, axis=0)
            self._sink.lay_out(side_by_side_layout(middle, self._curves))

    def differ(self, moment: Moment, path: str, amount: float) -> None:
        """Add to the curve of one field; what no number tells apart leaves a gap."""
        self._sink.log(moment, [(f"{DIFFERENCE}/{path}", [rr.Scalars(amount if math.isfinite(amount) else math.nan)])])

    def close(self) -> None:
        """Finish the file."""
        self._sink.close()


def side_by_side_layout(middle: Float64[np.ndarray, "3"] | None, curves: tuple[str, ...]) -> rrb.Blueprint:
    """Space and left image of each side above each other, side by side, and the differences below."""
    eye = _eye(np.array([0.0, 0.0, TYPICAL_MM]) if middle is None else middle)
    sides = [rrb.Vertical(_space(side, eye), _image(side), row_shares=[3, 2]) for side in SIDES]
    plots = [rrb.TimeSeriesView(origin=f"{DIFFERENCE}/{curve}", name=f"difference of {curve}") for curve in curves]
    rows = [rrb.Horizontal(*sides), *([rrb.Horizontal(*plots)] if plots else [])]
    return rrb.Blueprint(
        rrb.Vertical(*rows, row_shares=[3, 1][: len(rows)]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="capture_time"),
    )


def _space(side: str, eye: rrb.EyeControls3D) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin=f"{side}/world",
        name=f"{side}: space",
        contents=["$origin/**", *(f"- {side}/{path}" for path in FLAT)],
        background=colours.BACKGROUND,
        line_grid=False,
        overrides={f"{side}/{path}": rrb.EntityBehavior(visible=False) for path in CROWDING},
        eye_controls=eye,
    )


def _image(side: str) -> rrb.Spatial2DView:
    drawn = [f"{side}/{path}" for path in (*DRAWN_ON_IMAGES, "world/observations/points")]
    return rrb.Spatial2DView(origin=f"{side}/world/left", name=f"{side}: left image", contents=["$origin/**", *drawn])


def _eye(middle: Float64[np.ndarray, "3"]) -> rrb.EyeControls3D:
    position = middle + CLOSER * middle[2] * np.array(VIEWPOINT)
    return rrb.EyeControls3D(position=position, look_target=middle, eye_up=[0.0, -1.0, 0.0])
