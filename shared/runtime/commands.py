"""Commands: a query with an id and a deadline, carried out at most once, with an answer.

No answer means that the outcome is unknown, since the receiver may have died after carrying it out. So a command is
never sent again blindly: its sender asks for the status of its id, which carries out nothing.
"""

import uuid
from collections import OrderedDict
from typing import Any

import zenoh

from schemas.checks import MessageError
from schemas.codec import decode, encode
from schemas.messages import ChangeState, CommandAnswer, CommandHeader, Hold, Outcome, StateWord
from schemas.topics import MAIN, Topic, key
from shared.clock import now_ns
from shared.runtime.attachment import encoding_of

STATUS = "status"
"""The parameter of a query that asks what became of a command's id."""
OTHER_KEY = "other_key"
"""Of a command that came to another receiver than it was sent to, which did not read it."""
REMEMBERED = 1000
DEFAULT_DEADLINE_S = 2.0
"""The longest deadline that anything here sets."""
FARTHEST_DEADLINE_S = DEFAULT_DEADLINE_S + 5.0
"""A command whose deadline lies farther ahead of its receiver's clock is refused: it could wait somewhere, and be
carried out long after whoever sent it has turned to something else."""


def new_header(sender: str, deadline_s: float = DEFAULT_DEADLINE_S) -> CommandHeader:
    """The header of a new command: a unique id, and the time after which it must not be carried out."""
    return CommandHeader(id=uuid.uuid4().hex, deadline_ns=now_ns() + round(deadline_s * 1e9), sender=sender)


def send_command(
    session: zenoh.Session,
    rig: str,
    topic: Topic,
    message: Any,
    instance: str = MAIN,
    timeout_s: float = 3.0,
    agent: str = "",
) -> CommandAnswer:
    """Send a command once and return its answer; where none comes, the status of its id, or UNKNOWN.

    `agent` says whom it is for, where every agent answers it under its own key.
    """
    selector = key(rig, topic, instance, agent)
    command_id, encoding = message.header.id, encoding_of(topic.message, selector)
    answer = _ask(session, selector, encode(message), encoding, timeout_s, command_id)
    if answer is not None and answer.code == OTHER_KEY:
        # it came to somebody else, who did nothing with it
        answer = _ask(session, selector, encode(message), encoding, timeout_s, command_id)
    if answer is None:
        answer = _ask(session, f"{selector}?{STATUS}={command_id}", b"", "", 0.5 * timeout_s, command_id)
    if answer is None:
        reason = (
            f"no answer from the {agent or topic.receiver} ({instance}): it may not be running; nothing is sent again"
        )
        return CommandAnswer(command_id, Outcome.UNKNOWN, "no_answer", reason)
    return answer


def stops(message: Any) -> bool:
    """Whether a command stops an arm: it is carried out before all others, and whatever else is the matter."""
    return isinstance(message, Hold) or (
        isinstance(message, ChangeState) and message.word in (StateWord.PAUSE, StateWord.DISABLE)
    )


def stops_unread(topic: Topic, payload: bytes) -> bool:
    """Whether a command that nobody has looked at yet stops an arm; on a topic that only stops, whatever it says.

    One that may stop and cannot be read, such as of a newer version, does: to stand harms nobody.
    """
    if topic.good_when_late:
        return True
    if topic.message is not ChangeState:
        return False
    try:
        return stops(decode(ChangeState, payload))
    except MessageError:
        return True


def id_of(message_type: type, payload: bytes) -> str:
    """The id of a command that nobody has looked at yet; empty where it cannot be read."""
    try:
        return decode(message_type, payload).header.id
    except MessageError:
        return ""


def refused(command_id: str, code: str, reason: str) -> CommandAnswer:
    """An answer that refuses."""
    return CommandAnswer(command_id, Outcome.REFUSED, code, reason)


def untimely(header: CommandHeader, received_ns: int) -> CommandAnswer | None:
    """The refusal of a command that came after its deadline, or with one that lies too far ahead; None for others."""
    ahead_ns = header.deadline_ns - received_ns
    if ahead_ns < 0:
        late = f"it arrived {-ahead_ns * 1e-9:.2f} s after its deadline"
        return refused(header.id, "late", f"{late}: it was long on its way, or the clocks of the two hosts are apart")
    if ahead_ns > FARTHEST_DEADLINE_S * 1e9:
        ahead = f"its deadline lies {ahead_ns * 1e-9:.1f} s ahead, and {FARTHEST_DEADLINE_S:g} s are allowed"
        return refused(header.id, "far_deadline", f"{ahead}: set the clocks of sender and receiver by each other")
    return None


def accepted(command_id: str) -> CommandAnswer:
    """An answer that accepts."""
    return CommandAnswer(command_id, Outcome.ACCEPTED, "", "")


class Answered:
    """The answers to the last commands by id, so that none is carried out twice."""

    def __init__(self) -> None:
        self._answers: OrderedDict[str, CommandAnswer] = OrderedDict()

    def recall(self, command_id: str) -> CommandAnswer | None:
        """What was answered to that id, None where it is new."""
        return self._answers.get(command_id)

    def remember(self, answer: CommandAnswer) -> None:
        """Keep an answer; the oldest are forgotten."""
        self._answers[answer.id] = answer
        while len(self._answers) > REMEMBERED:
            self._answers.popitem(last=False)


def _ask(
    session: zenoh.Session, selector: str, payload: bytes, encoding: str, timeout_s: float, command_id: str
) -> CommandAnswer | None:
    """The answer to that command; what could not be read was refused without its id."""
    replies = session.get(
        selector,
        payload=payload,
        encoding=encoding or None,
        timeout=timeout_s,
        consolidation=zenoh.ConsolidationMode.NONE,
    )
    for reply in replies:
        if reply.ok is not None:
            try:
                answer = decode(CommandAnswer, reply.ok.payload.to_bytes())
            except MessageError:
                return None
            if answer.id == command_id or (not answer.id and answer.outcome is Outcome.REFUSED):
                return answer
    return None
