"""How the jaws stand to the tissue, for every capture and way of a goal, and in words."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from agents.planner.config import PlannerConfig
from agents.planner.jaws import Nearest, aside_pass, capture_pass, grasp_pass, nearest_to_tissue, slide_pass
from agents.planner.tissue import Tissue
from agents.planner.ways import UNTILTED, Ways, along_slide
from schemas.messages import FrameStamp, Phase, TissueClearance

MM_PER_M = 1e3


@dataclass(frozen=True)
class SeenTissue:
    """The tissue that a plan is checked against.

    Fields:
        tissue: None where there is none of use, and then `unchecked` says why.
        stamp: of the frame that it was seen in.
    """

    tissue: Tissue | None
    stamp: FrameStamp | None
    unchecked: str


NOTHING_SEEN = SeenTissue(None, None, "nothing was told of it")


@dataclass(frozen=True)
class Standing:
    """For each way and capture, of a grasp with a slide from there to the goal.

    Fields:
        bound_m: the least clearance less its deviations; inf where nothing is known, -inf where it was not looked at.
        known: whether all places that the jaws pass have known tissue before or behind them.
    """

    bound_m: Float64[np.ndarray, "w n"]
    known: Bool[np.ndarray, "w n"]


def standings(
    tissue: Tissue, ways: Ways, goal: int, open_ways: Bool[np.ndarray, "w n"], config: PlannerConfig
) -> Standing:
    """How the jaws stand to the tissue in each grasp that is open; tilted only where no other approach will do."""
    tilted = np.arange(len(open_ways))[:, None] >= UNTILTED
    straight = _standing(tissue, ways, goal, open_ways & ~tilted, config)
    enough = accepted(straight, config).any(axis=0)
    others = _standing(tissue, ways, goal, open_ways & tilted & ~enough, config)
    return Standing(np.maximum(straight.bound_m, others.bound_m), straight.known | others.known)


def accepted(standing: Standing, config: PlannerConfig) -> Bool[np.ndarray, "w n"]:
    """Which grasps press in no deeper than is accepted, and pass no unknown tissue where that is asked for."""
    return (standing.bound_m >= -config.press_m) & (standing.known | (not config.tissue_required))


def _standing(tissue: Tissue, ways: Ways, goal: int, asked: Bool[np.ndarray, "w n"], config: PlannerConfig) -> Standing:
    on_thread = ways.on_thread[:, 0]
    bound = np.full(asked.shape, -np.inf)
    known = np.zeros(asked.shape, bool)
    for way in np.flatnonzero(asked.any(axis=1)):
        wanted = np.flatnonzero(asked[way])
        between = slice(min(goal, wanted[0]), max(goal, wanted[-1]) + 1)
        captured = nearest_to_tissue(tissue, on_thread[way, wanted], capture_pass(config), config)
        closed = nearest_to_tissue(tissue, on_thread[way, [goal]], grasp_pass(config), config)
        along = nearest_to_tissue(tissue, on_thread[way, between], slide_pass(config), config)
        least, all_known = _to_goal(along, goal - between.start)
        here = wanted - between.start
        bound[way, wanted] = np.minimum.reduce(
            [captured.bound_m, least[here], np.broadcast_to(closed.bound_m, wanted.shape)]
        )
        known[way, wanted] = (captured.known == 1) & all_known[here] & (closed.known == 1)
    return Standing(bound, known)


def _to_goal(along: Nearest, goal: int) -> tuple[Float64[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    after = np.minimum.accumulate(along.bound_m[goal:])
    before = np.minimum.accumulate(along.bound_m[goal::-1])[::-1]
    return np.concatenate((before[:-1], after)), along_slide(along.known == 1, goal)


def clearance_of(
    seen: SeenTissue,
    ways: Ways,
    way: int,
    s: Float64[np.ndarray, "n"],
    capture: int,
    goal: int,
    config: PlannerConfig,
    aside: Float64[np.ndarray, "k 4 4"],
) -> TissueClearance:
    """How the jaws of one grasp stand to the tissue, as a plan tells it.

    Args:
        aside: poses of the closed jaws after the lift.
    """
    if seen.tissue is None:
        return TissueClearance(seen.stamp, f"not checked against tissue: {seen.unchecked}", 0.0)
    on_thread = ways.on_thread[way, 0]
    slid = np.arange(min(capture, goal), max(capture, goal) + 1)
    passes = (
        (on_thread[[capture]], s[[capture]], capture_pass(config)),
        *([(on_thread[slid], s[slid], slide_pass(config))] if goal != capture else []),
        (on_thread[[goal]], s[[goal]], grasp_pass(config)),
        *([(aside, np.full(len(aside), s[goal]), aside_pass(config))] if len(aside) else []),
    )
    found: list[tuple[Nearest, int, Phase, float]] = []
    known, places = 0.0, 0
    for poses, at_s, passed in passes:
        near = nearest_to_tissue(seen.tissue, poses, passed, config)
        known += float(near.known.sum()) * len(passed.jaw_rad)
        places += len(poses) * len(passed.jaw_rad)
        found += [(near, i, passed.phase[near.step[i]], float(at)) for i, at in enumerate(at_s)]
    share = min(known / places, 1.0)
    if share == 0:
        return TissueClearance(seen.stamp, "not checked against tissue: none was measured there", 0.0)
    near, i, phase, at = min(found, key=lambda one: one[0].bound_m[one[1]])
    unknown = 1.0 - share
    return TissueClearance(
        stamp=seen.stamp,
        unchecked=f"{unknown:.0%} of the way not checked against tissue: none was measured there" if unknown else "",
        known_share=share,
        clearance_m=float(near.clearance_m[i]),
        deviation_m=float(near.deviation_m[i]),
        place_camera=near.place_camera[i],
        phase=phase,
        s=at,
    )


def pressed_sentence(found: TissueClearance, config: PlannerConfig) -> str:
    """How deep the jaws would press in, where, and what to do about it; empty where nothing was checked."""
    if found.clearance_m is None or found.deviation_m is None or found.s is None or found.phase is None:
        return ""
    deep, sure = -MM_PER_M * found.clearance_m, MM_PER_M * found.deviation_m
    depth = f"{deep:.1f} mm (± {sure:.1f} mm) into" if deep > 0 else f"{-deep:.1f} mm (± {sure:.1f} mm) before"
    return (
        f"the jaws would come {depth} the tissue at s = {found.s:.3f} in the phase {found.phase.name.lower()}, and at "
        f"most {MM_PER_M * config.press_m:.1f} mm are accepted with {config.sigmas:g} deviations; name another place, "
        "lift the thread there, or, if it truly lies on the tissue, check the calibration: its depth is wrong then"
    )
