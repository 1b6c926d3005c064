"""Numbers over time, sent in columns: one call for half a second of a curve in place of one for each of its points.

A call costs as much for one number as for ten, and numbers are half of all that is shown.
"""

from dataclasses import dataclass, field

import numpy as np
import rerun as rr

from agents.viewer.moment import Moment
from shared.clock import monotonic_s

SENT_EVERY_S = 0.5
MOST_WAITING = 20_000
"""Numbers, where a recording is read as fast as it goes."""


@dataclass
class _Column:
    capture_ns: list[int] = field(default_factory=list[int])
    frame: list[int] = field(default_factory=list[int])
    values: list[np.ndarray] = field(default_factory=list[np.ndarray])


class Curves:
    """What waits to be sent of each curve."""

    def __init__(self) -> None:
        self._columns: dict[tuple[str, bool], _Column] = {}
        self._waiting, self._sent_s = 0, monotonic_s()

    def add(self, path: str, moment: Moment, numbers: rr.Scalars) -> None:
        """Have the numbers of a moment wait."""
        # what has no frame is in a column of its own, since a column is on the same timelines throughout
        column = self._columns.setdefault((path, moment.frame is None), _Column())
        column.capture_ns.append(moment.capture_ns)
        column.frame.append(moment.frame or 0)
        batch = numbers.scalars
        column.values.append(np.zeros(0) if batch is None else batch.as_arrow_array().to_numpy())
        self._waiting += 1

    @property
    def due(self) -> bool:
        """Whether it is time to send them."""
        return self._waiting > 0 and (self._waiting >= MOST_WAITING or monotonic_s() - self._sent_s >= SENT_EVERY_S)

    def send(self, stream: rr.RecordingStream) -> None:
        """Send all that wait."""
        for (path, without_frame), column in self._columns.items():
            times = [rr.TimeColumn("capture_time", timestamp=np.array(column.capture_ns, "datetime64[ns]"))]
            if not without_frame:
                times.append(rr.TimeColumn("frame", sequence=np.array(column.frame, np.int64)))
            numbers = rr.Scalars.columns(scalars=np.concatenate(column.values))
            stream.send_columns(path, times, numbers.partition([len(one) for one in column.values]))
        self._columns.clear()
        self._waiting, self._sent_s = 0, monotonic_s()
