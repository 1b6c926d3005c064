"""What a person at the terminal of an experiment is asked, and a simulated experiment answers by itself."""

import os
import select
import threading

from agents.experiment.journal import CAUSES, Attempt, Cause, Trial
from schemas.messages import ExecutionEvent, GraspPlan
from shared.terminal import say, show

STANDARD_INPUT, LOOK_S, READ_BYTES = 0, 0.1, 4096


class LeftError(RuntimeError):
    """Nobody answers any more, or somebody wants to stop here; the text says so."""


class Person:
    """Answers at the terminal, in lines of standard input."""

    def __init__(self, stopped: threading.Event) -> None:
        """`stopped` is set by Ctrl-C."""
        self._stopped, self._kept = stopped, b""

    def lay(self, trial: Trial, left: int) -> None:
        """Return once the thread lies ready, let go of and as it was."""
        said = f"{trial.thread}, {left} left: {trial.policy} at {trial.s:.1%}"
        self._asked(f"{said}. The jaw empty, the thread as it was laid? Enter goes on: ", {"": ""})

    def arms(self, plan: GraspPlan) -> bool:
        """Whether this plan is to be armed; otherwise another is asked for."""
        asked = f"Enter arms {plan.arm}, and Ctrl-C holds it; a plans anew: "
        return self._asked(asked, {"": "arm", "a": "anew"}) == "arm"

    def stuck(self, reason: str) -> None:
        """Return once what kept the arm from being armed may be over."""
        self._asked(f"{reason}. Enter tries again: ", {"": ""})

    def held(self, event: ExecutionEvent) -> tuple[Cause, str] | None:
        """Why a motion that was stopped is a failure of the grasp; None where it is to be tried again."""
        asked = "Was it the fault of the plan? y: a failure, n: try it again: "
        return ("stopped", event.reason) if self._asked(asked, {"y": "y", "n": ""}) else None

    def verdict(self) -> tuple[bool, Cause | None, str]:
        """Whether the grasp held; if not why, and a note in the person's words."""
        if self._asked("Did the grasp hold? y, n: ", {"y": "y", "n": ""}):
            return True, None, ""
        for number, (cause, told) in enumerate(CAUSES.items(), 1):
            show(f"  {number}  {cause}: {told}")
        causes: dict[str, Cause] = {str(number): cause for number, cause in enumerate(CAUSES, 1)}  # pyright: ignore[reportAssignmentType] - the keys are the causes
        cause = causes[self._asked("Why not? ", {number: number for number in causes})]
        return False, cause, self._line("A note, or Enter: ")

    def _asked(self, question: str, answers: dict[str, str]) -> str:
        while True:
            answer = self._line(question).lower()
            if answer in answers:
                return answers[answer]
            say(f"{answer!r} is no answer to this; give one of {', '.join(key or 'Enter' for key in answers)}")

    def _line(self, question: str) -> str:
        """The next line of standard input; a wait that Ctrl-C ends."""
        print(question, end="", flush=True)
        while b"\n" not in self._kept:
            if self._stopped.is_set():
                raise LeftError("interrupted")
            if not select.select([STANDARD_INPUT], [], [], LOOK_S)[0]:
                continue
            if not (more := os.read(STANDARD_INPUT, READ_BYTES)):
                raise LeftError("standard input has ended, and nobody answers")
            self._kept += more
        line, self._kept = self._kept.split(b"\n", 1)
        return line.decode(errors="replace").strip()


class Nobody:
    """A simulated experiment with a simulated arm: what a person would do by hand happens by itself."""

    def __init__(self, stopped: threading.Event) -> None:
        """`stopped` is set by Ctrl-C."""
        self._stopped = stopped

    def lay(self, trial: Trial, left: int) -> None:
        """Only tell."""
        if self._stopped.is_set():
            raise LeftError("interrupted")
        say(f"{trial.thread}, {left} left: {trial.policy} at {trial.s:.1%}")

    def arms(self, plan: GraspPlan) -> bool:
        """Nothing real moves."""
        return bool(plan.plan_id)

    def stuck(self, reason: str) -> None:
        """Wait a little."""
        say(f"{reason}; it is tried again")
        self._stopped.wait(1.0)

    def held(self, event: ExecutionEvent) -> tuple[Cause, str] | None:
        """On a busy machine a heartbeat may come late, and the arm holds, as it should: again."""
        self.stuck(f"{event.arm} held ({event.code})")
        return None


Attendant = Person | Nobody
"""Who stands by: lays the thread, arms, and says what came of a motion that has ended by itself."""


def outcome_sentence(attempt: Attempt) -> str:
    """What came of a trial, in one line."""
    why = ", ".join(filter(None, (attempt.cause, attempt.note)))
    return f"{attempt.outcome}{f': {why}' if why else ''}"
