"""A recording, read once from front to back; images are looked at and not kept, so its length does not matter."""

import contextlib
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from agents.session_report.accounts import AccountCollector, AgentAccount, Remark
from agents.session_report.contents import ContentsCollector, KeyContents, without_left_out
from agents.session_report.facts import (
    Setting,
    SettingCollector,
    attached_facts,
    facts_of_messages,
    noted_facts,
    setting_facts,
)
from agents.session_report.grasps import Grasp, GraspCollector, OtherCommand
from agents.session_report.pulls import PullCollector, Pulled
from agents.session_report.stages import StageTimes, captured_ns, in_order, stage_of
from agents.session_report.threads import ThreadQuality
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import SimulatorState, StereoCalibration
from schemas.topics import (
    CALIBRATION,
    CONFIGURATION,
    FRAMES,
    HEALTH,
    LOG,
    OBSERVATIONS,
    SIMULATOR_STATE,
    THREAD,
    Topic,
    known_topic,
)
from shared.recording.completeness import Completeness, completeness_of
from shared.recording.derivation import MADE_NO_MORE
from shared.recording.entry import Entry, Note, RecordingError
from shared.recording.mcap_file import UntilDamage, is_finished, read_attachments


@dataclass(frozen=True)
class Session:
    """What a recording tells.

    Fields:
        damage: what broke the reading off; empty where all was read.
        start_ns: when the first message was published; where that had been kept for later, when it was received.
        said: what the file itself says of what it was made of, and of what it lacks.
    """

    path: Path
    size_bytes: int
    damage: str
    notes: tuple[Note, ...]
    said: Completeness
    contents: tuple[KeyContents, ...]
    stages: dict[str, StageTimes]
    agents: tuple[AgentAccount, ...]
    remarks: tuple[Remark, ...]
    grasps: tuple[Grasp, ...]
    pulls: tuple[Pulled, ...]
    other_commands: tuple[OtherCommand, ...]
    settings: tuple[Setting, ...]
    quality: ThreadQuality
    facts: dict[str, str]
    start_ns: int

    @property
    def end_ns(self) -> int:
        """When the last message was published."""
        return max((one.last_ns for one in self.contents), default=0)

    @property
    def duration_s(self) -> float:
        """From the first message received until the last one was published."""
        return (self.end_ns - self.start_ns) * 1e-9

    def since_start_s(self, at_ns: int) -> float:
        """A time as seconds from the first message."""
        return (at_ns - self.start_ns) * 1e-9

    def clock(self, at_ns: int) -> str:
        """A time by the clock on the wall, where this is read."""
        return datetime.fromtimestamp(at_ns * 1e-9, UTC).astimezone().strftime("%H:%M:%S")


class _Reading:
    def __init__(self) -> None:
        self.contents, self.accounts = ContentsCollector(), AccountCollector()
        self.grasps, self.pulls = GraspCollector(), PullCollector()
        self.settings = SettingCollector()
        self.stages: dict[str, StageTimes] = {}
        self.quality = ThreadQuality()
        self.notes: list[Note] = []
        self.calibration: StereoCalibration | None = None
        self.scene: SimulatorState | None = None
        self.last_ns: int | None = None
        self.begin_ns = 0

    def add(self, entry: Entry) -> None:
        self.last_ns = entry.received_ns
        if entry.repeated:
            self._add_repeated(entry)
            return
        if not self.begin_ns:
            self.begin_ns = entry.at_ns
        self.contents.add(entry)
        topic = known_topic(entry.key)
        if topic is None:
            self.contents.refuse(entry, "this version has no such topic")
            return
        try:
            message = decode(topic.message, entry.payload)
            self._add_message(entry, topic, message)
        except MessageError as error:
            self.contents.refuse(entry, str(error))

    def _add_repeated(self, entry: Entry) -> None:
        """Take what held before the file began, and counts in the part before it."""
        with contextlib.suppress(MessageError):
            topic = known_topic(entry.key)
            if topic is not None and topic in (CALIBRATION, CONFIGURATION, SIMULATOR_STATE, *PullCollector.topics):
                self._add_message(entry, topic, decode(topic.message, entry.payload), before=True)

    def _add_message(self, entry: Entry, topic: Topic, message: Any, before: bool = False) -> None:
        if not before and (stage := stage_of(topic, entry.key.split("/")[3])):
            self.stages.setdefault(stage, StageTimes()).add(captured_ns(message), entry.published_ns)
        if topic in SettingCollector.topics:
            self.settings.add(entry.key, message)
        if topic is HEALTH:
            self.accounts.add_health(entry.epoch, message, entry.sequence == 0)
        elif topic is LOG:
            self.accounts.add_log(message)
        elif topic in (OBSERVATIONS, THREAD):
            self.quality.add(str(topic), message)
        elif topic is CALIBRATION:
            self.calibration = message
        elif topic is SIMULATOR_STATE:
            self.scene = message
        elif topic in PullCollector.topics and not self.pulls.take(entry.published_ns, message):
            self.grasps.add(entry.published_ns, message, before)


def read_session(path: Path) -> Session:
    """All that a recording tells, as far as it can be read.

    Raises:
        RecordingError: where the file is no recording at all.
        OSError: where it cannot be opened.
    """
    reading, recording = _Reading(), UntilDamage(path)
    for item in recording:
        if isinstance(item, Note):
            reading.notes.append(item)
        else:
            reading.add(item)
    return _session(path, reading, recording.damage)


def _session(path: Path, reading: _Reading, damage: str) -> Session:
    said = completeness_of(reading.notes, is_finished(path), reading.last_ns)
    agents, contents = reading.accounts.agents(), reading.contents.contents()
    facts = facts_of_messages(reading.calibration, reading.scene, agents, reading.quality)
    return Session(
        path=path,
        size_bytes=path.stat().st_size,
        damage=damage,
        notes=tuple(reading.notes),
        said=said,
        contents=without_left_out(contents, said.lost, _left_out_under(contents, said)),
        stages={name: reading.stages[name] for name in sorted(reading.stages, key=in_order)},
        agents=agents,
        remarks=reading.accounts.remarks(),
        grasps=tuple(sorted(reading.grasps.grasps, key=lambda grasp: grasp.at_ns)),
        pulls=reading.pulls.pulls,
        other_commands=tuple(reading.grasps.others),
        settings=tuple(reading.settings.settings),
        quality=reading.quality,
        # what was in force first: of the rest there is much
        facts=_attached(path) | setting_facts(reading.settings.settings) | noted_facts(reading.notes) | facts,
        start_ns=reading.begin_ns,
    )


def _attached(path: Path) -> dict[str, str]:
    """Facts from the files that are attached; none where they cannot be read."""
    try:
        return attached_facts(read_attachments(path))
    except (RecordingError, OSError):
        return {}


def _left_out_under(contents: Iterable[KeyContents], said: Completeness) -> set[str]:
    """The keys of which messages were left out on purpose."""
    keys = {one.key for one in contents if one.topic == str(FRAMES) and said.lacks_frames_on_purpose}
    replayed = (one for one in said.derived if MADE_NO_MORE in one.left_out)
    return keys | {key for one in replayed for anew in one.agents.values() for key in anew.keys}
