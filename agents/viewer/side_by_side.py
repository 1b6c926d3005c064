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

from agents.viewer.entity import BY_FRAME, Moment, Thinning
from agents.viewer.layout import FLAT, HIDDEN_IN_SPACE, OF_GRASP, THREAD_DRAWN, arranged, middle_in_sight, space_below
from agents.viewer.live_mapping import LiveMapping
from agents.viewer.showing import moment_of
from agents.viewer.sinks import file_sink
from schemas.topics import Topic
from shared.images import ImageDataError

RECORDED, REPLAYED, DIFFERENCE = "recorded", "replayed", "difference"
SIDES = (RECORDED, REPLAYED)


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
        middle = self._mappings[side].scene.middle_camera
        if middle is not None and not self._laid_out:
            self._laid_out = True
            self._sink.lay_out(side_by_side_layout(middle, self._curves))

    def differ(self, moment: Moment, path: str, amount: float) -> None:
        """Add to the curve of one field; what no number tells apart leaves a gap."""
        self._sink.log(moment, [(f"{DIFFERENCE}/{path}", [rr.Scalars(amount if math.isfinite(amount) else math.nan)])])

    def close(self) -> None:
        """Finish the file."""
        self._sink.close()


def side_by_side_layout(middle: Float64[np.ndarray, "3"] | None, curves: tuple[str, ...]) -> rrb.Blueprint:
    """Space and left image of each side above each other, side by side, and the differences below."""
    sides = [rrb.Vertical(_space(side, middle), _image(side), row_shares=[3, 2]) for side in SIDES]
    plots = [rrb.TimeSeriesView(origin=f"{DIFFERENCE}/{curve}", name=f"difference of {curve}") for curve in curves]
    rows = [rrb.Horizontal(*sides), *([rrb.Horizontal(*plots)] if plots else [])]
    return arranged(rrb.Vertical(*rows, row_shares=[3, 1][: len(rows)]))


def _space(side: str, middle: Float64[np.ndarray, "3"] | None) -> rrb.Spatial3DView:
    without, hidden = ([f"{side}/{path}" for path in paths] for paths in (FLAT, HIDDEN_IN_SPACE))
    return space_below(f"{side}/world", f"{side}: space", middle_in_sight(middle), without, hidden)


def _image(side: str) -> rrb.Spatial2DView:
    drawn = [f"{side}/{path}" for path in (*THREAD_DRAWN, *OF_GRASP, "world/observations/points")]
    return rrb.Spatial2DView(origin=f"{side}/world/left", name=f"{side}: left image", contents=["$origin/**", *drawn])
