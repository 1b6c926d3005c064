"""`suturegrasp record`: every recorded topic of a rig becomes a file, until stopped."""

import glob
import logging
import os
import shutil
import signal
import sys
import threading
from pathlib import Path

from agents.cli.live.options import Record
from agents.cli.places import check_new
from agents.cli.recordings.facts import STUDY_FACTS, attached_to, clocks_note, notes_of
from agents.cli.recordings.one_after_another import Recordings
from agents.configuration.hosts import kind_and_instance
from agents.configuration.rig import RecorderSection, RigConfig
from agents.launch.host_facts import telling, told_without
from agents.launch.process import EXIT_OK, EXIT_UNUSABLE, stopping
from agents.launch.session_folder import free_path
from agents.launch.supervisor import SUPERVISED
from agents.recorder.intake import DiskGuard
from agents.recorder.parts import FileSettings
from agents.recorder.pre_trigger import PreTriggerSettings
from agents.recorder.recorder import Recorder, RecorderSettings, RecordingReport
from schemas.topics import MAIN, TOPICS, Topic, key_root
from shared.clock import monotonic_s
from shared.runtime.config import parse_config
from shared.runtime.connection import Connection, NoRouterError, connected
from shared.runtime.delivery import as_told
from shared.runtime.process import serving
from shared.terminal import complain, say, show

EVERY_S = 1.0
MB, GB = 1_000_000, 1e9
HOUR_S = 3600.0


def tell_progress(path: Path, stopped: threading.Event) -> None:
    """Keep a line on the terminal up to date until stopped."""
    began_s = monotonic_s()
    while not stopped.wait(EVERY_S):
        print(f"\r\x1b[K{sentence(path, monotonic_s() - began_s)}", end="", flush=True)
    show("")


def sentence(path: Path, seconds: float) -> str:
    """What the files of a recording hold after so long, and how long the disk has room for more."""
    parts = path.parent.glob(f"{glob.escape(path.stem)}_part*{path.suffix}")
    files = [file for file in (path, *parts) if file.is_file()]
    size, free = sum(file.stat().st_size for file in files), shutil.disk_usage(path.parent).free
    rate = size / seconds if seconds > 0 else 0.0
    room = f", room for {free / rate / HOUR_S:.1f} h of this" if rate > 0 else ""
    return f"recording {path}: {seconds:.0f} s, {size / MB:.1f} MB; {free / GB:.1f} GB free{room}; Ctrl-C ends it"


FIRST_CLOCKS_S, CLOCKS_EVERY_S = 3.0, 60.0
ROOM_EVERY_S = 1.0
KIND = "recorder"
LOGGER = logging.getLogger(f"suturegrasp.{KIND}")
LOGGER.setLevel(logging.INFO)
# what is told is printed in sentences of its own
LOGGER.addHandler(logging.NullHandler())
ASKED = "asked"
"""The event that a person makes, by Enter or SIGUSR1."""


def record(rig: RigConfig, options: Record) -> int:
    """Record until stopped, then say what the recording holds and what it lacks."""
    path = free_path(options.output) if options.numbered else options.output
    section = section_of(rig, options)
    settings = settings_of(section)
    check_new(path)
    asks_at_terminal = settings.pre_trigger is not None and SUPERVISED not in os.environ and sys.stdin.isatty()
    stopped = stopping(for_sure=True)
    if problem := _no_room(DiskGuard(path.parent, settings.keep_free_bytes), stopped if options.numbered else None):
        return complain(problem, EXIT_UNUSABLE)

    def begun(path: Path) -> Recorder:
        return Recorder(path, settings=settings, notes=notes_of(rig, section), attached=attached_to(rig), tell=_tell)

    own = f"{key_root(rig.rig, kind_and_instance(KIND, rig.host or MAIN)[1], KIND)}/"
    recordings = Recordings(path, begun, DiskGuard(path.parent, settings.keep_free_bytes), LOGGER, own)
    signal.signal(signal.SIGUSR1, lambda *_: recordings.trigger(ASKED))
    if asks_at_terminal:
        say("Enter keeps the last seconds")
        threading.Thread(target=_ask_at_terminal, args=(recordings,), name="keys", daemon=True).start()
    if sys.stdout.isatty() and SUPERVISED not in os.environ:
        threading.Thread(target=tell_progress, args=(path, stopped), name="progress", daemon=True).start()
    session = rig.session_of("recorder")
    try:
        with (
            told_without(session, "nothing is recorded") as met,
            connected(session, None, stopped) as connection,
            serving(),
        ):
            met()
            _record_all(rig, connection, recordings, path.parent, stopped)
    except NoRouterError:
        for empty in recordings.close(lambda _: None).paths:
            empty.unlink(missing_ok=True)
        say(f"no router came, so nothing was recorded, and no {path.name} was kept")
    return EXIT_UNUSABLE if any(report.fault for report in recordings.reports) else EXIT_OK


def _no_room(disk: DiskGuard, waiting_until: threading.Event | None) -> str:
    """Why nothing can be recorded, empty where there is room; what a unit runs waits for it until it is stopped."""
    problem = disk.problem()
    if not problem or waiting_until is None:
        return problem and f"nothing is recorded: {problem}"
    complain(f"nothing is recorded until there is room: {problem}", EXIT_UNUSABLE)
    while not disk.has_room_again():
        if waiting_until.wait(ROOM_EVERY_S):
            return "it was stopped before there was room"
    return ""


def _record_all(
    rig: RigConfig, connection: Connection, recordings: Recordings, folder: Path, stopped: threading.Event
) -> None:
    """Until stopped; what is told of it is told on the rig too."""
    recording = (connection, recorded_topics(rig), stopped, lambda report: say(recording_sentence(report)))
    with telling(connection, rig, KIND, LOGGER, lambda: recordings.fault, writes_to=folder):
        thread = threading.Thread(target=recordings.run, args=recording, name="recordings")
        thread.start()
        _note_clocks(connection, recordings, stopped)
        thread.join()


def _tell(sentence: str) -> None:
    """Say it here and on the rig."""
    say(sentence)
    LOGGER.warning(sentence)


def recorded_topics(rig: RigConfig) -> tuple[Topic, ...]:
    """What is recorded: what the table says, unless the rig says otherwise."""
    return tuple(topic for topic in TOPICS if as_told(topic, rig.rows_otherwise).recorded)


def section_of(rig: RigConfig, options: Record) -> RecorderSection:
    """What the rig's configuration says, and the command line instead of it.

    Raises:
        ConfigError: where an option is none that the configuration may hold.
    """
    section = rig.recorder or RecorderSection()
    told = {
        "split_size_mb": options.split_size,
        "split_minutes": options.split_minutes,
        "pre_trigger_s": options.pre_trigger,
        "post_trigger_s": options.post_trigger,
        "keep_free_mb": options.keep_free,
        "foxglove": None if options.foxglove else False,
        **{name: getattr(options, name) for name in STUDY_FACTS},
    }
    changed = section.model_copy(update={name: value for name, value in told.items() if value is not None})
    return parse_config(changed.model_dump_json(exclude_none=True), RecorderSection, "recorder.json")


def settings_of(section: RecorderSection) -> RecorderSettings:
    """How the recorder is to record."""
    before_s, after_s = section.pre_trigger_s, section.post_trigger_s
    return RecorderSettings(
        FileSettings(
            None if section.split_size_mb is None else int(section.split_size_mb * MB),
            None if section.split_minutes is None else section.split_minutes * 60.0,
            section.foxglove,
        ),
        None if section.keep_free_mb is None else int(section.keep_free_mb * MB),
        None
        if before_s is None
        else PreTriggerSettings(
            before_s, before_s if after_s is None else after_s, int(section.pre_trigger_memory_mb * MB)
        ),
    )


def recording_sentence(report: RecordingReport) -> str:
    """What a recording holds and lacks, in one line."""
    total = sum(report.received.values())
    files = f" and {len(report.paths) - 1} more" if len(report.paths) > 1 else ""
    first = report.paths[0] if report.paths else report.path
    size = sum(path.stat().st_size for path in report.paths if path.exists()) / MB
    held = f"{first}{files}: {size:.1f} MB, {total} messages on {len(report.received)} keys"
    if not report.paths and not report.fault:
        return f"no event came, and nothing was kept in {report.path}"
    if report.complete and not total:
        return f"{held}: nothing was heard"
    if report.complete:
        return f"{held}, complete"
    gaps = ", ".join(f"{count} of {key}" for key, count in sorted(report.lost.items()))
    unnumbered = f"; {report.unnumbered} came without a number" if report.unnumbered else ""
    fault = f"; {report.fault}" if report.fault else ""
    return f"{held}, not complete: lost {gaps or 'none'}{unnumbered}{fault}"


def _note_clocks(connection: Connection, recordings: Recordings, stopped: threading.Event) -> None:
    """Until stopped, ask the hosts' clocks from time to time."""
    wait_s = FIRST_CLOCKS_S
    while not stopped.wait(wait_s):
        recordings.note(clocks_note(connection.clocks()))
        wait_s = CLOCKS_EVERY_S


def _ask_at_terminal(recordings: Recordings) -> None:
    for _ in sys.stdin:
        recordings.trigger(ASKED)
