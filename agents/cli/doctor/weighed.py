"""How large the messages of a rig's streams are, by one of each as it comes."""

import threading

from agents.cli.doctor.crossing import STREAMS
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped

WITHIN_S = 1.0


def weigh(connection: Connection, within_s: float = WITHIN_S) -> dict[str, float]:
    """Bytes of one message of each stream, by topic, of those that come in time."""
    found, came = dict[str, float](), threading.Condition()

    def take(tapped: Tapped) -> None:
        with came:
            found[str(tapped.topic)] = float(len(tapped.payload))
            came.notify()

    with connection.listening(STREAMS, take), came:
        came.wait_for(lambda: len(found) == len(STREAMS), within_s)
        return dict(found)
