"""The way of a plan that keeps clear of the thread outside of the grasp, if there is one.

The likeliest capture and way come first. Where the instrument cannot keep clear of the thread there, the other ways of
that capture are tried, and then other captures, as long as they are not much less likely. Where all of them are
obstructed the likeliest is taken after all, and the plan says so.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.planner.captures import ArmView, Captures, Choice, way_of
from agents.planner.config import PlannerConfig
from agents.planner.curve import ThreadCurve
from agents.planner.entanglement import thread_clearance
from agents.planner.needle import NeedleAround
from agents.planner.ways import Ways
from schemas.messages import Phase, ThreadClearance, Waypoint


def waypoints(
    ways: Ways, way: tuple[int, int], s: Float64[np.ndarray, "n"], capture: int, goal: int, config: PlannerConfig
) -> tuple[Waypoint, ...]:
    """From before the capture to after the grasp.

    The jaws stay open until the thread is between them, close partly there, so that the thread can slide but not
    leave, and close at the goal.
    """
    opened, partly, closed = np.radians([config.open_deg, config.slide_deg, config.closed_deg])
    ray, side = way

    def on_thread(i: int, jaw_rad: float, phase: Phase) -> Waypoint:
        return Waypoint(ways.on_thread[ray, side, i], float(jaw_rad), phase, float(s[i]))

    step = 1 if goal > capture else -1
    slide = range(capture + step, goal + step, step) if goal != capture else ()
    return (
        Waypoint(ways.standoff[ray, side, capture], float(opened), Phase.APPROACH, None),
        on_thread(capture, opened, Phase.APPROACH),
        on_thread(capture, partly, Phase.CAPTURE),
        *(on_thread(i, partly, Phase.SLIDE) for i in slide),
        on_thread(goal, closed, Phase.GRASP),
        Waypoint(ways.lifted[ray, side, goal], float(closed), Phase.RETREAT, None),
    )


WORTH = 0.05
"""How much probability clearance is worth."""
TRIED = 24


@dataclass(frozen=True)
class ClearWay:
    """What is carried out: capture, way and side of the jaws, with its waypoints and how they stand to the thread."""

    capture: int
    way: tuple[int, int]
    probability: float
    waypoints: tuple[Waypoint, ...]
    thread: ThreadClearance


def clear_way(
    choice: Choice,
    chosen: int,
    curve: ThreadCurve,
    arm: ArmView,
    needle: NeedleAround | None = None,
    beside: Float64[np.ndarray, "k 3"] | None = None,
) -> ClearWay:
    """The chosen capture, or what stands in for it."""
    captures, config = choice.captures, choice.config
    first: ClearWay | None = None
    for capture, way in _candidates(captures, chosen, arm):
        led = waypoints(captures.ways, way, captures.s, capture, captures.goal, config)
        stands = thread_clearance(curve, led, arm.T_camera_base, config, needle, beside)
        by_way = captures.probability[capture] if captures.by_way is None else captures.by_way[way[0], capture]
        found = ClearWay(capture, way, float(by_way), led, stands)
        if not stands.obstructed:
            return found
        first = first or found
    assert first is not None  # noqa: S101 - the chosen capture is the first candidate
    return first


def _candidates(captures: Captures, chosen: int, arm: ArmView) -> Iterator[tuple[int, tuple[int, int]]]:
    best = way_of(captures, chosen, arm)
    yield chosen, best
    if captures.by_way is None:
        return
    here = np.arange(len(captures.s)) == chosen
    open_here = captures.usable & (captures.against < 0)
    likely = np.where(open_here, captures.by_way[:, None], -1.0)
    enough = likely >= max(captures.by_way[best[0], chosen] - WORTH, 0.0)
    # other ways of the same capture first, then captures by how likely they are
    ranked = sorted(
        ((not here[i], -likely[w, side, i], abs(i - captures.goal), w, side, i) for w, side, i in np.argwhere(enough)),
    )
    others = [(int(i), (int(w), int(side))) for *_, w, side, i in ranked if (i, (w, side)) != (chosen, best)]
    at_chosen = [one for one in others if one[0] == chosen]
    elsewhere = [one for one in others if one[0] != chosen]
    few = elsewhere[:: max(1, len(elsewhere) // TRIED)][:TRIED]
    yield from at_chosen
    yield from few
