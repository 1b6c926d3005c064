"""The captures that a plan weighed, as Rerun shows them: where each lies, how likely it is, and what lost it.

world/plan/{arm}/considered     the captures on the thread of the frame that the plan was made from, each in the colour
                                of what spoke against it, with its probability of success beside it
plan/considered/{reason}        a chart along s, with one entity for each reason, so that its legend is theirs
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
import rerun as rr
from jaxtyping import Float64

from agents.viewer import colours
from agents.viewer.entity import Entity
from agents.viewer.polyline import Polyline, thread_polyline
from schemas.messages import FrameStamp, GraspPlan, Status, ThreadReconstruction

CHOSEN, GOAL = "chosen", "goal"
BAR_S = 0.025
KEPT = 60
"""Threads that a plan may come from: some seconds at the rate that is shown."""

LATE_NS = 1_000_000_000
"""How far from its own frame a thread may be that stands in for one that was left out; it moves little until then."""


HEADROOM = rr.BarChart(
    np.array([0.0, 165.0, 0.0]),
    abscissa=np.array([0.0, 0.5, 1.0]),
    widths=np.full(3, 1e-4, np.float32),
    color=colours.BACKGROUND,
)
"""Nothing to be seen: the chart spans the whole thread, with room for its legend above 100 %."""


@dataclass(frozen=True)
class Capture:
    """A place along the thread that was weighed: at `s`, with that probability of success, and what became of it."""

    s: float
    probability: float
    why: str


@dataclass
class Considered:
    """Remembers the last threads, and which colour each reason has."""

    _threads: deque[ThreadReconstruction] = field(default_factory=lambda: deque(maxlen=KEPT))
    _colours: dict[str, tuple[int, int, int]] = field(
        default_factory=lambda: {CHOSEN: colours.CHOSEN, GOAL: colours.TEXT}
    )

    def saw(self, reconstruction: ThreadReconstruction) -> None:
        """Remember a thread, in the unit of space."""
        if reconstruction.status is Status.OK:
            self._threads.append(reconstruction)

    def entities(self, plan: GraspPlan) -> list[Entity]:
        """The captures of a plan in space and as a chart; a plan without any empties both."""
        captures = captures_of(plan)
        for capture in captures:
            self._colours.setdefault(capture.why, self._new_colour())
        thread = self._thread_of(plan.stamp)
        arm = rr.escape_entity_path_part(plan.arm)
        return [(f"world/plan/{arm}/considered", [self._points(captures, thread)]), *self._bars(captures)]

    def _new_colour(self) -> tuple[int, int, int]:
        return colours.REASONS[(len(self._colours) - 2) % len(colours.REASONS)]

    def _thread_of(self, stamp: FrameStamp) -> Polyline | None:
        """The thread of that frame, or, where it was left out, the nearest one in time."""
        away_ns = [abs(thread.stamp.capture_left_ns - stamp.capture_left_ns) for thread in self._threads]
        if not away_ns or min(away_ns) > LATE_NS:
            return None
        return thread_polyline(self._threads[int(np.argmin(away_ns))])

    def _points(self, captures: list[Capture], thread: Polyline | None) -> rr.Points3D:
        if thread is None or not captures:
            return rr.Points3D([])
        places = points_at(thread, np.array([capture.s for capture in captures]))
        return rr.Points3D(
            places,
            colors=[self._colours[capture.why] for capture in captures],
            labels=[label_of(capture) for capture in captures],
            radii=[-7.0 if capture.why == CHOSEN else -5.0 for capture in captures],
            show_labels=True,
        )

    def _bars(self, captures: list[Capture]) -> list[Entity]:
        shown = [(why, rgb) for why, rgb in self._colours.items() if why != GOAL]
        bars = [(f"plan/considered/{name_of(why)}", [_bar(captures, why, rgb)]) for why, rgb in shown]
        return [*bars, ("plan/considered/s_from_0_to_1", [HEADROOM])]


def captures_of(plan: GraspPlan) -> list[Capture]:
    """Every capture that a plan tells of, the chosen one and the goal included."""
    found = [Capture(other.s_capture, other.probability, other.reason or "not told") for other in plan.alternatives]
    if plan.s_capture is not None:
        found.append(Capture(plan.s_capture, plan.probability, CHOSEN))
    # a goal beside the chosen capture would hide it, and the plan tells where it is
    if plan.s_goal is not None and plan.s_goal not in [capture.s for capture in found] and plan.s_capture is None:
        found.append(Capture(plan.s_goal, plan.probability, GOAL))
    return found


def label_of(capture: Capture) -> str:
    """What stands beside a capture."""
    if capture.why == GOAL:
        return GOAL
    return f"{capture.probability:.0%}{f' {CHOSEN}' if capture.why == CHOSEN else ''}"


def name_of(why: str) -> str:
    """A reason as a legend shows it: one part of a path, in which spaces would be escaped."""
    return rr.escape_entity_path_part(why.replace(" ", "_"))


def points_at(thread: Polyline, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n 3"]:
    """Points at shares of the thread's length."""
    return np.stack([np.interp(s, thread.along, axis) for axis in thread.points_camera.T], axis=1)


def _bar(captures: list[Capture], why: str, rgb: tuple[int, int, int]) -> rr.BarChart:
    found = [capture for capture in captures if capture.why == why]
    s = np.array([capture.s for capture in found] or [0.0])
    percent = np.array([100.0 * capture.probability for capture in found] or [0.0])
    return rr.BarChart(percent, abscissa=s, widths=np.full(len(s), BAR_S, np.float32), color=rgb)
