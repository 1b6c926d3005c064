"""Messages as rows of tables: each gives a few columns of equal length, named with their units and frames."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from agents.inspection.export_columns import AXES, Block, Column, number, pose, seconds, whole
from agents.inspection.export_curves import curve_rows, frame_row
from agents.inspection.grasps import COMMAND_TYPES
from schemas.codec import decode
from schemas.messages import (
    Arm,
    CommandRecord,
    ExecutionEvent,
    GraspGoal,
    GraspJudgement,
    GraspPlan,
    Hold,
    Prompt,
    RobotState,
    Status,
    ThreadReconstruction,
)
from shared.rigid_transforms import compose


def blocks(message: Any, published_ns: int, zero_ns: int, points: int) -> Iterator[tuple[str, Block]]:
    """The rows that a message adds, by table; `points` to a curve.

    Raises:
        MessageError: where the command within a command's record cannot be read.
    """
    match message:
        case ThreadReconstruction():
            yield "frames", frame_row(message, published_ns, zero_ns)
            if message.status is Status.OK:
                yield "curves", curve_rows(message, zero_ns, points)
        case GraspPlan():
            yield "plans", plan_row(message, published_ns, zero_ns)
            if message.waypoints:
                yield "waypoints", waypoint_rows(message)
        case RobotState():
            yield "robot_states", robot_row(message, zero_ns)
        case CommandRecord() if message.topic in COMMAND_TYPES:
            yield "commands", command_row(message, zero_ns)
        case ExecutionEvent():
            yield "outcomes", event_row(message, zero_ns)
        case GraspJudgement():
            yield "outcomes", judgement_row(message, zero_ns)
        case _:
            return


def plan_row(plan: GraspPlan, published_ns: int, zero_ns: int) -> Block:
    """A plan, or why there is none."""
    return {
        "plan_id": [plan.plan_id],
        "goal_id": [plan.goal_id],
        "arm": [plan.arm],
        "frame": whole(plan.stamp.sequence),
        "published_ns": whole(published_ns),
        "t_s": seconds(published_ns, zero_ns),
        "status": [plan.status.name.lower()],
        "reason": [plan.reason],
        "policy": [plan.policy.name.lower()],
        "s_goal": number(plan.s_goal),
        "s_capture": number(plan.s_capture),
        "probability": number(plan.probability),
        "slide_m": number(plan.slide_m),
    }


def waypoint_rows(plan: GraspPlan) -> Block:
    """The tool poses of a plan."""
    waypoints = plan.waypoints
    rows: dict[str, Column] = {
        "plan_id": [plan.plan_id] * len(waypoints),
        "waypoint": np.arange(len(waypoints)),
        "phase": [waypoint.phase.name.lower() for waypoint in waypoints],
        "s": np.array([np.nan if waypoint.s is None else waypoint.s for waypoint in waypoints]),
    }
    rows |= pose("tool", "camera", np.stack([waypoint.T_camera_tool for waypoint in waypoints]))
    return rows | {"jaw_rad": np.array([waypoint.jaw_rad for waypoint in waypoints], np.float64)}


def robot_row(state: RobotState, zero_ns: int) -> Block:
    """An arm as measured; its third joint is a length, the others are angles."""
    joints: dict[str, Column] = {
        f"joint_{i + 1}_{'m' if i == 2 else 'rad'}": number(float(state.joints[i])) for i in range(len(state.joints))
    }
    row: dict[str, Column] = {
        "arm": [state.arm],
        "measured_ns": whole(state.measured_ns),
        "t_s": seconds(state.measured_ns, zero_ns),
        "mode": [state.mode.name.lower()],
        "plan_id": [state.plan_id],
        **joints,
        "jaw_rad": number(state.jaw_rad),
    }
    row |= pose("tool", "base", state.T_base_tool[None])
    return {**row, **pose("tool", "camera", compose(state.T_camera_base, state.T_base_tool)[None])}


def command_row(record: CommandRecord, zero_ns: int) -> Block:
    """A command with its answer."""
    command = decode(COMMAND_TYPES[record.topic], record.payload)
    goal = command if isinstance(command, GraspGoal) else None
    pixel = command.pixel if isinstance(command, GraspGoal | Prompt) else None
    point = goal.point_camera if goal else None
    row: dict[str, Column] = {
        "received_ns": whole(record.received_ns),
        "t_s": seconds(record.received_ns, zero_ns),
        "command": [record.topic],
        "id": [command.header.id],
        "sender": [command.header.sender],
        "arm": [command.arm if isinstance(command, GraspGoal | Arm | Hold) else ""],
        "plan_id": [command.plan_id if isinstance(command, Arm) else ""],
        "policy": [goal.policy.name.lower() if goal else ""],
        "s": number(goal.s if goal else None),
        "u_left_px": number(None if pixel is None else float(pixel[0])),
        "v_left_px": number(None if pixel is None else float(pixel[1])),
    }
    row |= {f"{a}_camera_m": number(None if point is None else float(point[i])) for i, a in enumerate(AXES)}
    row["from_swage_m"] = number(goal.from_swage_m if goal else None)
    answer = record.answer
    return row | {"outcome": [answer.outcome.name.lower()], "code": [answer.code], "reason": [answer.reason]}


def event_row(event: ExecutionEvent, zero_ns: int) -> Block:
    """A step in the carrying out of a plan."""
    phase = event.phase.name.lower() if event.phase else ""
    return _outcome(event, zero_ns, event.kind.name.lower(), event.arming_id, phase, event.code, event.reason, None)


def judgement_row(judged: GraspJudgement, zero_ns: int) -> Block:
    """What the simulator found."""
    return _outcome(judged, zero_ns, "judged", "", "", judged.verdict.name.lower(), judged.sentence, judged)


def _outcome(
    of: ExecutionEvent | GraspJudgement,
    zero_ns: int,
    kind: str,
    arming_id: str,
    phase: str,
    code: str,
    reason: str,
    judged: GraspJudgement | None,
) -> Block:
    return {
        "at_ns": whole(of.at_ns),
        "t_s": seconds(of.at_ns, zero_ns),
        "plan_id": [of.plan_id],
        "arm": [of.arm],
        "arming_id": [arming_id],
        "kind": [kind],
        "phase": [phase],
        "code": [code],
        "reason": [reason],
        "s_caught": number(judged.s_caught if judged else None),
        "slid_m": number(judged.slid_m if judged else None),
        "error_m": number(judged.error_m if judged else None),
    }
