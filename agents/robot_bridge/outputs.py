"""What a bridge tells: its arm's state, events of a plan, and answers."""

from agents.robot_bridge.arm_status import Standing
from agents.robot_bridge.backend import ArmState, Readiness
from agents.robot_bridge.plans import Refusal
from schemas.messages import (
    CommandAnswer,
    ExecutionEvent,
    ExecutionKind,
    Outcome,
    Phase,
    RobotMode,
    RobotState,
)
from schemas.topics import EXECUTION
from shared.runtime.agent import Output


def robot_state(arm_name: str, arm: ArmState, standing: Standing, mode: RobotMode, plan_id: str) -> RobotState:
    """An arm as measured, with where its base is taken to be."""
    return RobotState(
        arm=arm_name,
        measured_ns=arm.measured_ns,
        mode=mode,
        T_base_tool=standing.measured.tool_pose(arm),
        joints=arm.joints,
        jaw_rad=arm.jaw_rad - standing.setup.jaw.closes_rad,
        T_camera_base=standing.setup.T_camera_base,
        plan_id=plan_id,
        T_camera_base_registered=standing.registered if standing.corrected else None,
        kinematics=standing.setup.kinematics.name,
        correction_looked_ns=standing.looked_ns if standing.corrected else 0,
        jaw_zero_rad=standing.setup.jaw.closes_rad,
        jaw_set_point_rad=arm.jaw_set_point_rad,
        jaw_effort=arm.jaw_effort,
        instrument=arm.instrument,
    )


def mode_of(arm: ArmState, standing: Standing, moving: bool, holding: bool) -> RobotMode:
    """What the arm does, or why it may do nothing."""
    if standing.measured.not_ready:
        return RobotMode.DISABLED if arm.readiness is Readiness.DISABLED else RobotMode.FAULT
    if moving:
        return RobotMode.MOVING
    return RobotMode.HOLDING if holding else RobotMode.IDLE


def event_of(
    arm: str,
    plan_id: str,
    arming_id: str,
    kind: ExecutionKind,
    at_ns: int,
    why: Refusal | None = None,
    phase: Phase | None = None,
) -> Output:
    """One event of a plan."""
    code, reason = (why.code.value, why.sentence) if why else ("", "")
    return Output(EXECUTION, ExecutionEvent(plan_id, arm, at_ns, kind, phase, code, reason, arming_id))


def accepted(command_id: str, but: str = "") -> CommandAnswer:
    """A command is carried out; `but` says what is still to come about."""
    return CommandAnswer(command_id, Outcome.ACCEPTED, "", but)


def refused(command_id: str, why: Refusal) -> CommandAnswer:
    """A command is not carried out."""
    return CommandAnswer(command_id, Outcome.REFUSED, why.code.value, why.sentence)
