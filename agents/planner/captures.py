"""All captures for one goal: how likely each is, what speaks against it, and how the tool can be held for it;
and which of them, with which depth and opening of the jaws, a plan takes.

With the paper's model depth and openings are set. With the geometric one each combination of a depth, an opening for
the approach and one for the slide is a grip of its own. Of each depth the likeliest, as if nothing were in the way, is
looked at, from the likeliest on, until none of the rest can be likelier than what was found; so tissue is looked at for
few of them. Where nothing is found, the narrowest openings are tried, which other strands leave more room.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64

from agents.planner.chances import PAPER, aimed_with, chances
from agents.planner.config import PlannerConfig
from agents.planner.places import Places
from agents.planner.policy import Against, first_against, most_likely
from agents.planner.poses import turn_between
from agents.planner.tissue_clearance import SeenTissue, Standing, accepted, standings
from agents.planner.ways import UNTILTED, Reachable, Ways, along_slide, reached, steps_along_slide, ways_along
from schemas.messages import Policy

AS_LIKELY = 0.002
"""Ways whose probabilities differ by less are equals."""


@dataclass(frozen=True)
class ArmView:
    """An arm as a plan needs it: where its base and its tool are, and what it can reach."""

    T_camera_base: Float64[np.ndarray, "4 4"]
    T_camera_tool: Float64[np.ndarray, "4 4"]
    reachable: Reachable


@dataclass(frozen=True)
class Captures:
    """All captures for one goal with one depth and opening of the jaws.

    Fields:
        likelihood: of the whole grasp, by which captures are chosen.
        probability: of the whole grasp, which is stated.
        by_way: the same for each way to hold the tool; None where that makes no difference.
        against: what speaks against each, as in `first_against`.
        usable: for each way to hold the tool, whether it leads from the capture to the goal, past the tissue too.
        bound_m: of each approach, as in `Standing`; 0 where no tissue is known.
    """

    s: Float64[np.ndarray, "n"]
    goal: int
    likelihood: Float64[np.ndarray, "n"]
    probability: Float64[np.ndarray, "n"]
    by_way: Float64[np.ndarray, "w n"] | None
    against: Int64[np.ndarray, "n"]
    ways: Ways
    usable: Bool[np.ndarray, "w 2 n"]
    bound_m: Float64[np.ndarray, "w n"]


def captures_for(places: Places, arm: ArmView, config: PlannerConfig, tissue: SeenTissue) -> Captures:
    """Every capture that a goal can be reached from, with the jaws of a config, and what speaks against it."""
    s, goal, beside = places.s, places.goal, places.beside_m
    tilts_deg = config.tilts_deg if tissue.tissue is not None else ()
    ways = ways_along(places.aims_camera, places.tangents, arm.T_camera_base[:3, 3], config, tilts_deg)
    clear = along_slide(ways.clear, goal)
    steady = clear & steps_along_slide(ways.steady, goal)
    passable = steady[:, None] & reached(ways, goal, arm.reachable)
    likely = chances(places.known, ways, goal, config)
    known_enough = places.seen & places.decided & (likely.here.max(axis=0) >= config.least_probability)
    found = {
        Against.UNSEEN: ~places.seen,
        Against.UNDECIDED: ~places.decided,
        Against.UNKNOWN_ON_THE_WAY: ~along_slide(known_enough, goal),
        Against.STRAND_BESIDE: beside < config.half_opening_m(config.open_deg),
        Against.STRAND_ON_THE_WAY: ~along_slide(beside >= config.half_opening_m(config.slide_deg), goal),
        Against.NEEDLE_BESIDE: places.needle_m < config.half_opening_m(config.open_deg),
        Against.ALONG_APPROACH: ~clear.any(axis=0),
        Against.TURNS_TOO_SHARPLY: ~steady.any(axis=0),
        Against.UNREACHABLE: ~passable.any(axis=(0, 1)),
    }
    weighed = np.asarray(~np.stack(list(found.values())).any(axis=0))
    past = _past_tissue(ways, goal, passable.any(axis=1) & weighed, config, tissue)
    usable = passable & accepted(past, config)[:, None]
    unknown = config.tissue_required & ~(passable & past.known[:, None]).any(axis=(0, 1))
    found |= {
        Against.TISSUE_UNKNOWN: weighed & unknown,
        Against.IN_TISSUE: weighed & ~usable.any(axis=(0, 1)),
    }
    possible = np.asarray(usable.any(axis=1))
    return Captures(
        s=s,
        goal=goal,
        likelihood=_best_way(likely.likelihood, possible),
        probability=_best_way(likely.probability, possible),
        by_way=None if places.known.model == PAPER else likely.probability,
        against=first_against(found),
        ways=ways,
        usable=usable,
        bound_m=past.bound_m,
    )


def way_of(captures: Captures, capture: int, arm: ArmView) -> tuple[int, int]:
    """Which approach to take, and on which side of the jaws.

    The likeliest to succeed. Among equals the viewing ray comes before the base's, and both before those that are
    tilted, of which the one farthest from the tissue is taken; of the sides that to which the tool has to turn least.
    """
    usable = captures.usable[:, :, capture]
    open_rays = np.asarray(usable.any(axis=1))
    if captures.by_way is not None:
        likely = np.where(open_rays, captures.by_way[:, capture], -1.0)
        open_rays &= likely >= likely.max() - AS_LIKELY
    if open_rays[:UNTILTED].any():
        ray = int(np.argmax(open_rays))
    else:
        ray = int(np.argmax(np.where(open_rays, captures.bound_m[:, capture], -np.inf)))
    R_camera_tool = captures.ways.standoff[ray, :, capture, :3, :3]
    turn = np.where(usable[ray], turn_between(R_camera_tool, arm.T_camera_tool[:3, :3]), np.inf)
    return ray, int(np.argmin(turn))


def _best_way(by_way: Float64[np.ndarray, "w n"], possible: Bool[np.ndarray, "w n"]) -> Float64[np.ndarray, "n"]:
    """Of the ways that are possible the likeliest, and of all where none is."""
    best = np.where(possible, by_way, -1.0).max(axis=0)
    return np.where(best < 0, by_way.max(axis=0), best)


def least_pressed(captures: Captures) -> tuple[int, int] | None:
    """The approach and the capture that would press least into the tissue, of those refused for that; None for none."""
    refused = np.equal(captures.against, list(Against).index(Against.IN_TISSUE))
    if not refused.any():
        return None
    bound = np.where(refused, captures.bound_m, -np.inf)
    way, capture = divmod(int(np.argmax(bound)), bound.shape[1])
    return way, capture


def _past_tissue(
    ways: Ways, goal: int, open_ways: Bool[np.ndarray, "w n"], config: PlannerConfig, tissue: SeenTissue
) -> Standing:
    if tissue.tissue is None:
        return Standing(np.zeros(open_ways.shape), np.zeros(open_ways.shape, bool))
    return standings(tissue.tissue, ways, goal, open_ways, config)


BETTER = 0.002
"""By how much a grip must be likelier to be taken instead of one that was looked at before."""
BEGIN_DEG = 5.0
"""The fingers close by so much at least when they capture."""


@dataclass(frozen=True)
class Choice:
    """What a plan is made of.

    Fields:
        captures: all of them for the chosen grip, or for the first where nothing can be chosen.
        chosen: the capture; None where there is none.
        config: that of the planner with the chosen depth and openings.
    """

    captures: Captures
    chosen: int | None
    config: PlannerConfig

    @property
    def probability(self) -> float:
        """Of success; -1 where nothing is chosen."""
        return -1.0 if self.chosen is None else float(self.captures.probability[self.chosen])


def best_choice(places: Places, policy: Policy, arm: ArmView, config: PlannerConfig, tissue: SeenTissue) -> Choice:
    """The likeliest that nothing speaks against."""
    best: Choice | None = None
    for bound, grip in _grips(places, policy, arm, config):
        if best is not None and best.probability >= bound - BETTER:
            continue
        captures = captures_for(places, arm, grip, tissue)
        found = Choice(captures, _chosen(captures, grip), grip)
        if best is None or found.probability > best.probability + BETTER:
            best = found
    assert best is not None  # noqa: S101 - there is at least one grip
    return best


def _chosen(captures: Captures, config: PlannerConfig) -> int | None:
    allowed = captures.against < 0
    enough = allowed & (captures.probability >= config.least_probability)
    # what an instrument need not slide it should not
    as_likely = 0.0 if captures.by_way is None else BETTER
    chosen = most_likely(captures.likelihood, enough, captures.goal, as_likely)
    return most_likely(captures.probability, allowed, captures.goal) if chosen is None else chosen


def _grips(
    places: Places, policy: Policy, arm: ArmView, config: PlannerConfig
) -> Iterator[tuple[float, PlannerConfig]]:
    """Configs with a depth and openings each, and what is likeliest at best with them, in falling order."""
    known = places.known
    if known.model == PAPER:
        yield 1.0, config
        return
    slides_deg = config.slides_deg[:1] if policy is Policy.DIRECT else config.slides_deg
    grips = [
        replace(config, depth_m=depth_m, open_deg=open_deg, slide_deg=slide_deg)
        for depth_m, open_deg, slide_deg in itertools.product(config.depths_m, config.opens_deg, slides_deg)
        if slide_deg <= open_deg - BEGIN_DEG
    ]
    # how the jaws are turned is the same at every depth
    ways = ways_along(places.aims_camera, places.tangents, arm.T_camera_base[:3, 3], config)
    likely = aimed_with(known, ways, config).whole(places.goal, grips)
    found = [(float(one.max()), grip) for one, grip in zip(likely, grips, strict=True)]
    found.sort(key=lambda one: -one[0])
    likeliest: dict[float, tuple[float, PlannerConfig]] = {}
    for one in found:
        likeliest.setdefault(one[1].depth_m, one)
    yield from likeliest.values()
    narrowest = min(grip.open_deg for _, grip in found)
    spare: dict[float, tuple[float, PlannerConfig]] = {}
    for one in found:
        if one[1].open_deg == narrowest and one not in likeliest.values():
            spare.setdefault(one[1].depth_m, one)
    yield from spare.values()
