"""A person has an arm's console enable, home or pause it: what was asked for, and whether it has come about.

It has where the console's operating state says so and the arm is not busy; as long as that takes no more than LIMIT_S,
an event of the command's id tells it, and afterwards one that it did not.
"""

from dataclasses import dataclass

from agents.robot_bridge.backend import Backend
from agents.robot_bridge.outputs import accepted, event_of, refused
from agents.robot_bridge.plans import Code, Refusal
from schemas.messages import ChangeState, CommandAnswer, ExecutionKind, StateWord
from shared.runtime.agent import Output
from shared.runtime.commands import stops

LIMIT_S, HOMING_LIMIT_S = 5.0, 60.0
"""Within which a state is to be reached; a real arm homes for half a minute."""


@dataclass(frozen=True)
class _Asked:
    word: StateWord
    command_id: str
    at_ns: int


class StateChanges:
    """One arm's; the newest alone is waited for."""

    def __init__(self, arm: str, backend: Backend) -> None:
        self._arm, self._backend = arm, backend
        self._asked: _Asked | None = None

    @property
    def awaited(self) -> str:
        """What it was told and has not come about yet; empty where nothing is."""
        return "" if self._asked is None else self._asked.word.name.lower()

    def answer(self, message: ChangeState, now_ns: int, ratio: float) -> CommandAnswer:
        """Have the console do it; why not."""
        of, word = message.header.id, message.word.name.lower()
        if self._backend.dry_run:
            would = f"{word} was not sent: this is a dry run (dry_run of the arm's configuration)"
            return refused(of, Refusal(Code.DRY_RUN, would))
        if not stops(message):
            self._backend.slow_down(ratio)
        if why := self._backend.change_state(message.word, now_ns):
            return refused(of, Refusal(Code.NO_STATES, f"{word} was not sent: {why}"))
        self._asked = _Asked(message.word, of, now_ns)
        return accepted(of)

    def turn(self, now_ns: int) -> list[Output]:
        """What has become of the newest, once."""
        asked = self._asked
        if asked is None:
            return []
        of = self._arm, f"state {asked.word.name.lower()}", asked.command_id
        if self._backend.reached_state(asked.word):
            self._asked = None
            return [event_of(*of, ExecutionKind.FINISHED, now_ns)]
        limit_s = HOMING_LIMIT_S if asked.word is StateWord.HOME else LIMIT_S
        if now_ns - asked.at_ns <= limit_s * 1e9:
            return []
        self._asked = None
        late = f"{asked.word.name.lower()} has not come about within {limit_s:g} s: see what the console says"
        return [event_of(*of, ExecutionKind.REFUSED, now_ns, Refusal(Code.STATE_NOT_REACHED, late))]
