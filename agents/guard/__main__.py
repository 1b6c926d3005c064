"""The monitor as a process: `python -m agents.guard`, with its document as the first line of standard input.

`suturegrasp guard` starts it and keeps its standard input open: at its end the arm is held if it moves, and the monitor
ends. What it does it says in lines of JSON on standard output, which nothing waits for: what finds no room is dropped.
"""

import contextlib
import json
import os
import signal
import sys
import threading
from typing import Any

from agents.guard.description import Description
from agents.guard.links import Links
from agents.guard.monitor import Monitor
from shared.clock import monotonic_s

TURN_S, PEDAL_TURN_S, RESTING_TURN_S, CHALLENGE_TURNS, STATUS_TURNS = 0.01, 0.04, 0.08, 2, 10
"""A challenge every 20 ms while something moves, or is about to, and in each turn at rest, sooner with a pedal."""
EXIT_OK, EXIT_FAILED, EXIT_LINK_BROKE = 0, 1, 75
"""The last where the robot's Zenoh was lost: a session whose link broke has taken one key for another, and is not
used again. Whoever started the monitor starts another one."""


def main() -> None:
    """Watch until standard input ends, or the robot's link breaks."""
    # whoever started it is told, and ends its standard input: so the arm is held first
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    document = json.loads(sys.stdin.readline())
    os.set_blocking(sys.stdout.fileno(), False)
    description = Description.from_document(document["description"])
    links = Links(Monitor(description), document, lambda what, why: _tell(what=what, why=why))
    threading.excepthook = lambda failed: _end(links, f"the guard cannot go on: {failed.exc_value}", EXIT_FAILED)
    for part in (lambda: _watch(links, PEDAL_TURN_S if description.pedal else RESTING_TURN_S), links.open_rig):
        threading.Thread(target=part, daemon=True).start()
    while sys.stdin.readline():
        pass
    _end(links, "the guard was stopped", EXIT_OK)


def _watch(links: Links, rests_s: float) -> None:
    links.open_robot()
    _tell(what="guards", modules="numpy" in sys.modules)
    turn, next_s = 0, monotonic_s()
    while not links.broke:
        turn, stirs = turn + 1, links.turn()
        if turn % CHALLENGE_TURNS == 0 or not stirs:
            links.challenge()
        if turn % STATUS_TURNS == 0:
            _tell(what="alive", refused=links.refused)
        next_s = max(next_s + (TURN_S if stirs else rests_s), monotonic_s())
        threading.Event().wait(next_s - monotonic_s())
    _end(links, "the robot's Zenoh was lost", EXIT_LINK_BROKE)


def _end(links: Links, why: str, status: int) -> None:
    links.end(why)
    if status == EXIT_FAILED:
        _tell(what="failed", why=why)
    # a session can take long to close, and nothing is left to be said
    os._exit(status)


def _tell(**told: Any) -> None:
    # where nobody reads, what is done is done all the same
    with contextlib.suppress(OSError):
        os.write(sys.stdout.fileno(), (json.dumps(told) + "\n").encode())


if __name__ == "__main__":
    main()
