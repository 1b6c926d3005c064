"""When a calibration was made, as far as its files state it; when a file was written or copied says nothing of that.

Ours state it as `made`, with the zone of its clock; OpenCV's calibration sample as `calibration_time`, in the form of
C's asctime, without one, so that it is known to a day.
"""

import datetime
from collections.abc import Iterable, Sequence
from pathlib import Path

from shared.calibration.documents import Node, parse_documents, read_text
from shared.calibration.stated import CalibrationError

MADE, BY_OPENCV = "made", "calibration_time"
ASCTIME = "%a %b %d %H:%M:%S %Y"
FORMS = (".json", ".yaml", ".yml", ".xml")
NS_PER_S = 10**9
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)


def made_text(at_ns: int) -> str:
    """A time since 1970 as our files state it."""
    return (_EPOCH + datetime.timedelta(seconds=at_ns // NS_PER_S)).isoformat()


def made_ns(paths: Iterable[Path]) -> int | None:
    """When what these files and folders hold was made, since 1970; of several the earliest, None where none tells."""
    try:
        files = [file for path in paths for file in (path.iterdir() if path.is_dir() else (path,))]
    except OSError:
        return None
    told = [stated for file in files if file.suffix in FORMS and (stated := _stated_ns(file)) is not None]
    return min(told, default=None)


def _stated_ns(file: Path) -> int | None:
    try:
        documents = parse_documents(read_text(file))
    except CalibrationError:
        return None
    values = [(name, _text(document.get(name))) for document in documents for name in (MADE, BY_OPENCV)]
    told = [time for name, text in values if (time := _time(name, text)) is not None]
    return min((round((time - _EPOCH).total_seconds()) * NS_PER_S for time in told), default=None)


def _text(node: Node) -> str:
    """A text as it was written, which XML has in quotes, and whose words are read as a list there."""
    words = [node] if isinstance(node, str) else node if isinstance(node, Sequence) else ()
    return " ".join(word for word in words if isinstance(word, str)).strip('" ')


def _time(name: str, text: str) -> datetime.datetime | None:
    try:
        time = datetime.datetime.fromisoformat(text) if name == MADE else datetime.datetime.strptime(text, ASCTIME)
    except ValueError:
        return None
    return time if time.tzinfo is not None else time.replace(tzinfo=datetime.UTC)
