"""A process that records messages of its own until it is killed; it may be told a stretch of numbers to leave out."""

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
    left_out = range(*(int(number) for number in sys.argv[2:] or ("0", "0")))
    number, turn = 0, threading.Event()
    while True:
        if number not in left_out:
            payload = encode(LogRecord(number, "camera", "main", LogLevel.INFO, "small and slow"))
            recorder.put(Tapped(LOG, key("lab", LOG, agent="camera"), payload, Attachment(1, number, number, 0.0)))
        print(number, flush=True)
        number += 1
        turn.wait(0.02)


main()
