"""Where entities go: a file, and a server that viewers on the screen connect to.

Each is a stream of its own, and is to be used from one thread of its own: a viewer that is frozen holds up the thread
that logs to it, and must hold up nothing else.
"""

import contextlib
import logging
import os
import pathlib
import socket
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun_cli

from agents.viewer.entity import Entity, Moment
from agents.viewer.thread_mapping import APPLICATION
from shared.clock import monotonic_s

AGAIN_NS = 1_000_000_000
DRAWN = (
    rr.Arrows3D,
    rr.Boxes2D,
    rr.Capsules3D,
    rr.Clear,
    rr.GraphEdges,
    rr.GraphNodes,
    rr.LineStrips2D,
    rr.LineStrips3D,
    rr.Points2D,
    rr.Points3D,
)
"""What is drawn from it is the same, however often it is logged; a line of the log is not."""


class RepeatFilter:
    """Remembers what was last logged of each entity, and when.

    What stands is logged again once a second: a viewer that connects late finds no more than its server's memory holds.
    """

    def __init__(self) -> None:
        self._last: dict[str, tuple[Moment, Sequence[rr.AsComponents]]] = {}

    def stands(self, path: str, moment: Moment, archetypes: Sequence[rr.AsComponents]) -> bool:
        """Whether this was logged within the last second, and need not be again; if not, that it is from now on."""
        before = self._last.get(path)
        if before is not None and all(isinstance(one, DRAWN) for one in archetypes):
            then, last = before
            same_timelines = (then.frame is None) == (moment.frame is None)
            if same_timelines and 0 <= moment.capture_ns - then.capture_ns < AGAIN_NS and _equal(last, archetypes):
                return True
        self._last[path] = moment, archetypes
        return False


def _equal(some: Sequence[rr.AsComponents], others: Sequence[rr.AsComponents]) -> bool:
    return some is others or (
        len(some) == len(others) and all(a is b or a == b for a, b in zip(some, others, strict=True))
    )


SENT_EVERY_S = 0.5
MOST_WAITING = 20_000
"""Numbers, where a recording is read as fast as it goes."""


@dataclass
class _Column:
    capture_ns: list[int] = field(default_factory=list[int])
    frame: list[int] = field(default_factory=list[int])
    values: list[np.ndarray] = field(default_factory=list[np.ndarray])


class ScalarBatches:
    """What waits to be sent of each curve; a call costs as much for one number as for ten."""

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


Layout = rrb.Blueprint

SERVER_MEMORY = "128MiB"
"""What is kept for a viewer that connects late; Rerun needs up to twice as much."""

WEB_PORT = 9090
WINDOW_OPTIONS: tuple[str, ...] = ()
"""More options of Rerun's window; without a screen, `--headless` stands in for one."""
INSTEAD = "; write a file with --output instead, and open it elsewhere"
CLOSED_AT_ONCE = "Rerun's window closed at once, so its graphics may not work here"
WINDOW_OPENS_S = 1.5
"""A window that has no screen to open on is gone by then."""


_log = logging.getLogger("suturegrasp.viewer")


class ViewerError(Exception):
    """What is to be shown cannot be; the text names the remedy."""


FLUSHED_EVERY = 100
"""Messages after which Rerun is told to write: until then it keeps what it was given, and never lets go by itself."""


class Sink:
    """A stream of entities that stamps every one with its moment."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream, self._logged = stream, 0
        self._scalars, self._repeats = ScalarBatches(), RepeatFilter()
        stream.set_log_time_enabled(False)

    def log(self, moment: Moment, entities: Iterable[Entity]) -> None:
        """Log entities of one moment; where there is no frame, that timeline does not know them."""
        self._stream.set_time("capture_time", timestamp=np.datetime64(moment.capture_ns, "ns"))
        if moment.frame is None:
            self._stream.disable_timeline("frame")
        else:
            self._stream.set_time("frame", sequence=moment.frame)
        for path, archetypes in entities:
            if self._repeats.stands(path, moment, archetypes):
                continue
            for archetype in archetypes:
                if isinstance(archetype, rr.Scalars):
                    self._scalars.add(path, moment, archetype)
                else:
                    self._stream.log(path, archetype, static=isinstance(archetype, STATIC))
        if self._scalars.due:
            self._scalars.send(self._stream)
        self._logged += 1
        if self._logged % FLUSHED_EVERY == 0:
            # begun, and not waited for
            self._stream.flush(timeout_sec=0.0)

    def lay_out(self, layout: rrb.Blueprint) -> None:
        """Arrange the views anew."""
        self._stream.send_blueprint(layout)

    def close(self) -> None:
        """Write what is under way, and end."""
        self._scalars.send(self._stream)
        self._stream.flush()
        self._stream.disconnect()


STATIC = (rr.SeriesLines, rr.StateConfiguration, rr.ViewCoordinates)
"""What holds at all times."""


class PartedFile(Sink):
    """A recording in files that follow each other; Rerun opens all of them together as one.

    While a file is open, Rerun keeps nearly as much in memory as it writes.
    """

    def __init__(self, stream: rr.RecordingStream, path: pathlib.Path, layout: Layout, part_bytes: int) -> None:
        super().__init__(stream)
        self._paths, self._layout, self._part_bytes = [path], layout, part_bytes
        self._holds: dict[tuple[str, type], Any] = {}
        stream.set_sinks(rr.FileSink(path), default_blueprint=layout)

    def log(self, moment: Moment, entities: Iterable[Entity]) -> None:
        """Log entities of one moment, and begin another file where this one is full."""
        logged = list(entities)
        super().log(moment, logged)
        self._holds |= {(path, type(one)): one for path, all_of in logged for one in all_of if isinstance(one, STATIC)}
        if self._logged % FLUSHED_EVERY == 0 and self._is_full():
            self._begin_another()

    def lay_out(self, layout: Layout) -> None:
        """Arrange the views anew, in the files that follow as well."""
        self._layout = layout
        super().lay_out(layout)

    def _is_full(self) -> bool:
        # somebody may have taken the file away, and the screen goes on all the same
        with contextlib.suppress(OSError):
            return self._paths[-1].stat().st_size >= self._part_bytes
        return False

    def _begin_another(self) -> None:
        first = self._paths[0]
        path = first.with_stem(f"{first.stem}_part{len(self._paths) + 1}")
        self._scalars.send(self._stream)
        self._stream.flush()
        try:
            self._stream.set_sinks(rr.FileSink(path), default_blueprint=self._layout)
        except (OSError, RuntimeError) as error:
            _log.warning("%s cannot be begun: %s; %s goes on", path, error, self._paths[-1].name)
            self._part_bytes = sys.maxsize
            return
        self._paths.append(path)
        for (entity, _), archetype in self._holds.items():
            self._stream.log(entity, archetype, static=True)


PART_BYTES = 1 << 29
"""Of a file of what runs live; a session of a day would take the memory of the machine otherwise."""


def file_sink(path: pathlib.Path, session_id: str, layout: Layout, part_bytes: int | None = None) -> Sink:
    """A recording in a file, or in several of about so many bytes.

    Raises:
        ViewerError: where it cannot be written.
    """
    stream = rr.RecordingStream(APPLICATION, recording_id=session_id)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if part_bytes is not None:
            return PartedFile(stream, path, layout, part_bytes)
        stream.set_sinks(rr.FileSink(path), default_blueprint=layout)
    except (OSError, RuntimeError) as error:
        raise ViewerError(f"{path} cannot be written: {error}; name another file") from error
    return Sink(stream)


def served_sink(session_id: str, layout: rrb.Blueprint, memory: str = SERVER_MEMORY) -> tuple[Sink, str]:
    """A recording for viewers to connect to, and its address; `memory` is what it keeps for those that come late.

    Raises:
        ViewerError: where it cannot be served.
    """
    stream = rr.RecordingStream(APPLICATION, recording_id=session_id)
    try:
        address = stream.serve_grpc(grpc_port=free_port(), default_blueprint=layout, server_memory_limit=memory)
    except (OSError, RuntimeError) as error:
        raise ViewerError(f"no viewer can be served: {error}") from error
    return Sink(stream), address


def window_sink(session_id: str, layout: rrb.Blueprint) -> tuple[Sink, subprocess.Popen[bytes], str]:
    """A recording that goes straight into a window that is opened for it, which keeps all of it, and its address.

    Raises:
        ViewerError: where there is no screen, or no window opens.
    """
    port = free_port()
    address = f"rerun+http://127.0.0.1:{port}/proxy"
    # one that closes at once is noticed later: what is logged until it has opened waits for it
    window = _started(["--port", str(port)], INSTEAD)
    stream = rr.RecordingStream(APPLICATION, recording_id=session_id)
    stream.connect_grpc(address, default_blueprint=layout)
    return Sink(stream), window, address


def open_window(address: str) -> subprocess.Popen[bytes]:
    """Rerun's own window on that address; it stays when this process ends.

    Raises:
        ViewerError: where there is no screen, or no window opens.
    """
    remedy = f"; elsewhere, run: rerun {address}"
    window = _started(["--port", str(free_port()), address], remedy)
    try:
        window.wait(WINDOW_OPENS_S)
    except subprocess.TimeoutExpired:
        return window
    raise ViewerError(f"{CLOSED_AT_ONCE}{remedy}")


def _started(arguments: list[str], remedy: str) -> subprocess.Popen[bytes]:
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ViewerError(f"there is no screen here to open a window on{remedy}")
    # the `rerun` console script only wraps this binary, and ending the wrapper would orphan the viewer
    binary = pathlib.Path(rerun_cli.__file__).parent / ("rerun.exe" if sys.platform == "win32" else "rerun")
    command = [binary, *WINDOW_OPTIONS, *arguments]
    try:
        return subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError as error:
        raise ViewerError(f"Rerun's window cannot be opened: {error}") from error


def open_page(address: str) -> str:
    """Serve Rerun's web viewer, open it in the browser if there is one, and return where it is.

    Raises:
        ViewerError: where it cannot be served.
    """
    port = WEB_PORT if _is_free(WEB_PORT) else free_port()
    try:
        rr.serve_web_viewer(web_port=port, open_browser=True, connect_to=address)
    except (OSError, RuntimeError) as error:
        raise ViewerError(f"the web viewer cannot be served: {error}") from error
    return f"http://localhost:{port}/?url={address.replace('127.0.0.1', 'localhost')}"


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) != 0
