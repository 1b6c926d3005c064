"""What an agent was fed since its last output: the list that its next output carries, for a replay to feed it again.

A list holds, in the order in which they were fed, every message and every tick since the output before, and the newest
of each key of which nothing else counts. An agent of which more counts than the newest of each input also names its
output before, as the state that it went on from: so the lists of a run are a chain, and one that was lost is noticed.
An agent whose output holds all of that state (`goes_on_from`) names it too, and a replay can go on from there.
"""

from schemas.messages import Consumed
from schemas.topics import key_root
from shared.runtime.agent import Agent

TICK, OMITTED = "tick", "omitted"
"""The last parts of keys under which nothing is published. A tick's number is its time in nanoseconds; the number under
`omitted` says how many entries a list left out."""
MOST_LISTED = 1000
"""Entries of one list. An agent that is fed and says nothing leaves out the oldest, and a replay knows."""


def adds_up(agent: Agent) -> bool:
    """Whether what an agent says follows from more than the newest of each input: from all that it was ever fed.

    Of one that goes on from its last output, all that counts of earlier inputs lies there.
    """
    if agent.goes_on_from is not None:
        return False
    return agent.tick_hz is not None or not all(i.only_newest_counts for i in agent.inputs)


def is_tick(key: str) -> bool:
    """Whether a list's key stands for a tick of the agent's own clock, which is in no recording but in the list."""
    return key.endswith(f"/{TICK}")


class Fed:
    """The list of one run of one agent."""

    def __init__(self, agent: Agent, rig: str, epoch: int) -> None:
        self._root, self._epoch = key_root(rig, agent.instance, agent.kind), epoch
        self._names_output = adds_up(agent) or agent.goes_on_from is not None
        self._idle_ticks_count = not agent.only_newest_tick_counts
        self._newest_only: set[str] = set()
        self._entries: list[Consumed] = []
        self._omitted = 0

    def message(self, key: str, epoch: int, sequence: int, only_newest_counts: bool = False) -> None:
        """Add a message that is about to be fed."""
        if only_newest_counts:
            self._newest_only.add(key)
            self._remove(key)
        self._add(Consumed(key, epoch, sequence))

    def tick(self, now_ns: int) -> None:
        """Add a tick that is about to be fed."""
        if not self._idle_ticks_count:
            self._remove(f"{self._root}/{TICK}")
        self._add(Consumed(f"{self._root}/{TICK}", self._epoch, now_ns))

    def listed(self) -> tuple[Consumed, ...]:
        """What an output that follows now was made from."""
        omitted = [Consumed(f"{self._root}/{OMITTED}", self._epoch, self._omitted)] if self._omitted else []
        return (*omitted, *self._entries)

    def published(self, key: str, sequence: int) -> None:
        """Begin the next list, after an output that carries this one."""
        self._entries = [c for c in self._entries if c.key in self._newest_only]
        self._omitted = 0
        if self._names_output:
            self._entries.append(Consumed(key, self._epoch, sequence))

    def _remove(self, key: str) -> None:
        self._entries = [c for c in self._entries if c.key != key]

    def _add(self, entry: Consumed) -> None:
        self._entries.append(entry)
        if len(self._entries) > MOST_LISTED:
            oldest = next((i for i, c in enumerate(self._entries) if c.key not in self._newest_only), 0)
            del self._entries[oldest]
            self._omitted += 1
