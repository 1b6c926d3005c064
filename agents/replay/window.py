"""Which stretch of a recording is meant, in seconds from its start or by the clock on the wall."""

import re
from datetime import date, datetime, time

SECONDS = re.compile(r"\d+(\.\d*)?|\.\d+")
CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}(\.\d{1,6})?)?")


class WindowError(ValueError):
    """A stretch that makes no sense; the text says what to give instead."""


def moment_ns(option: str, written: str, begin_ns: int) -> int:
    """A moment as people write it: `12.5` seconds from the start, `14:30:05` on the day of the start, or a date too.

    Raises:
        WindowError: where it is none of these; the text names the option.
    """
    try:
        if SECONDS.fullmatch(written):
            return begin_ns + round(float(written) * 1e9)
        return _wall_ns(written, begin_ns)
    except (ValueError, OverflowError, OSError):
        examples = "seconds from the start (12.5), a time of its day (14:30:05), or both (2026-11-20T14:30:05)"
        raise WindowError(f"{option} {written!r} is no moment; give {examples}") from None


def _wall_ns(written: str, begin_ns: int) -> int:
    if CLOCK.fullmatch(written):
        day: date = datetime.fromtimestamp(begin_ns * 1e-9).astimezone().date()
        padded = written if written[1] != ":" else f"0{written}"
        moment = datetime.combine(day, time.fromisoformat(padded)).astimezone()
    else:
        moment = datetime.fromisoformat(written)
        moment = moment if moment.tzinfo is not None else moment.astimezone()
    return round(moment.timestamp() * 1e6) * 1000


def window_ns(
    begin: str | None, end: str | None, first_ns: int, last_ns: int, zero_ns: int | None = None
) -> tuple[int, int]:
    """Where to begin and to end in a recording from `first_ns` to `last_ns`, both moments included.

    Seconds are counted from `zero_ns`; from the first moment, if it is None.

    Raises:
        WindowError: where nothing of the recording lies between.
    """
    zero_ns = first_ns if zero_ns is None else zero_ns
    from_ns = first_ns if begin is None else moment_ns("--from", begin, zero_ns)
    to_ns = last_ns if end is None else moment_ns("--to", end, zero_ns)
    length_s = (last_ns - first_ns) * 1e-9
    if from_ns > last_ns:
        raise WindowError(f"--from {begin} lies beyond the end of the recording, which lasts {length_s:.1f} s")
    if to_ns < first_ns:
        raise WindowError(f"--to {end} lies before the recording, which begins at {_shown(first_ns)}")
    if to_ns < from_ns:
        raise WindowError(f"--to {end} lies before --from {begin}")
    return max(from_ns, first_ns), min(to_ns, last_ns)


def _shown(at_ns: int) -> str:
    return datetime.fromtimestamp(at_ns * 1e-9).astimezone().isoformat(" ", "seconds")
