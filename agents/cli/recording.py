"""`suturegrasp record`: every recorded topic of a rig becomes a file, until stopped."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable

from agents.cli.live_options import Record
from agents.cli.process import EXIT_OK, EXIT_UNUSABLE, on_stop
from agents.cli.recording_facts import STUDY_FACTS, attached_to, clocks_note, notes_of
from agents.cli.rig import RecorderSection, RigConfig
from agents.cli.session_folder import free_path
from agents.cli.supervisor import SUPERVISED
from agents.cli.terminal import complain, say
from agents.recorder.disk import DiskGuard
from agents.recorder.parts import FileSettings
from agents.recorder.pre_trigger import PreTriggerSettings
from agents.recorder.recorder import Recorder, RecorderSettings, RecordingReport
from schemas.topics import TOPICS, Topic
from shared.runtime.config import parse_config
from shared.runtime.connection import Connection, NoRouterError, connected

FIRST_CLOCKS_S, CLOCKS_EVERY_S = 3.0, 60.0
MB = 1_000_000
ASKED = "asked"
"""The event that a person makes, by Enter or SIGUSR1."""


def record(rig: RigConfig, options: Record) -> int:
    """Record until stopped, then say what the recording holds and what it lacks."""
    path = free_path(options.output) if options.numbered else options.output
    section = section_of(rig, options)
    settings = settings_of(section)
    if path.exists():
        return complain(f"{path} exists already; give another name", EXIT_UNUSABLE)
    if problem := DiskGuard(path.parent, settings.keep_free_bytes).problem():
        return complain(f"nothing is recorded: {problem}", EXIT_UNUSABLE)
    stopped = threading.Event()
    asks_at_terminal = settings.pre_trigger is not None and SUPERVISED not in os.environ and sys.stdin.isatty()
    on_stop(stopped.set)
    try:
        recorder = Recorder(path, settings=settings, notes=notes_of(rig, section), attached=attached_to(rig), tell=say)
    except OSError as error:
        return complain(f"{path} cannot be written: {error.strerror or error}", EXIT_UNUSABLE)
    signal.signal(signal.SIGUSR1, lambda *_: recorder.trigger(ASKED))
    if asks_at_terminal:
        say("Enter keeps the last seconds")
        threading.Thread(target=_ask_at_terminal, args=(recorder,), name="keys", daemon=True).start()
    _stop_when(recorder.ended, stopped.set)
    with contextlib.suppress(NoRouterError), connected(rig.session_of("recorder"), None, stopped) as connection:
        connection.listen(recorded_topics(rig), recorder.put, recorder.missed)
        _note_clocks(connection, recorder, stopped)
    report = recorder.close()
    say(recording_sentence(report))
    return EXIT_UNUSABLE if report.fault else EXIT_OK


def recorded_topics(rig: RigConfig) -> tuple[Topic, ...]:
    """What is recorded: what the table says, unless the rig says otherwise."""
    told = {name: section.recorded for name, section in rig.topics.items()}
    return tuple(topic for topic in TOPICS if told.get(str(topic), topic.recorded))


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
    held = f"{first}{files}: {total} messages on {len(report.received)} keys"
    if not report.paths and not report.fault:
        return f"no event came, and nothing was kept in {report.path}"
    if report.complete:
        return f"{held}, complete"
    gaps = ", ".join(f"{count} of {key}" for key, count in sorted(report.lost.items()))
    unnumbered = f"; {report.unnumbered} came without a number" if report.unnumbered else ""
    fault = f"; {report.fault}" if report.fault else ""
    return f"{held}, not complete: lost {gaps or 'none'}{unnumbered}{fault}"


def _note_clocks(connection: Connection, recorder: Recorder, stopped: threading.Event) -> None:
    """Until stopped, ask the hosts' clocks from time to time."""
    wait_s = FIRST_CLOCKS_S
    while not stopped.wait(wait_s):
        recorder.note(clocks_note(connection.clocks()))
        wait_s = CLOCKS_EVERY_S


def _stop_when(ended: threading.Event, stop: Callable[[], None]) -> None:
    def wait() -> None:
        ended.wait()
        stop()

    threading.Thread(target=wait, name="ended", daemon=True).start()


def _ask_at_terminal(recorder: Recorder) -> None:
    for _ in sys.stdin:
        recorder.trigger(ASKED)
