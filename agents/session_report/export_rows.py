"""Messages as rows of tables: each gives a few columns of equal length, named with their units and frames."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

from agents.session_report.grasps import COMMAND_TYPES
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
from shared.along_thread import confidence_at, unseen_at
from shared.arc_length import length, parameters_at
from shared.camera import project
from shared.rigid_transforms import compose, quaternion_from_rotation
from shared.splines import evaluate

Column = np.ndarray | list[str]
Block = Mapping[str, Column]
"""Columns of equal length, in their order."""
AXES = ("x", "y", "z")
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


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


def frame_row(thread: ThreadReconstruction, published_ns: int, zero_ns: int) -> Block:
    """One reconstruction as a whole."""
    unit, factor = length_unit(thread)
    ok = thread.status is Status.OK
    total = length(thread.knots, thread.control_points_camera, thread.degree) * factor if ok else np.nan
    stamp = thread.stamp
    return {
        "frame": whole(stamp.sequence),
        "capture_left_ns": whole(stamp.capture_left_ns),
        "capture_right_ns": whole(stamp.capture_right_ns),
        "published_ns": whole(published_ns),
        "t_s": seconds(stamp.capture_left_ns, zero_ns),
        "status": [thread.status.name.lower()],
        "reason": [thread.reason],
        "method": [thread.method],
        "track": [thread.track.step.name.lower() if thread.track else ""],
        f"length_{unit}": number(total),
        "confidence_mean": number(float(thread.confidence.mean()) if len(thread.confidence) else None),
        "unseen_share": number(float(unseen_at(thread, np.linspace(0, 1, 1001)).mean()) if ok else None),
        "crossings": whole(len(thread.crossings)),
    }


def curve_rows(thread: ThreadReconstruction, zero_ns: int, points: int) -> Block:
    """A curve at places evenly spaced along it, with the covariance of each place."""
    unit, factor = length_unit(thread)
    knots, control_points, degree = thread.knots, thread.control_points_camera, thread.degree
    s = np.linspace(0.0, 1.0, points)
    at = parameters_at(knots, control_points, degree, s * length(knots, control_points, degree))
    curve = evaluate(knots, control_points, degree, at)
    covariance = _interpolated(thread.posterior_s, thread.posterior_covariance, at) * factor**2
    with np.errstate(all="ignore"):
        left_px = project(thread.camera, curve)[0]
    rows: dict[str, Column] = {
        "frame": np.full(points, thread.stamp.sequence),
        "t_s": np.full(points, (thread.stamp.capture_left_ns - zero_ns) * 1e-9),
        "s": s,
    }
    rows |= {f"{axis}_camera_{unit}": curve[:, i] * factor for i, axis in enumerate(AXES)}
    rows |= {"u_left_px": left_px[:, 0], "v_left_px": left_px[:, 1], "confidence": confidence_at(thread, s)}
    rows |= {"seen": (~unseen_at(thread, s)).astype(np.int64), f"deviation_{unit}": _largest_deviation(covariance)}
    return rows | {f"covariance_{AXES[i]}{AXES[j]}_{unit}2": covariance[:, i, j] for i, j in UPPER}


def length_unit(thread: ThreadReconstruction) -> tuple[str, float]:
    """The suffix of lengths and what they are multiplied with: metres where the calibration tells its unit."""
    metres = thread.camera.metres_per_unit
    return ("unit", 1.0) if metres is None else ("m", metres)


def _interpolated(
    at: Float64[np.ndarray, "q"], covariance: Float64[np.ndarray, "q 3 3"], s: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "n 3 3"]:
    """Covariances between those that are told, entry by entry; NaN where none is."""
    if not len(at):
        return np.full((len(s), 3, 3), np.nan)
    after = np.clip(np.searchsorted(at, s), 1, max(1, len(at) - 1))
    before, after = after - 1, np.minimum(after, len(at) - 1)
    span = at[after] - at[before]
    share = np.clip(np.divide(s - at[before], span, out=np.zeros_like(s), where=span > 0), 0.0, 1.0)[:, None, None]
    return (1 - share) * covariance[before] + share * covariance[after]


def _largest_deviation(covariance: Float64[np.ndarray, "n 3 3"]) -> Float64[np.ndarray, "n"]:
    variance = np.linalg.eigvalsh(np.nan_to_num(covariance))[:, -1]
    return np.where(np.isfinite(covariance[:, 0, 0]), np.sqrt(np.maximum(variance, 0.0)), np.nan)


def pose(of: str, frame: str, T: Float64[np.ndarray, "n 4 4"]) -> Block:
    """The poses of a tool in a frame: position in metres and unit quaternion, scalar part first."""
    q_wxyz = quaternion_from_rotation(T[:, :3, :3])
    rows: dict[str, Column] = {f"{of}_{axis}_{frame}_m": T[:, i, 3] for i, axis in enumerate(AXES)}
    return rows | {f"{of}_q{part}_{frame}": q_wxyz[:, i] for i, part in enumerate("wxyz")}


def whole(value: int) -> np.ndarray:
    """A whole number as a column."""
    return np.array([value], np.int64)


def number(value: float | None) -> np.ndarray:
    """A number as a column; NaN for none."""
    return np.array([np.nan if value is None else value], np.float64)


def seconds(at_ns: int, zero_ns: int) -> np.ndarray:
    """A time as a column, in seconds since time zero."""
    return np.array([(at_ns - zero_ns) * 1e-9])


def row_count(block: Block) -> int:
    """How many rows a block has."""
    return len(next(iter(block.values())))
