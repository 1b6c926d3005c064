"""A process that records messages of its own, as fast as it is told, until it is killed."""

import sys
import threading
from pathlib import Path

from agents.recorder.recorder import Recorder
from schemas.codec import encode
from schemas.messages import LogLevel, LogRecord
from schemas.topics import LOG, key
from shared.runtime.attachment import Attachment
from shared.runtime.taps import Tapped


def main() -> None:
    recorder = Recorder(Path(sys.argv[1]))
    number, turn = 0, threading.Event()
    while True:
        payload = encode(LogRecord(number, "camera", "main", LogLevel.INFO, "small and slow"))
        recorder.put(Tapped(LOG, key("lab", LOG, agent="camera"), payload, Attachment(1, number, number, 0.0)))
        print(number, flush=True)
        number += 1
        turn.wait(0.02)


main()
