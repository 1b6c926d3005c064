"""Plans, arms and the simulated field as Rerun shows them, in millimetres in the left camera's frame.

world/plan/{arm}            `path` of the tool and its `fingers`, by phase of the grasp
world/plan/{arm}/considered the captures on the thread of the frame that the plan was made from, each in the colour of
                            what spoke against it, with its probability of success beside it
world/tool/{arm}            `fingers`, `shaft` and `axes` of the tool
world/solid/{arm}           its body, for space alone: in the images it would hide the thread
world/truth                 the simulated thread as it truly is
plan/report                 the plan, or why there is none, with what else was considered
plan/considered/{reason}    a chart along s, with one entity for each reason, so that its legend is theirs
plan/check                  what the planner saw after the grasp
lanes/{arm}                 mode, phase and what was seen after it, as they change; `tail`: whether thread runs
robot/joints, jaw_deg       of each arm
world/tail/{arm}            free end, exit and entry of a tail, each a ball of two deviations, with how it is seen
tail/length_mm/{arm}        its length over time, both ends of its interval, and the length that was asked for
tail/ran_mm/{arm}           how much shorter it became, and by how much it should have by what the jaws took
"""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
import rerun as rr
from jaxtyping import Float64

from agents.viewer import colours
from agents.viewer.entity import MM_PER_METRE, Entity
from agents.viewer.polyline import Polyline, thread_polyline
from agents.viewer.session_mapping import lane, said
from schemas.messages import (
    Checked,
    ExecutionEvent,
    ExecutionKind,
    FrameStamp,
    GraspCheck,
    GraspJudgement,
    GraspPlan,
    RobotState,
    SimulatorState,
    Status,
    Tail,
    ThreadReconstruction,
    Verdict,
)
from shared.kinematics.psm import FINGER_M, JOINT_NAMES, LARGE_NEEDLE_DRIVER, WRIST_YAW, finger_tips
from shared.rigid_transforms import apply
from shared.splines import evaluate

TRUTH_POINTS = 120
AXIS_M = 0.005
SHORT = 12
SHAFT_M = 0.06
"""How much of the shaft is drawn."""

_LEVEL = {ExecutionKind.REFUSED: rr.TextLogLevel.WARN, ExecutionKind.HELD: rr.TextLogLevel.WARN}
_VERDICT_LEVEL = dict.fromkeys(set(Verdict) - {Verdict.HELD}, rr.TextLogLevel.WARN)


def plan_entities(plan: GraspPlan) -> list[Entity]:
    """The way of the tool, coloured by phase, and the plan in words; a rejection empties the way."""
    arm = rr.escape_entity_path_part(plan.arm)
    poses = np.array([waypoint.T_camera_tool for waypoint in plan.waypoints]).reshape(-1, 4, 4)
    rgb = [colours.PHASES[waypoint.phase] for waypoint in plan.waypoints]
    pins, fingers = MM_PER_METRE * poses[:, :3, 3], MM_PER_METRE * FINGER_M * poses[:, :3, 2]
    steps = np.stack((pins[:-1], pins[1:]), axis=1)
    level = rr.TextLogLevel.INFO if plan.status is Status.OK else rr.TextLogLevel.WARN
    return [
        (f"world/plan/{arm}/path", [rr.LineStrips3D(list(steps), colors=rgb[1:], radii=[-1.5])]),
        (f"world/plan/{arm}/fingers", [rr.Arrows3D(origins=pins, vectors=fingers, colors=rgb, radii=[-1.0])]),
        ("plan/report", [rr.TextDocument(plan_markdown(plan), media_type=rr.MediaType.MARKDOWN)]),
        ("plan/probability", [rr.Scalars(plan.probability)]),
        said("planner", plan_sentence(plan), level),
    ]


def plan_sentence(plan: GraspPlan) -> str:
    """A plan in one line."""
    if plan.status is not Status.OK:
        return f"no plan for {plan.arm}: {plan.reason}"
    how = plan.policy.name.lower().replace("_", "-")
    return (
        f"plan {short(plan.plan_id)} for {plan.arm}: {how}, capture at {_percent(plan.s_capture)}, "
        f"slide {plan.slide_m * MM_PER_METRE:.0f} mm, grasp at {_percent(plan.s_goal)}; success {plan.probability:.0%}"
    )


def short(name: str) -> str:
    """A long unique id as far as people read it."""
    return name if len(name) <= SHORT else f"{name[:SHORT]}…"


def plan_markdown(plan: GraspPlan) -> str:
    """A plan with what else was considered."""
    lines = ["## " + ("Plan" if plan.status is Status.OK else "No plan"), plan_sentence(plan)]
    if plan.tissue is not None:
        lines.append(f"Tissue: {plan.tissue.sentence}.")
    if plan.thread is not None and plan.thread.obstructed:
        lines.append(f"Thread: {plan.thread.obstructed}.")
    if plan.attempt > 1:
        lines.append(f"Attempt {plan.attempt} of {plan.attempts}.")
    if plan.alternatives:
        rows = [f"| {a.s_capture:.0%} | {a.probability:.0%} | {a.reason or '–'} |" for a in plan.alternatives]
        lines.append("\n".join(["| capture at | success | what speaks against it |", "|---|---|---|", *rows]))
    return "\n\n".join(lines)


def robot_numbers(state: RobotState) -> list[Entity]:
    """Joints and jaw."""
    arm = rr.escape_entity_path_part(state.arm)
    return [
        (f"robot/joints/{arm}", [rr.Scalars(state.joints)]),
        (f"robot/jaw_deg/{arm}", [rr.Scalars(math.degrees(state.jaw_rad))]),
    ]


def robot_tool_entities(state: RobotState) -> list[Entity]:
    """The tool where the bridge takes it to be."""
    arm = rr.escape_entity_path_part(state.arm)
    T_camera_tool = state.T_camera_base @ state.T_base_tool
    tool = f"world/tool/{arm}"
    fingers = apply(T_camera_tool, finger_lines(state.jaw_rad).reshape(-1, 3)).reshape(2, 2, 3)
    shaft = apply(state.T_camera_base, shaft_line(state.T_base_tool, of_psm=state.kinematics == ""))
    pin, directions = T_camera_tool[:3, 3], T_camera_tool[:3, :3].T
    axes = rr.Arrows3D(
        origins=[MM_PER_METRE * pin] * 3, vectors=MM_PER_METRE * AXIS_M * directions, colors=colours.AXES, radii=[-1.0]
    )
    return [
        (f"{tool}/fingers", [rr.LineStrips3D(list(MM_PER_METRE * fingers), colors=[colours.TOOL], radii=[-3.0])]),
        (f"{tool}/shaft", [rr.LineStrips3D([MM_PER_METRE * shaft], colors=[(*colours.TOOL, 110)], radii=[-2.0])]),
        (f"{tool}/axes", [axes]),
        (f"world/solid/{arm}", [tool_solid(fingers, shaft)]),
    ]


def joint_names(arm: str, of_psm: bool = True) -> Entity:
    """What the curves of an arm's joints are called."""
    names = JOINT_NAMES if of_psm else [f"joint {i}" for i in range(1, 7)]
    return f"robot/joints/{rr.escape_entity_path_part(arm)}", [rr.SeriesLines(names=names)]


def mode_entities(state: RobotState) -> list[Entity]:
    """What an arm is doing."""
    return [lane(f"{rr.escape_entity_path_part(state.arm)}/mode", state.mode.name.lower())]


def finger_lines(jaw_rad: float) -> Float64[np.ndarray, "2 2 3"]:
    """Both fingers in the tool frame, from the pin to the tip, each opened by half the jaw angle about x_tool."""
    return np.stack((np.zeros((2, 3)), finger_tips(jaw_rad)), axis=1)


def shaft_line(T_base_tool: Float64[np.ndarray, "4 4"], of_psm: bool = True) -> Float64[np.ndarray, "3 3"]:
    """From the pin over the wrist up the shaft, in the base frame, whose origin every PSM's shaft passes through.

    The wrist's link is at right angles to the pin and in one plane with the shaft (shared/kinematics/psm.py). Of an arm
    that is no PSM nothing is known but the tool: a line straight behind it.
    """
    pin, axis = T_base_tool[:3, 3], T_base_tool[:3, 0]
    if not of_psm:
        return pin - np.array((0.0, 0.5, 1.0))[:, None] * SHAFT_M * T_base_tool[:3, 2]
    wrist = pin - LARGE_NEEDLE_DRIVER.links[WRIST_YAW].a * _unit(pin - (pin @ axis) * axis)
    return np.stack((pin, wrist, wrist - SHAFT_M * _unit(wrist)))


def execution_entities(event: ExecutionEvent) -> list[Entity]:
    """An event in words, and what it means for the phase that an arm is in."""
    arm = rr.escape_entity_path_part(event.arm)
    phase = event.phase.name.lower() if event.phase else ""
    what = event.kind.name.lower().replace("_", " ") + (f" {phase}" if phase else "")
    why = f" ({event.code}): {event.reason}" if event.code else ""
    text = said(f"robot_bridge/{event.arm}", what + why, _LEVEL.get(event.kind, rr.TextLogLevel.INFO))
    if event.kind is ExecutionKind.REFUSED:
        return [text]
    reached = event.kind is ExecutionKind.PHASE_REACHED and phase
    return [lane(f"{arm}/phase", reached or event.kind.name.lower()), text]


def judgement_entities(judgement: GraspJudgement) -> list[Entity]:
    """What became of a grasp, in words."""
    # an arm that is held has stopped, so a thread that is held is said to be caught
    verdict = "caught" if judgement.verdict is Verdict.HELD else judgement.verdict.name.lower()
    level = _VERDICT_LEVEL.get(judgement.verdict, rr.TextLogLevel.INFO)
    return [
        lane(f"{rr.escape_entity_path_part(judgement.arm)}/verdict", verdict),
        said("simulator", judgement.sentence or verdict, level),
    ]


def check_entities(check: GraspCheck) -> list[Entity]:
    """What the planner itself saw after a grasp."""
    verdict = check.verdict.name.lower()
    level = rr.TextLogLevel.INFO if check.verdict is Checked.HELD else rr.TextLogLevel.WARN
    attempt = f"attempt {check.attempt} of {check.attempts}" if check.attempts > 1 else "the only attempt"
    lines = [f"## Seen after the grasp: {verdict}", f"{check.sentence} ({attempt})."]
    if check.next_plan_id:
        lines.append(f"Next: plan {short(check.next_plan_id)}, which has to be armed like any other.")
    return [
        lane(f"{rr.escape_entity_path_part(check.arm)}/checked", verdict),
        ("plan/check", [rr.TextDocument("\n\n".join(lines), media_type=rr.MediaType.MARKDOWN)]),
        said("planner", f"{short(check.plan_id)} {check.sentence}", level),
    ]


def truth_entities(state: SimulatorState) -> list[Entity]:
    """The true thread, thin and grey."""
    s = np.linspace(state.knots[0], state.knots[-1], TRUTH_POINTS)
    points = MM_PER_METRE * evaluate(state.knots, state.control_points_camera, 3, s)
    return [("world/truth", [rr.LineStrips3D([points], colors=[colours.TRUTH], radii=[-0.7])])]


def _unit(vector: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _percent(s: float | None) -> str:
    return "?" if s is None else f"{s:.0%}"


FINGER_RADIUS_M, WRIST_RADIUS_M, SHAFT_RADIUS_M = 0.0007, 0.0020, 0.0042
"""Of a Large Needle Driver, whose shaft is 8.4 mm thick."""


def tool_solid(fingers: Float64[np.ndarray, "2 2 3"], shaft: Float64[np.ndarray, "3 3"]) -> rr.Capsules3D:
    """Both fingers from the pin to their tips, and the way from the pin over the wrist up the shaft, in metres."""
    begins = MM_PER_METRE * np.vstack((fingers[:, 0], shaft[:2]))
    ends = MM_PER_METRE * np.vstack((fingers[:, 1], shaft[1:]))
    radii = MM_PER_METRE * np.array([FINGER_RADIUS_M, FINGER_RADIUS_M, WRIST_RADIUS_M, SHAFT_RADIUS_M])
    return rr.Capsules3D(
        lengths=np.linalg.norm(ends - begins, axis=1),
        radii=radii,
        translations=begins,
        quaternions=turns_of_z(ends - begins),
        colors=[colours.TOOL, colours.TOOL, colours.SHAFT, colours.SHAFT],
        fill_mode="solid",
    )


def turns_of_z(direction: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 4"]:
    """Quaternions (x, y, z, w) that turn the z axis into each direction on the shortest way.

    With d the unit direction, that is (z × d, 1 + z · d), normalised; straight down, half a turn about x.
    """
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    unit = np.where(length > 0, direction / np.maximum(length, np.finfo(float).tiny), (0.0, 0.0, 1.0))
    turn = np.column_stack((-unit[:, 1], unit[:, 0], np.zeros(len(unit)), 1.0 + unit[:, 2]))
    size = np.linalg.norm(turn, axis=1, keepdims=True)
    return np.where(size > 1e-9, turn / np.maximum(size, 1e-9), (1.0, 0.0, 0.0, 0.0))


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
class WeighedCaptures:
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


LENGTHS, RUNS = ("length", "at least", "at most", "asked for"), ("tail", "jaws")
END_SIGMAS = 2.0
LEAST_END_MM = 0.3
"""Of a ball that is still seen."""


def tail_entities(tail: Tail) -> list[Entity]:
    """The tail in one frame; one that was not measured leaves no curve there, and says why."""
    arm = rr.escape_entity_path_part(tail.arm)
    state = "unseen" if tail.status is not Status.OK else tail.stop.name.lower() if tail.stop else "runs"
    entities = [lane(f"{arm}/tail", state)]
    if tail.tail is None:
        return [*entities, said("planner", f"tail not measured: {tail.reason}", rr.TextLogLevel.WARN)]
    low_m, high_m = tail.tail.interval_m
    lengths = MM_PER_METRE * np.array([tail.tail.length_m, low_m, np.nan if high_m is None else high_m, tail.tail_m])
    names = [rr.SeriesLines(names=list(LENGTHS)), rr.Scalars(lengths)]
    entities.append((f"tail/length_mm/{arm}", names))
    if tail.ran_m is not None and tail.travelled_m is not None:
        ran = MM_PER_METRE * np.array([tail.ran_m, tail.travelled_m])
        entities.append((f"tail/ran_mm/{arm}", [rr.SeriesLines(names=list(RUNS)), rr.Scalars(ran)]))
    ends = {"free end": tail.free_end, "exit": tail.exit, "entry": tail.entry}
    seen = {name: end for name, end in ends.items() if end is not None}
    wide = [END_SIGMAS * MM_PER_METRE * np.sqrt(np.linalg.eigvalsh(end.covariance)[-1]) for end in seen.values()]
    balls = rr.Points3D(
        [MM_PER_METRE * end.point_camera for end in seen.values()],
        radii=np.maximum(wide, LEAST_END_MM),
        labels=[f"{name}, {end.sight.name.lower().replace('_', ' ')}" for name, end in seen.items()],
    )
    entities.append((f"world/tail/{arm}", [balls]))
    if tail.stop is not None:
        entities.append(said("planner", f"{tail.stop.name.lower()}: {tail.sentence}", rr.TextLogLevel.WARN))
    return entities
