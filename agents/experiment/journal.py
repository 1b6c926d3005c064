"""What an experiment is to do and what came of it so far, as one file holds it."""

import re
import zlib
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, StringConstraints

from shared.runtime.config import Settings

THREAD = re.compile(r"[a-z0-9_]+/[a-z0-9_]+(/[0-9]+)?")
ThreadName = Annotated[str, StringConstraints(pattern=f"^{THREAD.pattern}$")]
PolicyName = Literal["direct", "robust"]
POLICIES: tuple[PolicyName, ...] = ("direct", "robust")
CAUSES = {
    "missed": "the jaw closed beside the thread",
    "slipped": "the thread was captured, and slipped out in the slide",
    "tissue": "the jaw caught or pushed tissue",
    "displaced": "the tool pushed the thread away before it closed",
    "stopped": "the motion was stopped, and that is the fault of what was planned",
    "other": "something else",
}
Cause = Literal["missed", "slipped", "tissue", "displaced", "stopped", "other"]


class Protocol(Settings):
    """What is to be tried.

    Fields:
        seed: of the order.
        goals: on each thread, evenly spaced.
        threads: configuration/background, and a number where there are several of one kind.
        verdicts: who says whether a grasp held.
    """

    seed: int = Field(ge=0)
    goals: int = Field(ge=1, le=100)
    threads: tuple[ThreadName, ...] = Field(min_length=1)
    arm: str
    verdicts: Literal["operator", "simulated"]


class Trial(Settings):
    """One grasp to be tried: a goal on a thread (s by arc length, 0 to 1) with a policy."""

    thread: ThreadName
    goal: int
    s: float
    policy: PolicyName


class Attempt(Settings):
    """What came of a trial.

    Fields:
        outcome: `declined` where the planner or the robot bridge would not, so that nothing moved.
        cause, note: why it failed or was declined; the note is in people's or the agents' own words.
        probability: of success, as the plan promised.
        execution_s: from armed to finished.
        repeats: how often the trial had been begun before and came to no outcome.
    """

    trial: Trial
    outcome: Literal["held", "failed", "declined"]
    cause: Cause | Literal[""] = ""
    note: str = ""
    plan_id: str = ""
    probability: float | None = None
    slide_m: float | None = None
    execution_s: float | None = None
    repeats: int = 0
    at_ns: int = 0


class Journal(Settings):
    """An experiment so far.

    Fields:
        begun: the trial that is under way, and how often it had been begun before.
        sessions: the recordings of each thread, beside the journal.
    """

    version: Literal[1] = 1
    protocol: Protocol
    attempts: tuple[Attempt, ...] = ()
    begun: tuple[Trial, int] | None = None
    sessions: dict[ThreadName, tuple[str, ...]] = Field(default_factory=dict)

    def begin(self, trial: Trial) -> "Journal":
        """The journal once a trial is under way."""
        again = self.begun[1] + 1 if self.begun is not None and self.begun[0] == trial else 0
        return self.model_copy(update={"begun": (trial, again)})

    def note(self, attempt: Attempt) -> "Journal":
        """The journal with what came of the trial that was under way."""
        repeats = self.begun[1] if self.begun is not None and self.begun[0] == attempt.trial else 0
        noted = attempt.model_copy(update={"repeats": repeats})
        return self.model_copy(update={"attempts": (*self.attempts, noted), "begun": None})

    def recorded(self, thread: str, session: str) -> "Journal":
        """The journal with one more recording of a thread."""
        kept = (*self.sessions.get(thread, ()), session)
        return self.model_copy(update={"sessions": {**self.sessions, thread: kept}})

    def left(self, thread: str) -> list[Trial]:
        """What is still to be tried on a thread, in its order."""
        tried = {(a.trial.thread, a.trial.goal, a.trial.policy) for a in self.attempts}
        return [t for t in order(self.protocol, thread) if (t.thread, t.goal, t.policy) not in tried]


def order(protocol: Protocol, thread: str) -> list[Trial]:
    """The trials of a thread: its goals in a drawn order, each with both policies, one after the other, drawn too.

    What drifts in the course of an hour then falls to both policies alike.
    """
    rng = np.random.default_rng([protocol.seed, zlib.crc32(thread.encode())])
    trials: list[Trial] = []
    for goal in rng.permutation(protocol.goals):
        s = round((float(goal) + 0.5) / protocol.goals, 6)
        pair = [Trial(thread=thread, goal=int(goal), s=s, policy=policy) for policy in POLICIES]
        trials += [pair[int(i)] for i in rng.permutation(len(pair))]
    return trials
