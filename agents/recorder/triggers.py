"""What has gone wrong, so that the seconds before it are worth keeping."""

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import AgentHealth, ExecutionEvent, ExecutionKind, GraspJudgement, RobotMode, RobotState, Verdict
from schemas.topics import EXECUTION, HEALTH, JUDGEMENT, ROBOT_STATE, Topic

WATCHED = (EXECUTION, JUDGEMENT, ROBOT_STATE, HEALTH)


class Triggers:
    """Looks at messages one after another; what lasts triggers once, when it begins."""

    def __init__(self) -> None:
        self._lasting: dict[str, bool] = {}

    def of(self, topic: Topic, key: str, payload: bytes) -> str | None:
        """The one word for what a message tells of; None where all goes well."""
        if topic not in WATCHED:
            return None
        try:
            message = decode(topic.message, payload)
        except MessageError:
            return None
        match message:
            case ExecutionEvent(kind=(ExecutionKind.HELD | ExecutionKind.REFUSED) as kind):
                return kind.name.lower()
            case GraspJudgement(verdict=verdict) if verdict is not Verdict.HELD:
                return verdict.name.lower()
            case RobotState():
                return self._begins(key, message.mode is RobotMode.FAULT)
            case AgentHealth():
                return self._begins(key, message.fault != "")
            case _:
                return None

    def _begins(self, key: str, faulty: bool) -> str | None:
        before, self._lasting[key] = self._lasting.get(key, False), faulty
        return "fault" if faulty and not before else None
