"""Why the bridge does not move an arm, or stops it: a code for programs, a sentence for people."""

import enum
from dataclasses import dataclass


class Code(enum.StrEnum):
    """What can speak against a motion. docs/robot_bridge.md says what to do about each."""

    OTHER_ARM = "other_arm"
    UNKNOWN_PLAN = "unknown_plan"
    REJECTED_PLAN = "rejected_plan"
    BUSY = "busy"
    NOT_READY = "not_ready"
    NOT_ENABLED = "not_enabled"
    NOT_HOMED = "not_homed"
    ERROR_STATE = "error_state"
    WRONG_TOOL = "wrong_tool"
    OTHER_POSE = "other_pose"
    OTHER_OWNER = "other_owner"
    OTHER_SET_POINT = "other_set_point"
    STALE_STATE = "stale_state"
    GOAL_NOT_REACHED = "goal_not_reached"
    STALE = "stale"
    CLOCK = "clock"
    MOVED = "moved"
    OUT_OF_ORDER = "out_of_order"
    WRONG_FRAME = "wrong_frame"
    REPLAY = "replay"
    NOT_FINITE = "not_finite"
    NOT_A_POSE = "not_a_pose"
    WORKSPACE = "workspace"
    UNREACHABLE = "unreachable"
    REMOTE_CENTRE = "remote_centre"
    SINGULAR = "singular"
    TISSUE = "tissue"
    WRIST_FLIP = "wrist_flip"
    JAW_LIMIT = "jaw_limit"
    TOO_LONG = "too_long"
    HEARTBEAT_LOST = "heartbeat_lost"
    HOLD_COMMAND = "hold_command"
    NOT_FOLLOWING = "not_following"
    STATE_NOT_REACHED = "state_not_reached"
    CORRECTION_LOST = "correction_lost"
    CORRECTION_JUMPED = "correction_jumped"
    CORRECTION_LIMIT = "correction_limit"
    NO_PRESENCE = "no_presence"
    ROUND_TRIP = "round_trip"
    NO_GUARD = "no_guard"
    FRAME_AGE = "frame_age"
    UNKNOWN = "unknown"
    SEGMENT = "segment"
    FAULT = "fault"
    DRY_RUN = "dry_run"
    NO_STATES = "no_states"


AGAINST_PLAN = frozenset(
    {
        Code.REJECTED_PLAN,
        Code.NOT_FINITE,
        Code.NOT_A_POSE,
        Code.WORKSPACE,
        Code.UNREACHABLE,
        Code.REMOTE_CENTRE,
        Code.SINGULAR,
        Code.TISSUE,
        Code.WRIST_FLIP,
        Code.JAW_LIMIT,
        Code.TOO_LONG,
    }
)
"""What speaks against a plan itself; all others speak against the moment, and the same plan may do later."""


@dataclass(frozen=True)
class Refusal:
    """One reason not to move."""

    code: Code
    sentence: str


REPLAYED = Refusal(
    Code.REPLAY, "a recording is replayed on this rig, and this arm is real: end the replay, then set a goal and arm"
)
UNMEASURED = Refusal(Code.NOT_READY, "the arm has not been measured yet")


def other_arm(mine: str, *named: str) -> Refusal | None:
    """Why a command is not for this arm; None where all that it names is."""
    other = next((name for name in named if name != mine), None)
    return None if other is None else Refusal(Code.OTHER_ARM, f"the command is for {other}, and this is {mine}")
