"""The recording as the operator's page shows it: the rig's own recorder, or one that the page begins and ends."""

import contextlib
import threading
from pathlib import Path
from typing import Any

from agents.cli.live.up import NO_RECORDER, RECORDER, start_recorder
from agents.configuration.rig import RigConfig
from agents.launch.session_folder import new_session_folder
from agents.launch.supervisor import Supervisor, last_line
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import AgentHealth, LogLevel, LogRecord
from schemas.topics import HEALTH, LOG
from shared.clock import monotonic_s
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped

SILENT_S = 3.5


class RigRecording:
    """What records this rig."""

    def __init__(self, rig: RigConfig, connection: Connection) -> None:
        self._rig, self._lock = rig, threading.Lock()
        self._heard_s, self._fault, self._losses = float("-inf"), "", list[str]()
        self._ended_s = float("-inf")
        self._own: tuple[Supervisor, Path] | None = None
        self._ended = ""
        connection.listen((HEALTH, LOG), self._take)

    def told(self) -> dict[str, Any]:
        """Whether anything records and lacks something, whether the page may change that, and all that in words."""
        with self._lock:
            heard, own = monotonic_s() - self._heard_s < SILENT_S, self._own
            lost = self._fault or "; ".join(self._losses[-2:])
        lacks = lost or "nothing is known to be lost"
        if own is not None:
            gone = next(iter(own[0].watch()), None)
            text = f"recording into {own[1]}: {lacks}" if gone is None else f"the recorder ended: {gone.sentence}"
            return {"on": True, "can": True, "text": text, "lacks": bool(lost or gone)}
        if heard:
            text = f"the rig's own recorder keeps this session: {lacks}"
            return {"on": True, "can": False, "text": text, "lacks": bool(lost)}
        return {"on": False, "can": True, "text": self._ended or "nothing is recorded", "lacks": False}

    def set(self, on: bool) -> str:
        """Begin or end a recording of one's own; why not, or nothing."""
        told = self.told()
        if not told["can"]:
            return "The rig's own recorder keeps this session; it ends with the rig."
        if on == told["on"]:
            return ""
        try:
            return self._begin() if on else self._end()
        except OSError as error:
            return f"Nothing is recorded: {error.strerror or error}."

    def close(self) -> None:
        """End a recording that the page began."""
        if self._own is not None:
            self._end()

    def _begin(self) -> str:
        folder, supervisor = new_session_folder(self._rig.sessions), Supervisor(restart=False)
        if not start_recorder(supervisor, self._rig, folder):
            folder.path.rmdir()
            return f"{NO_RECORDER[:1].upper()}{NO_RECORDER[1:]}."
        with self._lock:
            self._own, self._losses, self._log = (supervisor, folder.recording), [], folder.log(RECORDER)
        return ""

    def _end(self) -> str:
        with self._lock:
            own, self._own = self._own, None
        if own is not None:
            own[0].stop()
            with self._lock:
                self._ended, self._ended_s, self._heard_s = last_line(self._log), monotonic_s(), float("-inf")
        return ""

    def _take(self, tapped: Tapped) -> None:
        if tapped.key.split("/")[2] != RECORDER:
            return
        with contextlib.suppress(MessageError), self._lock:
            if tapped.topic is HEALTH and monotonic_s() - self._ended_s < SILENT_S:
                return  # what one's own recorder still said
            if tapped.topic is HEALTH:
                self._heard_s, self._fault = monotonic_s(), decode(AgentHealth, tapped.payload).fault
                return
            record = decode(LogRecord, tapped.payload)
            if record.level in (LogLevel.WARNING, LogLevel.ERROR):
                self._losses.append(record.text.split("\n")[0])
