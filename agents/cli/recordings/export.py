"""`suturegrasp export`: a recording becomes tables for other programs."""

from pathlib import Path

from agents.cli.recordings.options import Export
from agents.launch.process import EXIT_DAMAGED, EXIT_OK, EXIT_UNUSABLE
from agents.session_report.export import FORMATS, export
from shared.recording.entry import RecordingError
from shared.terminal import complain, say, warn

FEWEST_POINTS, MOST_POINTS = 2, 10_000


def run(options: Export) -> int:
    """Write the tables, and say what they hold."""
    if refusal := _refused(options):
        return complain(refusal, EXIT_UNUSABLE)
    new = not options.output.exists()
    try:
        if not options.recording.is_file():
            return complain(f"{options.recording} is no file; give a recording", EXIT_UNUSABLE)
        options.output.mkdir(parents=True, exist_ok=True)
        exported = export(options.recording, options.output, options.format, options.points)
    except RecordingError as error:
        _empty(options.output, new)
        return complain(str(error), EXIT_UNUSABLE)
    except KeyboardInterrupt:
        # tables that were cut short look whole
        _empty(options.output, new)
        raise
    except OSError as error:
        return complain(f"{error.filename or options.output}: {error.strerror or error}", EXIT_UNUSABLE)
    told = ", ".join(f"{count} rows of {name}" for name, count in exported.rows.items())
    say(f"{options.output}: {told or 'nothing to export'}; README.txt says what they mean")
    # damage is told at the end
    for doubt in () if exported.said is None else exported.said.doubts_of(exported.damage):
        if doubt != exported.damage:
            warn(f"{options.recording}: {doubt}")
    if exported.unreadable:
        warn(f"{exported.unreadable} messages cannot be read by this version, and are left out")
    if exported.other_units:
        warn(f"{exported.other_units} curves are in another unit than those before, and are left out")
    if exported.damage:
        return complain(exported.damage, EXIT_DAMAGED)
    return EXIT_OK


def _empty(folder: Path, remove: bool) -> None:
    """Take away what was written into a folder that was new or empty."""
    for table in folder.iterdir():
        table.unlink()
    if remove:
        folder.rmdir()


def _refused(options: Export) -> str:
    """Why this cannot be carried out; empty where it can."""
    if options.format not in FORMATS:
        return f"--format {options.format} is unknown; choose from {', '.join(FORMATS)}"
    if not FEWEST_POINTS <= options.points <= MOST_POINTS:
        return f"--points {options.points} must lie within {FEWEST_POINTS} and {MOST_POINTS}"
    return _not_empty(options.output)


def _not_empty(folder: Path) -> str:
    if folder.exists() and not folder.is_dir():
        return f"--output {folder} is a file; give a folder that is new or empty"
    if folder.is_dir() and any(folder.iterdir()):
        return f"--output {folder} holds something already; give a folder that is new or empty"
    return ""
