"""What a console and others have said of one arm, and what of that speaks against moving it."""

from dataclasses import dataclass, field
from typing import NamedTuple

from agents.robot_bridge.backend import Readiness
from agents.robot_bridge.refusals import Code
from schemas.messages import StateWord
from shared.ros import crtk

SECOND_NS = 1_000_000_000
ERROR_NS, OTHERS_NS, OWN_NS = 1 * SECOND_NS, 2 * SECOND_NS, 1 * SECOND_NS
"""How long an error, another's command, and a command of our own count after they came."""


TELEOPERATION = "console/teleop/enabled"
"""Of all of a console: it tells of no arm by itself."""

STOPPING = (StateWord.PAUSE, StateWord.DISABLE)
"""Words that only stop: they are always sent."""
LEADS_TO = {
    StateWord.ENABLE: "ENABLED",
    StateWord.RESUME: "ENABLED",
    StateWord.HOME: "ENABLED",
    StateWord.PAUSE: "PAUSED",
    StateWord.DISABLE: "DISABLED",
}


class Judged(NamedTuple):
    """Whether an arm may be moved, and if not, why."""

    readiness: Readiness
    code: Code = Code.NOT_READY
    reason: str = ""


class Raw(NamedTuple):
    """Bytes that are not read yet, and when they came."""

    data: bytes
    arrived_ns: int


@dataclass
class Said:
    """What was said, the newest of each; with when it came where that counts.

    Fields:
        left_ready: why the arm was not ready, even where it soon was again; None once that was told.
        missed_ns: when the console said that a goal was not reached.
        publishers: who else could command the arm, by their tokens.
        teleoperation: the console's own is on; None where nobody has said.
    """

    raw: dict[str, Raw] = field(default_factory=dict)
    operating: crtk.OperatingState | None = None
    left_ready: Judged | None = None
    error: tuple[str, int] = ("", 0)
    missed_ns: int = 0
    tool: str = ""
    other: tuple[str, int] = ("", 0)
    publishers: set[str] = field(default_factory=set)
    teleoperation: bool | None = None


def own_word(said: Said, operating: crtk.OperatingState, now_ns: int) -> Judged | None:
    """What the console itself says against moving the arm."""
    if now_ns - said.error[1] < ERROR_NS:
        return Judged(Readiness.FAULT, Code.ERROR_STATE, f"its console says: {said.error[0]}")
    if now_ns - said.missed_ns < ERROR_NS:
        return Judged(Readiness.FAULT, Code.GOAL_NOT_REACHED, "its console says that a goal was not reached")
    return unready(operating) or said.left_ready


def others(said: Said, commanded_ns: int, now_ns: int) -> Judged | None:
    """Who else commands the arm."""
    if said.publishers:
        who = f"somebody else could command it: {min(said.publishers)}; have one owner only"
    elif now_ns - said.other[1] < OTHERS_NS:
        who = f"somebody else commands it by {said.other[0]}; have one owner only"
    elif said.teleoperation:
        who = "its console's teleoperation is on; have one owner only"
    elif said.operating is not None and said.operating.is_busy and now_ns - commanded_ns > OWN_NS:
        who = "it is busy with a motion that is not ours"
    else:
        return None
    return Judged(Readiness.DISABLED, Code.OTHER_OWNER, who)


def unready(state: crtk.OperatingState) -> Judged | None:
    """Why an arm in this state takes no commands; None where it does."""
    if state.state == "ENABLED":
        return None if state.is_homed else Judged(Readiness.DISABLED, Code.NOT_HOMED, "it is not homed")
    why = f"its operating state is {state.state}, not ENABLED"
    if state.state == "FAULT":
        return Judged(Readiness.FAULT, Code.ERROR_STATE, why)
    return Judged(Readiness.DISABLED, Code.NOT_ENABLED, why)


def unchangeable(said: Said, operating: crtk.OperatingState, word: StateWord, now_ns: int) -> str:
    """Why the arm's state must not be changed in this way now; empty where it may."""
    if word in STOPPING:
        return ""
    if said.publishers or now_ns - said.other[1] < OTHERS_NS or said.teleoperation:
        who = min(said.publishers, default=TELEOPERATION if said.teleoperation else said.other[0])
        return f"somebody else has to do with it: {who}; have one owner only"
    allowed = {StateWord.ENABLE: ("DISABLED", "FAULT"), StateWord.RESUME: ("PAUSED",), StateWord.HOME: ("ENABLED",)}
    if operating.state not in allowed[word]:
        needed = " or ".join(allowed[word])
        return f"its operating state is {operating.state}, where {word.name.lower()} needs {needed}"
    return "it is busy with another motion" if operating.is_busy else ""
