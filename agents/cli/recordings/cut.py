"""`suturegrasp cut`: a shorter recording out of a longer one."""

import math

from agents.cli.places import check_new
from agents.cli.recordings.options import Cut
from agents.cli.whole_file import whole_file
from agents.launch.process import EXIT_DAMAGED, EXIT_OK
from agents.recorder.cutting import cut
from agents.replay.contents import window_ns
from shared.recording.completeness import no_message_in
from shared.recording.entry import Entry
from shared.recording.mcap_file import UntilDamage
from shared.terminal import UsageError, say, warn

LARGEST_DELAY_MS = 60_000.0


def run(options: Cut) -> int:
    """Cut, and say what the new file holds; the exit status."""
    check_new(options.output)
    delays_ms = _delays_ms(options.delay)
    # what is repeated from before the file began is older than its first moment
    records = UntilDamage(options.recording)
    own = [(one.at_ns, one.received_ns) for one in records if isinstance(one, Entry) and not one.repeated]
    if not own:
        raise UsageError(no_message_in(options.recording, records.damage))
    stretch = window_ns(options.begin, options.end, own[0][1], own[-1][1], own[0][0])
    with whole_file(options.output) as unfinished:
        report = cut(options.recording, unfinished, *stretch, only_used_frames=options.used, delays_ms=delays_ms)
    if unknown := sorted(set(delays_ms) - report.moved):
        warn(f"{options.recording} holds no state of {', '.join(unknown)} in that stretch, so nothing of it was moved")
    for doubt in report.source.doubts_of(report.damage):
        warn(doubt if doubt == report.damage else f"{options.recording}: {doubt}")
    unused = f", without {report.unused} frames of which nothing in it was made" if report.unused else ""
    size = options.output.stat().st_size / 1e6
    say(f"{options.output}: {report.kept} messages of {(stretch[1] - stretch[0]) * 1e-9:.1f} s, {size:.1f} MB{unused}")
    return EXIT_DAMAGED if report.damage else EXIT_OK


def _delays_ms(told: tuple[str, ...]) -> dict[str, float]:
    """By arm, of what is written as `psm1=120`."""
    delays_ms: dict[str, float] = {}
    for written in told:
        arm, _, ms = written.partition("=")
        if arm in delays_ms:
            raise UsageError(f"--delay of {arm} is given twice")
        try:
            delays_ms[arm] = float(ms)
        except ValueError:
            delays_ms[arm] = math.nan
        if not arm or not abs(delays_ms[arm]) <= LARGEST_DELAY_MS:
            most = f"{LARGEST_DELAY_MS:.0f} ms at most"
            raise UsageError(f"--delay {written!r} is no arm with milliseconds, such as psm1=120, {most}")
    return delays_ms
