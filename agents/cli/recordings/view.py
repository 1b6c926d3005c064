"""`suturegrasp view`: a rig that runs, until stopped, or a recording, from its beginning to its end."""

import contextlib
import logging
import sys
import threading
from itertools import takewhile
from pathlib import Path

from agents.cli.live.options import View
from agents.cli.places import check_new
from agents.configuration.rig import RigConfig
from agents.launch.host_facts import telling, told_without
from agents.launch.process import EXIT_DAMAGED, EXIT_GAVE_UP, EXIT_OK, EXIT_UNUSABLE, ONLOOKER, step_back, stopping
from agents.launch.session_folder import free_path
from agents.replay.contents import moment_ns
from agents.viewer.live import LiveViewer, ViewerReport
from agents.viewer.recorded import RecordedViewer
from agents.viewer.sinks import CLOSED_AT_ONCE, INSTEAD
from schemas.topics import TOPICS
from shared.clock import monotonic_s
from shared.recording.completeness import completeness
from shared.recording.derivation import derivations
from shared.recording.mcap_file import Note, RecordingError, UntilDamage, is_finished, read_recording
from shared.recording.stretch import stretch
from shared.runtime.connection import NoRouterError, connected
from shared.runtime.process import serving
from shared.terminal import UsageError, complain, say, show

LOGGER = logging.getLogger("suturegrasp.viewer")
PROGRESS_S = 5.0
"""How often a line tells how far it has come; on a terminal, one line is kept up to date."""
LOOK_S = 0.1
NO_FILE = "--show file needs a file: give --output NAME.rrd"


def view(rig: RigConfig, options: View) -> int:
    """Show a recording, where one is named, or else the rig; the exit status."""
    output = free_path(options.output) if options.numbered and options.output else options.output
    stopped = stopping()
    if output is not None:
        check_new(output)
    if options.recording is not None:
        return _view_recording(options, options.recording, output, stopped)
    for name, given in (("--from", options.from_), ("--to", options.to)):
        if given is not None:
            raise UsageError(f"{name} cuts a recording, and none is named")
    if options.show == "file" and output is None:
        raise UsageError(NO_FILE)
    return _view_rig(rig, output, options, stopped)


def _view_rig(rig: RigConfig, output: Path | None, options: View, stopped: threading.Event) -> int:
    """Show the rig until stopped, then say what was shown and what was dropped."""
    step_back(ONLOOKER)
    # sessions that are opened together stay apart by the folder that each is in
    session_id = f"{rig.rig} {output.resolve().parent.name}" if output is not None else rig.rig
    viewer = LiveViewer(output, options.show or "native", session_id, options.layout)
    for note in viewer.notes:
        say(note)
    session = rig.session_of("viewer")
    with (
        contextlib.suppress(NoRouterError),
        told_without(session, "nothing is shown") as met,
        connected(session, None, stopped) as connection,
    ):
        met()
        connection.listen(TOPICS, viewer.put)
        with telling(connection, rig, "viewer", LOGGER), serving():
            stopped.wait()
    say(report_sentence(viewer.close()))
    return EXIT_OK


def _view_recording(options: View, recording: Path, output: Path | None, stopped: threading.Event) -> int:
    """Show a recording as fast as it goes, then say what was shown and what could not be read."""
    began_s = monotonic_s()
    if _show(options, output) == "file" and output is None:
        raise UsageError(NO_FILE)
    size = recording.stat().st_size
    # what is no recording is told before a window opens
    from_ns, to_ns = _moments(options, recording)
    told = _told_before(recording)
    layout, session_id = options.layout, str(recording.resolve())
    viewer = RecordedViewer(output, _show(options, output), session_id, layout, options.thin, told)
    for note in (*viewer.notes, *told):
        say(note)
    viewer.show(stretch(read_recording(recording), from_ns, to_ns))
    _follow(viewer, size, began_s, stopped)
    cut_short = "" if viewer.finished.is_set() else "the window was closed" if viewer.window_closed else "stopped"
    if viewer.served and not cut_short:
        say("all of it is on the page, which is served until Ctrl-C")
        stopped.wait()
    report = viewer.close()
    for line in (*report.notes[len(viewer.notes) :], *_not_read(viewer, report)):
        say(line)
    took = f"; it took {monotonic_s() - began_s:.1f} s"
    say(report_sentence(report) + took + (f", and was cut short: {cut_short}" if cut_short else ""))
    if viewer.window_failed:
        return complain(f"{CLOSED_AT_ONCE}{INSTEAD}", EXIT_UNUSABLE)
    if viewer.error is not None:
        damaged = isinstance(viewer.error, RecordingError)
        return complain(_told(viewer.error, recording), EXIT_DAMAGED if damaged else EXIT_GAVE_UP)
    return EXIT_OK


def _moments(options: View, recording: Path) -> tuple[int | None, int | None]:
    """Where to begin and to end.

    Raises:
        RecordingError, OSError: where there is no recording.
        WindowError: where either is no moment.
    """
    first = next((entry for entry in read_recording(recording) if not entry.repeated), None)
    begin_ns = 0 if first is None else first.at_ns
    from_ns, to_ns = (
        None if written is None else moment_ns(option, written, begin_ns)
        for option, written in (("--from", options.from_), ("--to", options.to))
    )
    return from_ns, to_ns


def _told_before(recording: Path) -> list[str]:
    """What a recording was made of and lacks; of one that was cut off as far as its beginning tells."""
    if not is_finished(recording):
        notes = takewhile(lambda record: isinstance(record, Note), UntilDamage(recording))
        made_of = derivations(note for note in notes if isinstance(note, Note))
        return [
            *(one.sentence for one in made_of),
            "cut off, or still being written: whether anything came after is not known",
        ]
    said = completeness(recording)
    # the damage that a file may have is met when it is read
    by_itself = f"by its own account {said.sentence}" if said.complete else said.sentence
    return [*(one.sentence for one in said.derived), by_itself]


def report_sentence(report: ViewerReport) -> str:
    """What a viewer showed and left out, in one line."""
    counts = {
        "shown": report.shown,
        "thinned": report.thinned,
        "dropped": report.dropped,
        "unreadable": report.unreadable,
    }
    told = ", ".join(f"{name} {sum(count.values())}" for name, count in counts.items())
    return f"messages {told}{f': {report.path}' if report.path else ''}"


def _show(options: View, output: Path | None) -> str:
    """Where a recording is shown: in a window, unless it is to be written to a file."""
    return options.show or ("native" if output is None else "file")


def _not_read(viewer: RecordedViewer, report: ViewerReport) -> list[str]:
    """A line for every kind of message that is not in the view though it is in the recording."""
    unreadable = [f"{count} of {topic} could not be read" for topic, count in sorted(report.unreadable.items())]
    unknown = [f"{count} under {key}, a key that this version does not know" for key, count in viewer.unknown.items()]
    return [f"not shown: {line}" for line in (*unreadable, *unknown)]


def _told(error: Exception, recording: Path) -> str:
    if isinstance(error, OSError):
        return f"{error.filename or recording} cannot be read or written: {error.strerror or error}"
    return str(error)


def _follow(viewer: RecordedViewer, size: int, began_s: float, stopped: threading.Event) -> None:
    """Tell how far a recording of so many bytes was read, until all is shown, or nobody looks any more.

    Images hardly shrink in a file, so payloads tell how much of it was read.
    """
    on_terminal, told_s, pictured, over = sys.stdout.isatty(), 0.0, False, False
    while not over:
        over = viewer.finished.wait(LOOK_S) or stopped.is_set() or viewer.window_closed
        took_s = monotonic_s() - began_s
        if viewer.first_picture.is_set() and not pictured:
            pictured = True
            _line(f"the first picture came after {took_s:.1f} s", "\n")
        if not over and (on_terminal or took_s - told_s > PROGRESS_S):
            told_s, share = took_s, min(0.99, viewer.showed / max(size, 1))
            _line(f"about {share:.0%} read, {1e-6 * viewer.showed:.0f} MB in {took_s:.0f} s", "")
    if on_terminal:
        show("")


def _line(text: str, end: str) -> None:
    """Say it; on a terminal in place of the line before."""
    if sys.stdout.isatty():
        print(f"\r\x1b[K{text}", end=end, flush=True)
    else:
        say(text)
