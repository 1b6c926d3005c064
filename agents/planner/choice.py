"""Which capture, way to hold the tool, depth and opening of the jaws a plan takes.

With the paper's model depth and openings are set. With the geometric one each combination of a depth, an opening for
the approach and one for the slide is a grip of its own. Of each depth the likeliest, as if nothing were in the way, is
looked at, from the likeliest on, until none of the rest can be likelier than what was found; so tissue is looked at for
few of them. Where nothing is found, the narrowest openings are tried, which other strands leave more room.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

from agents.planner.captures import ArmView, Captures, captures_for
from agents.planner.chances import PAPER, aimed_with
from agents.planner.config import PlannerConfig
from agents.planner.places import Places
from agents.planner.policy import most_likely
from agents.planner.standing import SeenTissue
from agents.planner.ways import ways_along
from schemas.messages import Policy

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
