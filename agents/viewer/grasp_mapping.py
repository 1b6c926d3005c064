"""Plans, arms and the simulated field as Rerun shows them, in millimetres in the left camera's frame.

world/plan/{arm}            `path` of the tool and its `fingers`, by phase of the grasp
world/tool/{arm}            `fingers`, `shaft` and `axes` of the tool
world/solid/{arm}           its body, for space alone: in the images it would hide the thread
world/truth                 the simulated thread as it truly is
plan/report                 the plan, or why there is none, with what else was considered
plan/check                  what the planner saw after the grasp
lanes/{arm}                 mode, phase and what was seen after it, as they change
robot/joints, jaw_deg       of each arm
"""

import math

import numpy as np
import rerun as rr
from jaxtyping import Float64

from agents.viewer import colours
from agents.viewer.clearance import clearance_sentence
from agents.viewer.mapping import Entity
from agents.viewer.session_mapping import lane, said
from agents.viewer.units import MM_PER_METRE
from schemas.messages import (
    Checked,
    ExecutionEvent,
    ExecutionKind,
    GraspCheck,
    GraspJudgement,
    GraspPlan,
    RobotState,
    SimulatorState,
    Status,
    Verdict,
)
from shared.kinematics.psm import FINGER_M, JOINT_NAMES, LARGE_NEEDLE_DRIVER, WRIST_YAW
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
        lines.append(f"Tissue: {clearance_sentence(plan.tissue)}.")
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
    half = 0.5 * jaw_rad * np.array([1.0, -1.0])
    tips = FINGER_M * np.stack((np.zeros(2), np.sin(half), np.cos(half)), axis=1)
    return np.stack((np.zeros((2, 3)), tips), axis=1)


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
