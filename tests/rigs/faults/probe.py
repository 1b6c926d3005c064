"""One on each host that says events at a steady rate and hears those of all others: none of them may get lost.

    python -m tests.rigs.faults.probe CONFIG FILE

It publishes as every agent publishes its log, under the name of its host's operator, and listens as the recorder
listens. What it has said and heard is in the file, once a second.
"""

import json
import os
import sys
import threading
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from agents.configuration.hosts import OPERATOR
from schemas.codec import encode
from schemas.messages import LogLevel, LogRecord
from schemas.topics import LOG, Topic, key
from shared.clock import now_ns
from shared.runtime.attachment import Attachment, pack
from shared.runtime.connection import open_when_there
from shared.runtime.delivery import declare_publisher
from shared.runtime.taps import Tapped, tap
from tests.rigs.faults.rig import settings_at

RATE_HZ = 20.0


@dataclass
class Heard:
    """Which numbers of each probe came, and how often they came out of order, or twice."""

    numbers: defaultdict[str, set[int]] = field(default_factory=lambda: defaultdict(set))
    newest: dict[str, int] = field(default_factory=dict)
    disordered: int = 0
    given_up: int = 0

    def give_up(self, _topic: Topic, count: int) -> None:
        """Note how many the subscriber says that it could not get."""
        self.given_up += count

    def take(self, tapped: Tapped) -> None:
        """Note one."""
        if tapped.beside is None or f"/{OPERATOR}/" not in tapped.key:
            return
        host, number = tapped.key.split("/")[-2], tapped.beside.sequence
        self.disordered += number <= self.newest.get(host, -1)
        self.newest[host] = number
        self.numbers[host].add(number)

    def told(self, said: int) -> str:
        """What was said so far, and heard: each probe's newest number, and how many before it did not come."""
        # copied at once: more are noted meanwhile, in another thread
        heard = {host: (self.newest[host], _missing(numbers.copy())) for host, numbers in list(self.numbers.items())}
        return json.dumps({"said": said, "heard": heard, "disordered": self.disordered, "given_up": self.given_up})


def probe(config: Path, path: Path) -> None:
    """Say and hear until standard input ends."""
    ended, heard, epoch = threading.Event(), Heard(), int.from_bytes(os.urandom(7), "big")
    threading.Thread(target=_wait_for_end, args=(ended,), daemon=True).start()
    settings, host = settings_at(config), config.parent.name
    with open_when_there(settings) as session:
        publisher = declare_publisher(session, key(settings.rig, LOG, host, OPERATOR), LOG)
        kept = tap(session, settings.rig, (LOG,), heard.take, heard.give_up)
        number = 0
        while not ended.wait(1.0 / RATE_HZ):
            record = LogRecord(now_ns(), OPERATOR, host, LogLevel.INFO, f"event {number}")
            publisher.put(encode(record), attachment=pack(Attachment(epoch, number, record.at_ns, 0.0)))
            number += 1
            if number % int(RATE_HZ) == 0:
                fresh = path.with_suffix(".new")
                fresh.write_text(heard.told(number))
                fresh.rename(path)
        for declared in (*kept, publisher):
            declared.undeclare()


def _missing(numbers: set[int]) -> int:
    return max(numbers) + 1 - len(numbers) if numbers else 0


def _wait_for_end(ended: threading.Event) -> None:
    while os.read(0, 1):
        pass
    ended.set()


if __name__ == "__main__":
    probe(Path(sys.argv[1]), Path(sys.argv[2]))
