"""One on each host that says events at a steady rate and hears those of all others: none of them may get lost.

    python -m tests.rigs.faults.probe CONFIG FILE     # what it has said and heard is in the file, once a second

It publishes as every agent publishes its log, and listens as the recorder listens.
"""

import json
import os
import sys
import threading
from collections import defaultdict
from pathlib import Path

from agents.configuration.hosts import OPERATOR
from schemas.codec import encode
from schemas.messages import LogLevel, LogRecord
from schemas.topics import LOG, key
from shared.clock import now_ns
from shared.runtime.attachment import Attachment, pack
from shared.runtime.connection import open_when_there
from shared.runtime.delivery import declare_publisher
from shared.runtime.taps import Tapped, tap
from tests.rigs.faults.rig import settings_at

RATE_HZ = 20.0


def probe(config: Path, path: Path) -> None:
    """Say and hear until standard input ends."""
    ended, heard = threading.Event(), defaultdict[str, set[int]](set)
    epoch, settings, host = int.from_bytes(os.urandom(7), "big"), settings_at(config), config.parent.name

    def wait_for_end() -> None:
        while os.read(0, 1):
            pass
        ended.set()

    def take(tapped: Tapped) -> None:
        if tapped.beside is not None and f"/{OPERATOR}/" in tapped.key:
            heard[tapped.key.split("/")[-2]].add(tapped.beside.sequence)

    threading.Thread(target=wait_for_end, daemon=True).start()
    with open_when_there(settings) as session:
        publisher = declare_publisher(session, key(settings.rig, LOG, host, OPERATOR), LOG)
        kept = tap(session, settings.rig, (LOG,), take, lambda _topic, _count: None)
        number = 0
        while not ended.wait(1.0 / RATE_HZ):
            record = LogRecord(now_ns(), OPERATOR, host, LogLevel.INFO, f"event {number}")
            publisher.put(encode(record), attachment=pack(Attachment(epoch, number, record.at_ns, 0.0)))
            number += 1
            if number % int(RATE_HZ) == 0:
                fresh = path.with_suffix(".new")
                # copied at once: more are noted meanwhile, in another thread
                came = {host: numbers.copy() for host, numbers in list(heard.items())}
                newest = {host: (max(n), max(n) + 1 - len(n)) for host, n in came.items() if n}
                fresh.write_text(json.dumps({"said": number, "heard": newest}))
                fresh.rename(path)
        for declared in (*kept, publisher):
            declared.undeclare()


if __name__ == "__main__":
    probe(Path(sys.argv[1]), Path(sys.argv[2]))
