"""The segments of a pull: grasp and pull, pull on, let go to grasp anew, let go for good.

A segment ends where the distance c of the jaws from the entry is

    c = a⁻ + min(r, d),      a⁻ = a − 2 σ_a,

a being the strand between entry and jaws as it was grasped, r how much may run (stopping.py), and d the most that may
run in one segment: the strand is surely as long as a⁻, so no more than r comes through the tissue, and the tail is not
made shorter than asked for. Once thread runs, c grows by min(r, d) from one segment to the next. A loose strand is
taken up by no more than 2 d at once. What the next segment goes on from lies in the plan (`Pull`).
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from agents.planner.captures import AS_LIKELY, ArmView
from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError
from agents.planner.plan import plan_grasp
from agents.planner.pulling.stopping import (
    MM,
    NEAREST_M,
    Verdict,
    at_least,
    decide,
    in_words,
    left_m,
    seen_again,
    segment_m,
    shortest_after,
    straight,
)
from agents.planner.pulling.strands import SAMPLES, Meant, Strands, strands_of
from agents.planner.pulling.tail import tail_length
from agents.planner.pulling.way import Around, Situation, clear_until, clear_way_end, jaw_of, lift_of, moved
from agents.planner.wedge import thread_covariance
from schemas.messages import (
    CommandHeader,
    FrameStamp,
    GraspGoal,
    GraspPlan,
    Phase,
    Policy,
    Pull,
    PullBounds,
    PullGoal,
    PullGrip,
    PullStop,
    Status,
    TailLength,
    ThreadReconstruction,
    Waypoint,
)
from schemas.messages.pulling import SIGMAS_95
from shared.kinematics.psm import FINGER_M

FROM_ENTRY_M = tuple(FINGER_M * np.arange(1.0, 3.25, 0.5))
"""Where the standing strand may be grasped: fingers that reach down beside the entry do not press on its tissue."""
GRASP_S, SEGMENT_S = 30.0, 5.0
"""How long a grasp takes at most, and a segment with the rest for a fresh image: bounds that an arming should state."""


def begin(
    goal: PullGoal, thread: ThreadReconstruction, arm: ArmView, config: PlannerConfig, around: Around
) -> GraspPlan:
    """The first segment of a pull, or a rejection with its reason; for a goal without a tail, the jaws let go."""
    name = f"pull-{goal.header.id}"
    if goal.tail_m is None:
        nothing = Pull(None, 1, None, None, None, None, None, None, True, PullStop.LET_GO, "the jaws let go, as asked")
        return _plan(name, goal.arm, goal.header.id, thread.stamp, _letting_go(arm, config), nothing)
    try:
        if goal.tail_m < config.least_tail_m:
            least = f"a tail of {MM * config.least_tail_m:.0f} mm at least is left, so that it can be taken again"
            raise NoGraspError(least)
        strands = strands_of(thread, config, Meant(exit_pixel=goal.exit_pixel), around.needle)
        here = Situation(strands, arm, config, around)
        verdict = decide(goal.tail_m, strands, None, np.zeros(3), False, config)
        if verdict.stop is not None:
            raise NoGraspError(verdict.sentence)
        pull = _pull(goal.tail_m, 1, strands, None, verdict.sentence)
        return _grasped(name, goal.header, goal.arm, pull, here)
    except NoGraspError as error:
        return _rejected(name, goal.arm, goal.header.id, thread, str(error))


def go_on(
    plan: GraspPlan, thread: ThreadReconstruction, arm: ArmView, config: PlannerConfig, around: Around
) -> GraspPlan | None:
    """The segment after one that has ended, from what is seen now; None where the thread does not tell that yet."""
    was = plan.pull
    assert was is not None and was.tail_m is not None  # noqa: S101 - asked of pulls that go on alone
    try:
        strands = strands_of(thread, config, meant_by(was, was.grip is not None), around.needle)
        depth_m = plan.depth_m or 0.0
        jaw = jaw_of(arm.T_camera_tool, depth_m)
        is_straight = was.grip is not None and straight(strands, jaw, config)
        strands = replace(strands, tail=at_least(strands.tail, was.grip, jaw, was.shortest_m, config))
        verdict = decide(was.tail_m, strands, was.grip, jaw, is_straight, config, begun=True)
    except NoGraspError:
        return None
    here = Situation(strands, arm, config, around)
    if verdict.stop is PullStop.END_UNSEEN or (was.grip is None and verdict.stop is None and strands.standing is None):
        return None
    named = f"pull-{plan.goal_id}.{was.segment + 1}"
    grip = None if was.grip is None else seen_again(was.grip, strands, jaw)
    pull = _pull(was.tail_m, was.segment + 1, strands, grip, verdict.sentence, was)
    if verdict.stop is not None:
        return _over(plan, named, thread, arm, config, pull, verdict)
    if grip is None:
        try:
            header = CommandHeader(plan.goal_id, 0, "planner")
            again = _grasped(named, header, plan.arm, pull, here)
        except NoGraspError as error:
            return _over(plan, named, thread, arm, config, pull, Verdict(PullStop.NO_WAY, str(error)))
        return replace(again, continues=plan.plan_id)
    ahead = clear_until(arm.T_camera_tool, grip.way_end_camera, depth_m, here)
    run_m = min(left_m(strands.tail, was.tail_m, config), max(segment_m(strands, grip, jaw, config), NEAREST_M))
    away_m = max(float(np.linalg.norm(jaw - grip.entry_camera)), _surely_m(grip)) + run_m
    target = _target(jaw, ahead, grip.entry_camera, away_m, config)
    if np.linalg.norm(target - jaw) < NEAREST_M:
        used = f"the way is used up, so that the jaws let go and grasp anew: {in_words(strands.tail)}"
        return _over(plan, named, thread, arm, config, pull, Verdict(None, used))
    onward = Waypoint(moved(arm.T_camera_tool, target - jaw), float(np.radians(config.closed_deg)), Phase.PULL, None)
    pulled = replace(pull, sentence=f"pull on by {MM * np.linalg.norm(target - jaw):.1f} mm; {verdict.sentence}")
    made = _plan(named, plan.arm, plan.goal_id, thread.stamp, (onward,), pulled)
    return replace(made, continues=plan.plan_id, depth_m=plan.depth_m, probability=plan.probability)


def let_go_unseen(
    plan: GraspPlan, thread: ThreadReconstruction, arm: ArmView, config: PlannerConfig
) -> GraspPlan | None:
    """Jaws that hold thread whose tail is not measured let go: the view is clear then, and no thread under tension.

    None where they hold nothing.
    """
    was = plan.pull
    if was is None or was.grip is None:
        return None
    why = "the tail is not measured while the jaws hold the strand, so that they let go, look, and grasp anew"
    pull = replace(was, segment=was.segment + 1, bounds=None)
    return _over(plan, f"pull-{plan.goal_id}.{was.segment + 1}", thread, arm, config, pull, Verdict(None, why))


def meant_by(pull: Pull, held: bool) -> Meant:
    """Which exit and entry are those of a pull that is under way; while its strand is held the tail may get shorter."""
    if pull.exit is None or pull.entry is None:
        return Meant()
    shortest_m = None if held else pull.shortest_m
    return Meant(None, pull.exit.point_camera, pull.entry.point_camera, shortest_m, pull.longest_m)


def _pull(
    tail_m: float,
    segment: int,
    strands: Strands,
    grip: PullGrip | None,
    sentence: str,
    was: Pull | None = None,
) -> Pull:
    seen = strands.tail, strands.free_end, strands.exit, strands.entry
    low_m, high_m = strands.tail.interval_m
    # until jaws take hold nothing makes the tail shorter, and nothing ever makes it longer
    shortest_m = max(low_m, (was and was.shortest_m) or 0.0) if grip is None else None
    highs_m = [one for one in (high_m, was and was.longest_m) if one is not None]
    bounds = shortest_m, min(highs_m, default=None)
    return Pull(tail_m, segment, *seen, grip, None, False, None, sentence, *bounds)


def _grasped(name: str, header: CommandHeader, arm_name: str, pull: Pull, here: Situation) -> GraspPlan:
    """The direct grasp of the standing strand with the first pull from there that most likely leads to the end.

    Where its clear way is short the strand is grasped more often, and each grasp has to succeed.

    Raises:
        NoGraspError: where there is none.
    """
    line, config, around = here.strands.line, here.config, here.around
    if here.strands.standing is None:
        raise NoGraspError("the strand to pull is not seen: clear the view, and ask again")
    entry, far = here.strands.standing
    long_m = abs(far - entry) * line.curve.length_m
    best: GraspPlan | None = None
    best_chance, best_grasps = 0.0, 1
    why = f"the standing strand is {MM * long_m:.0f} mm long, too short to be grasped clear of its entry"
    # beyond where it leaves the view there is more of it
    reach_m = long_m - (config.grasp_arc_m if here.strands.ends else 0.0)
    for from_entry_m in (one for one in FROM_ENTRY_M if one < reach_m):
        s = float(entry + (1.0 if far > entry else -1.0) * from_entry_m / line.curve.length_m)
        goal = GraspGoal(header, arm_name, Policy.DIRECT, s, None, None, attempts=1)
        beside = here.strands.tail_points
        grasp = plan_grasp(goal, line.thread, here.arm, config, around.tissue, needle=around.needle, beside=beside)
        obstructed = grasp.thread.obstructed if grasp.thread is not None else ""
        if grasp.status is not Status.OK or obstructed:
            why = grasp.reason or obstructed
            continue
        if best is not None and grasp.probability <= best_chance + AS_LIKELY:
            continue
        made = _pulling(grasp, s, pull, here)
        if made is None:
            why = "no way leads on from the standing strand clear of tissue, thread, needle and instruments"
            continue
        grasps = _grasps(made, pull.tail_m or 0.0, here)
        chance = grasp.probability**grasps
        if best is None or chance > best_chance + AS_LIKELY:
            best, best_chance, best_grasps = replace(made, plan_id=name), chance, grasps
    if best is None or best.pull is None:
        raise NoGraspError(f"the standing strand cannot be pulled: {why}")
    bounds = _bounds(_runs_m(here.strands.tail, pull.tail_m or 0.0), best_grasps, here)
    return best if pull.segment > 1 else replace(best, pull=replace(best.pull, bounds=bounds))


def _pulling(grasp: GraspPlan, s: float, pull: Pull, here: Situation) -> GraspPlan | None:
    """A grasp with the first pull from there; None where no way gains anything."""
    strands, config, entry = here.strands, here.config, here.entry_camera
    to_grasp = tuple(waypoint for waypoint in grasp.waypoints if waypoint.phase is not Phase.RETREAT)
    T_grasp, depth_m = to_grasp[-1].T_camera_tool, grasp.depth_m or 0.0
    way_end = clear_way_end(T_grasp, depth_m, here)
    line, (into, _) = strands.line, strands.standing or (0.0, 1.0)
    between = np.linspace(into, s, SAMPLES)
    covariance = thread_covariance(line.thread, line.curve, between)
    assert covariance is not None  # noqa: S101 - strands are of a thread that tells it
    strand = tail_length(line.curve.points(between), covariance, config.correlation_m)
    jaw = jaw_of(T_grasp, depth_m)
    run_m = min(left_m(strands.tail, pull.tail_m or 0.0, config), segment_m(strands, None, jaw, config))
    if way_end is None or np.linalg.norm(way_end - entry) < strand.length_m + run_m:
        return None
    grip = PullGrip(jaw, entry, strand.length_m, strand.deviation_m, strands.tail, way_end)
    T_lifted = moved(T_grasp, lift_of(T_grasp, depth_m, config))
    lifted = jaw_of(T_lifted, depth_m)
    target = _target(lifted, way_end, entry, _surely_m(grip) + run_m, config)
    closed = float(np.radians(config.closed_deg))
    poses = [T_lifted, *([moved(T_lifted, target - lifted)] if np.linalg.norm(target - lifted) >= NEAREST_M else [])]
    pulls = tuple(Waypoint(T, closed, Phase.PULL, None) for T in poses)
    until = f"pull until the tail is {MM * (pull.tail_m or 0.0):.1f} mm"
    told = f"grasp {MM * strand.length_m:.0f} mm from the entry, {until}"
    pulled = replace(
        pull,
        grip=grip,
        sentence=f"{told}; grasp succeeds with {grasp.probability:.0%}; {pull.sentence}",
    )
    if not line.is_meant:
        # shares of a curve that is not the message's own would be taken for places on that one
        grasp = replace(grasp, s_goal=None, s_capture=None)
    return replace(grasp, waypoints=(*to_grasp, *pulls), pull=pulled)


def _runs_m(tail: TailLength, tail_m: float) -> float:
    """How much thread is to run, by the upper bound of the tail."""
    return tail.length_m + SIGMAS_95 * tail.deviation_m - tail_m


def _grasps(plan: GraspPlan, tail_m: float, here: Situation) -> int:
    """How often the strand is grasped in all, with ways as long as that of this grasp."""
    grip = plan.pull.grip if plan.pull is not None else None
    assert grip is not None  # noqa: S101 - asked of plans that grasp
    usable_m = float(np.linalg.norm(grip.way_end_camera - grip.entry_camera)) - grip.strand_m
    return int(np.ceil(_runs_m(grip.tail, tail_m) / max(usable_m, here.config.pull_segment_m)))


def _bounds(runs_m: float, grasps: int, here: Situation) -> PullBounds:
    """What a pull needs, its deviations included: a loose strand and a lift with each grasp, and all that is to run."""
    # a way that is oblique to the strand is longer than what runs, by √2 at its steepest
    config = here.config
    slack_m = config.pull_reach_m
    length_m = np.sqrt(2.0) * runs_m + grasps * slack_m
    time_s = 2 * grasps * GRASP_S + SEGMENT_S * np.ceil(runs_m / min(config.pull_segment_m, here.strands.gives_m))
    return PullBounds(float(np.ceil(length_m * MM) / MM), float(time_s), config.pull_reach_m + config.grasp_arc_m)


def _target(
    jaw: Float64[np.ndarray, "3"],
    end: Float64[np.ndarray, "3"],
    entry_camera: Float64[np.ndarray, "3"],
    away_m: float,
    config: PlannerConfig,
) -> Float64[np.ndarray, "3"]:
    """Where on the straight way from here to its end the jaws are so far from the entry, or have gone 2 d."""
    way_m = float(np.linalg.norm(end - jaw))
    share = np.linspace(0.0, 1.0, 1 + int(way_m / (0.1 * NEAREST_M)))
    places = jaw + share[:, None] * (end - jaw)
    there = np.linalg.norm(places - entry_camera, axis=1) >= away_m
    enough = there | (share * way_m >= 2.0 * config.pull_segment_m)
    return places[int(np.argmax(enough))] if enough.any() else places[-1]


def _surely_m(grip: PullGrip) -> float:
    """a⁻."""
    return max(grip.strand_m - SIGMAS_95 * grip.deviation_m, 0.0)


def _over(
    plan: GraspPlan,
    named: str,
    thread: ThreadReconstruction,
    arm: ArmView,
    config: PlannerConfig,
    pull: Pull,
    verdict: Verdict,
) -> GraspPlan:
    """Let go of what is held: for good where the verdict says to stop, else to grasp anew."""
    was = plan.pull
    held = was is not None and was.grip is not None
    freed = replace(
        pull,
        grip=None,
        last=verdict.stop is not None,
        stop=verdict.stop,
        sentence=verdict.sentence,
        shortest_m=shortest_after(pull, jaw_of(arm.T_camera_tool, plan.depth_m or 0.0), config),
    )
    opened = float(np.radians(config.open_deg))
    stays = (Waypoint(arm.T_camera_tool, opened, Phase.RELEASE, None),)
    way = _letting_go(arm, config) if held else stays
    made = _plan(named, plan.arm, plan.goal_id, thread.stamp, way, freed)
    return replace(made, continues=plan.plan_id, depth_m=plan.depth_m)


def _letting_go(arm: ArmView, config: PlannerConfig) -> tuple[Waypoint, ...]:
    """Open the jaws where they are, and go back along them as far as an approach begins, where the arm reaches that."""
    opened = float(np.radians(config.open_deg))
    here = arm.T_camera_tool
    back = moved(here, -config.standoff_m * here[:3, 2])
    way = (here, back) if bool(np.all(arm.reachable(back[None]))) else (here,)
    return tuple(Waypoint(T, opened, Phase.RELEASE, None) for T in way)


def _plan(
    name: str, arm: str, goal_id: str, stamp: FrameStamp, waypoints: tuple[Waypoint, ...], pull: Pull
) -> GraspPlan:
    return GraspPlan(
        plan_id=name,
        arm=arm,
        goal_id=goal_id,
        stamp=stamp,
        status=Status.OK,
        reason="",
        policy=Policy.DIRECT,
        s_goal=None,
        s_capture=None,
        probability=1.0,
        slide_m=0.0,
        waypoints=waypoints,
        alternatives=(),
        pull=pull,
    )


def _rejected(name: str, arm: str, goal_id: str, thread: ThreadReconstruction, reason: str) -> GraspPlan:
    return GraspPlan(
        name, arm, goal_id, thread.stamp, Status.FAILED, reason, Policy.DIRECT, None, None, 0.0, 0.0, (), ()
    )
