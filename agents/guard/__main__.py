"""The monitor as a process: `python -m agents.guard`, with its document as the first line of standard input.

`suturegrasp guard` starts it and keeps its standard input open: at its end the arm is held if it moves, and the monitor
ends. What it does it says in lines of JSON on standard output, which nothing waits for: what finds no room is dropped.
"""

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
from shared.ros.guarded import Gate

TURN_S, RESTING_TURN_S, CHALLENGE_TURNS, STATUS_TURNS = 0.01, 0.08, 2, 10
"""A challenge every 20 ms while something moves, or is about to, and every 80 ms at rest."""
ENDS_S = 1.0
EXIT_OK, EXIT_LINK_BROKE = 0, 75
"""The second where the robot's Zenoh was lost: a session whose link broke has taken one key for another, and is not
used again. Whoever started the monitor starts another one."""


def main() -> int:
    """Watch until standard input ends, or the robot's link breaks."""
    # whoever started it is told, and ends its standard input: so the arm is held first
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    document = json.loads(sys.stdin.readline())
    os.set_blocking(sys.stdout.fileno(), False)
    monitor = Monitor(Description.from_document(document["description"]))
    links = Links(monitor, document, lambda what, why: _tell(what=what, why=why))
    ended = threading.Event()
    threading.Thread(target=_await_end, args=(ended,), daemon=True).start()
    threading.Thread(target=_open_rig, args=(links, ended), daemon=True).start()
    links.open_robot()
    _tell(what="guards", modules="numpy" in sys.modules)
    status = _watch(links, ended)
    if monitor.gate is Gate.OPEN:
        links.hold("the guard was stopped" if status == EXIT_OK else "the robot's Zenoh was lost")
    # a session can take long to close, and nothing is left to be said
    sys.stdout.flush()
    os._exit(status)


def _watch(links: Links, ended: threading.Event) -> int:
    turn, next_s = 0, monotonic_s()
    while not ended.wait(max(0.0, next_s - monotonic_s())):
        stirs = links.turn()
        next_s, turn = max(next_s + (TURN_S if stirs else RESTING_TURN_S), monotonic_s()), turn + 1
        if turn % CHALLENGE_TURNS == 0 or not stirs:
            links.challenge()
        if turn % STATUS_TURNS == 0:
            _tell(what="alive", refused=links.refused)
        if links.broke:
            return EXIT_LINK_BROKE
    return EXIT_OK


def _open_rig(links: Links, ended: threading.Event) -> None:
    """Nobody stands by before the rig is heard."""
    try:
        links.open_rig()
    except Exception as error:
        _tell(what="failed", why=f"the rig is not heard: {error}")
        ended.set()


def _await_end(ended: threading.Event) -> None:
    while sys.stdin.readline():
        pass
    ended.set()
    # one that still waits for the robot's Zenoh has nothing to hold
    threading.Event().wait(ENDS_S)
    os._exit(EXIT_OK)


def _tell(**told: Any) -> None:
    try:
        os.write(sys.stdout.fileno(), (json.dumps(told) + "\n").encode())
    except OSError:
        # nobody reads: what is done is done all the same
        return


if __name__ == "__main__":
    sys.exit(main())
