"""What every file of a recording begins with, so that each can be read by itself."""

from dataclasses import dataclass, field

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import AgentHealth, StereoCalibration
from schemas.topics import CALIBRATION, EXECUTION, HEALTH, PLAN, ROBOT_STATE, SIMULATOR_STATE, Topic
from shared.calibration.own_file import calibration_text
from shared.calibration.stated import CalibrationError
from shared.recording.entry import Entry, Note

REPEATED = (CALIBRATION, ROBOT_STATE, SIMULATOR_STATE, PLAN, EXECUTION)
"""Of these the newest message of each key is repeated: without it, what follows cannot be understood."""
CALIBRATION_FILE = "calibration.json"
AGENT = "agent"
"""A note of each agent that is heard of: its host, version and configuration."""


@dataclass(frozen=True)
class Attached:
    """A file that belongs to a recording."""

    name: str
    media_type: str
    data: bytes


@dataclass
class Head:
    """Notes and attachments by what they are about, and the newest messages of what lasts."""

    notes: dict[str, Note] = field(default_factory=dict[str, Note])
    attached: dict[str, Attached] = field(default_factory=dict[str, Attached])
    entries: dict[str, tuple[Topic, Entry]] = field(default_factory=dict[str, tuple[Topic, Entry]])

    def copy(self) -> "Head":
        """One that goes its own way from here."""
        return Head(dict(self.notes), dict(self.attached), dict(self.entries))

    def follow(self, topic: Topic, entry: Entry) -> Note | Attached | None:
        """Remember a message; what it adds to a file that has begun."""
        if topic in REPEATED:
            self.entries[entry.key] = (topic, entry)
        if topic is CALIBRATION:
            return self._attach_calibration(entry)
        if topic is HEALTH and f"{entry.key} {entry.epoch}" not in self.notes:
            return self._note_agent(entry)
        return None

    def _attach_calibration(self, entry: Entry) -> Attached | None:
        try:
            text = calibration_text(decode(StereoCalibration, entry.payload), entry.key)
        except (MessageError, CalibrationError):
            return None
        attached = Attached(CALIBRATION_FILE, "application/json", text.encode())
        self.attached[CALIBRATION_FILE] = attached
        return attached

    def _note_agent(self, entry: Entry) -> Note | None:
        try:
            health = decode(AgentHealth, entry.payload)
        except MessageError:
            return None
        facts = {name: str(getattr(health, name)) for name in ("agent", "instance", "host", "version", "config_hash")}
        note = Note(AGENT, {**facts, "epoch": str(entry.epoch), "key": entry.key})
        self.notes[f"{entry.key} {entry.epoch}"] = note
        return note
