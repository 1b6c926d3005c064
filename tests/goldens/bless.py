"""`make bless`: what perception, reconstruction and planner make of the golden recordings now is right from now on.

Images, goals and states of the arm stay as they are. What is about to change is said first; look at it, and at what
`suturegrasp replay tests/goldens/NAME.mcap --through perception,reconstruction,planner --output diff.rrd` shows.
"""

from pathlib import Path

from agents.cli.recordings.options import Recompute
from agents.cli.recordings.recompute import replayed, write_recording
from agents.cli.recordings.recompute_report import report
from agents.cli.whole_file import whole_file
from shared.recording.mcap_file import Note, read_attachments, read_with_notes

GOLDENS = Path(__file__).parent
THROUGH = "perception,reconstruction,planner"


def blessed(path):
    """Renew one recording; what differed from it, in lines."""
    result = replayed(Recompute(path, through=THROUGH, tolerances="none"))
    if not result.comparison.is_same:
        notes = tuple(record for record in read_with_notes(path) if isinstance(record, Note))
        attachments = read_attachments(path)
        with whole_file(path) as unfinished:
            write_recording(unfinished, result.after, notes, attachments)
    return list(report(result))


def main():
    for path in sorted(GOLDENS.glob("*.mcap")):
        print(f"{path.name}:")
        print("\n".join(f"  {line}" for line in blessed(path)))


if __name__ == "__main__":
    main()
