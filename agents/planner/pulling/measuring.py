"""The tail in one frame while a pull is carried out, as the planner tells it and the bridge watches it."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError
from agents.planner.needle import NeedleAround
from agents.planner.pulling.segments import meant_by
from agents.planner.pulling.stopping import at_least, decide, straight
from agents.planner.pulling.strands import strands_of
from agents.planner.pulling.way import jaw_of
from schemas.messages import GraspPlan, Phase, PullStop, Status, Tail, ThreadReconstruction

HOLDS = (Phase.GRASP, Phase.PULL)
"""Phases after which the jaws hold thread."""


def tail_of(
    plan: GraspPlan,
    reached: Phase | None,
    thread: ThreadReconstruction,
    T_camera_tool: Float64[np.ndarray, "4 4"],
    config: PlannerConfig,
    needle: NeedleAround | None,
) -> Tail:
    """The tail of the thread that a plan pulls, and whether the jaws may go on from where they are.

    Args:
        reached: the plan's phase that was reached last.
    """
    pull = plan.pull
    assert pull is not None and pull.tail_m is not None  # noqa: S101 - asked of pulls alone
    told = plan.plan_id, plan.arm, thread.stamp
    held = reached in HOLDS or (reached is None and plan.waypoints[0].phase is Phase.PULL)
    try:
        strands = strands_of(thread, config, meant_by(pull, held), needle)
        grip, jaw = pull.grip if held else None, jaw_of(T_camera_tool, plan.depth_m or 0.0)
        is_straight = grip is not None and straight(strands, jaw, config)
        strands = replace(strands, tail=at_least(strands.tail, grip, jaw, pull.shortest_m, config))
        verdict = decide(pull.tail_m, strands, grip, jaw, is_straight, config, pull.segment > 1)
    except NoGraspError as error:
        # jaws that pull rest until the tail is measured again
        stop = PullStop.END_UNSEEN if held else None
        nothing = None, None, None, None, None, None, reached, stop, str(error)
        return Tail(*told, Status.FAILED, str(error), pull.segment, pull.tail_m, *nothing)
    ends = strands.free_end, strands.exit, strands.entry
    judged = verdict.ran_m, verdict.travelled_m, reached, verdict.stop, verdict.sentence
    return Tail(*told, Status.OK, "", pull.segment, pull.tail_m, strands.tail, *ends, *judged)
