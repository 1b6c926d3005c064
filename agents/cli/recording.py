"""`suturegrasp record`: every recorded topic of a rig becomes a file, until stopped."""

import contextlib
import threading
from pathlib import Path

from agents.cli.process import EXIT_OK, EXIT_UNUSABLE, on_stop
from agents.cli.rig import RigConfig
from agents.cli.terminal import complain, say
from agents.recorder.recorder import Recorder, RecordingReport
from schemas.topics import TOPICS
from shared.runtime.connection import NoRouterError, connected


def record(rig: RigConfig, path: Path) -> int:
    """Record until stopped, then say what the recording holds and what it lacks."""
    if path.exists():
        return complain(f"{path} exists already; give another name", EXIT_UNUSABLE)
    stopped = threading.Event()
    on_stop(stopped.set)
    try:
        recorder = Recorder(path)
    except OSError as error:
        return complain(f"{path} cannot be written: {error.strerror or error}", EXIT_UNUSABLE)
    with contextlib.suppress(NoRouterError), connected(rig.session, None, stopped) as connection:
        connection.listen(tuple(topic for topic in TOPICS if topic.recorded), recorder.put, recorder.missed)
        stopped.wait()
    say(recording_sentence(recorder.close()))
    return EXIT_OK


def recording_sentence(report: RecordingReport) -> str:
    """What a recording holds and lacks, in one line."""
    total = sum(report.received.values())
    if report.complete:
        return f"{report.path}: {total} messages on {len(report.received)} keys, complete"
    gaps = ", ".join(f"{count} of {key}" for key, count in sorted(report.lost.items()))
    unnumbered = f"; {report.unnumbered} came without a number" if report.unnumbered else ""
    fault = f"; {report.fault}" if report.fault else ""
    held = f"{report.path}: {total} messages on {len(report.received)} keys"
    return f"{held}, not complete: lost {gaps or 'none'}{unnumbered}{fault}"
