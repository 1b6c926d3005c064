"""`suturegrasp export`: a recording becomes tables for other programs."""

from pathlib import Path

from agents.cli.places import check_folder
from agents.cli.recordings.options import Export
from agents.launch.process import EXIT_DAMAGED, EXIT_OK
from agents.session_report.export import export
from shared.recording.entry import RecordingError
from shared.terminal import UsageError, complain, say, warn

FEWEST_POINTS, MOST_POINTS = 2, 10_000


def run(options: Export) -> int:
    """Write the tables, and say what they hold."""
    if not FEWEST_POINTS <= options.points <= MOST_POINTS:
        raise UsageError(f"--points {options.points} must lie within {FEWEST_POINTS} and {MOST_POINTS}")
    check_folder("--output", options.output)
    if not options.recording.is_file():
        raise UsageError(f"{options.recording} is no file; give a recording")
    new = not options.output.exists()
    options.output.mkdir(parents=True, exist_ok=True)
    try:
        exported = export(options.recording, options.output, options.format, options.points)
    except (RecordingError, KeyboardInterrupt):
        # tables that were cut short look whole
        _empty(options.output, new)
        raise
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
