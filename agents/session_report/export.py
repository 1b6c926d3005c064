"""A recording as a folder of tables that any program reads.

Tables as files, written row by row, so that their length does not matter: CSV, JSON, or NumPy's npz.
"""

import contextlib
import csv
import json
import math
import shutil
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np

from agents.session_report.export_rows import Block, blocks, row_count
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.topics import COMMANDS, EXECUTION, JUDGEMENT, PLAN, ROBOT_STATE, THREAD, known_topic
from shared.recording.completeness import Completeness, completeness
from shared.recording.entry import Entry, RecordingError
from shared.recording.mcap_file import UntilDamage


class TableFile(Protocol):
    """A table that grows by blocks of rows with the same columns."""

    path: Path

    def __init__(self, stem: Path, columns: tuple[str, ...]) -> None: ...

    def add(self, block: Block) -> None:
        """Write rows."""
        ...

    def close(self) -> None:
        """Finish the file."""
        ...


class CsvTable:
    """A line of names, then a line a row; what is not known is empty."""

    def __init__(self, stem: Path, columns: tuple[str, ...]) -> None:
        self.path = stem.with_suffix(".csv")
        self._file = self.path.open("w", encoding="utf-8", errors="backslashreplace", newline="")
        self._writer = csv.writer(self._file)
        self._writer.writerow(columns)

    def add(self, block: Block) -> None:
        """Write rows."""
        self._writer.writerows(_rows(block, unknown=""))

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


class JsonTable:
    """`{"columns": [names], "rows": [[values]]}`; what is not known is null."""

    def __init__(self, stem: Path, columns: tuple[str, ...]) -> None:
        self.path = stem.with_suffix(".json")
        self._file = self.path.open("w", encoding="utf-8", errors="backslashreplace")
        self._file.write(f'{{"columns": {json.dumps(columns)},\n"rows": [')
        self._before = "\n"

    def add(self, block: Block) -> None:
        """Write rows."""
        for row in _rows(block, unknown=None):
            self._file.write(f"{self._before}{json.dumps(row)}")
            self._before = ",\n"

    def close(self) -> None:
        """Finish the file."""
        self._file.write("\n]}\n")
        self._file.close()


class NpzTable:
    """An array a column; what is not known is NaN. Numbers wait on disk until all are there."""

    def __init__(self, stem: Path, columns: tuple[str, ...]) -> None:
        self.path = stem.with_suffix(".npz")
        self._folder = stem.with_suffix(".unfinished")
        self._folder.mkdir()
        self._columns, self._rows = columns, 0
        self._numbers: dict[str, tuple[IO[bytes], str]] = {}
        self._texts: dict[str, list[str]] = {}

    def add(self, block: Block) -> None:
        """Write rows."""
        self._rows += row_count(block)
        for name, values in block.items():
            if isinstance(values, list):
                self._texts.setdefault(name, []).extend(values)
                continue
            array = np.ascontiguousarray(values, "<i8" if values.dtype.kind in "iub" else "<f8")
            if name not in self._numbers:
                self._numbers[name] = (self._folder / name).open("w+b"), array.dtype.str
            self._numbers[name][0].write(array.tobytes())

    def close(self) -> None:
        """Put all columns into one file."""
        try:
            with zipfile.ZipFile(self.path, "w", zipfile.ZIP_DEFLATED, allowZip64=True) as archive:
                for name in self._columns:
                    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                        self._write_column(file, name)
        finally:
            for file, _ in self._numbers.values():
                file.close()
            shutil.rmtree(self._folder, ignore_errors=True)

    def _write_column(self, file: IO[bytes], name: str) -> None:
        if name in self._texts:
            np.lib.format.write_array(file, np.array(self._texts[name], np.str_), allow_pickle=False)
            return
        numbers, descr = self._numbers[name]
        header = {"descr": descr, "fortran_order": False, "shape": (self._rows,)}
        np.lib.format.write_array_header_1_0(file, header)
        numbers.seek(0)
        shutil.copyfileobj(numbers, file)


FORMATS: dict[str, type[TableFile]] = {"csv": CsvTable, "npz": NpzTable, "json": JsonTable}


def _rows(block: Block, unknown: Any) -> list[list[Any]]:
    columns = [values if isinstance(values, list) else _known(values.tolist(), unknown) for values in block.values()]
    return [list(row) for row in zip(*columns, strict=True)]


def _known(values: list[Any], unknown: Any) -> list[Any]:
    return [unknown if isinstance(value, float) and not math.isfinite(value) else value for value in values]


EXPORTED = (THREAD, PLAN, ROBOT_STATE, COMMANDS, EXECUTION, JUDGEMENT)
README = "README.txt"
MEANING = """Tables of {source}, written by suturegrasp export.
{said}
t_s       seconds since {zero}:
          of frames and curves the capture of the left image, of plans their publication, of robot_states the
          measurement, of commands their receipt, of outcomes the event
*_ns      nanoseconds since 1970
*_m       metres; *_m2 square metres; *_rad radians; *_px pixels of the rectified left image, centres at whole numbers
*_unit    lengths in the unit of the calibration, where nobody knows how many metres that is
*_camera  in the rectified left camera's frame: x right, y down, z away from it
*_base    in the frame of the arm's base
q*        a unit quaternion, scalar part (w) first; tool_* is the pose of the tool: jaws along x, fingers along z
s         share of the thread's length, from 0 at one end to 1 at the other
seen      1 where both images show the thread
deviation standard deviation of a point along its least certain direction; covariance_xy and so on are the whole of it
          (empty or NaN where the method predicts none)
confidence and probability lie between 0 and 1

frames        one row a reconstruction: whether it succeeded, and the curve as a whole
curves        {points} rows a reconstruction: the curve at places evenly spaced along it; `frame` leads to `frames`
plans         one row a plan, or a rejection with its reason
waypoints     the tool poses of each plan, in their order
robot_states  one row a measurement of an arm; joint_3 is the insertion, in metres
commands      goals, armings, holds and prompts with their answers
outcomes      what happened to each armed plan; kind `judged` is the simulator's verdict (in `code`) and sentence

"""


@dataclass
class Exported:
    """What was written.

    Fields:
        rows: by table.
        unreadable: messages that this version cannot read.
        other_units: curves left out because their lengths are in another unit than those before.
        damage: what broke the reading off; empty where all was read.
        said: what the recording says of what it was made of and of what it lacks.
    """

    rows: dict[str, int] = field(default_factory=dict[str, int])
    unreadable: int = 0
    other_units: int = 0
    damage: str = ""
    said: Completeness | None = None


def export(source: Path, folder: Path, form: str, points: int) -> Exported:
    """Write the tables of a recording, and a README that says what they hold, into a folder.

    Raises:
        RecordingError: where the file is no recording at all.
        OSError: where it cannot be opened, or the folder cannot be written to.
    """
    exported, tables = Exported(), dict[str, tuple[TableFile, tuple[str, ...]]]()
    zero_ns: int | None = None
    recording = UntilDamage(source)
    try:
        for entry in recording.entries():
            if entry.repeated:
                continue
            zero_ns = entry.published_ns if zero_ns is None else zero_ns
            for name, block in _blocks(entry, zero_ns, points, exported):
                if name not in tables:
                    tables[name] = FORMATS[form](folder / name, tuple(block)), tuple(block)
                table, columns = tables[name]
                if tuple(block) != columns:
                    exported.other_units += 1
                    continue
                table.add(block)
                exported.rows[name] = exported.rows.get(name, 0) + row_count(block)
    finally:
        for table, _ in tables.values():
            table.close()
    if zero_ns is None and recording.damage:
        raise RecordingError(recording.damage)
    exported.damage = recording.damage
    exported.said = completeness(source)
    derived = (one.sentence for one in exported.said.derived)
    said = "\n".join([*derived, exported.damage or exported.said.sentence, ""])
    began = "the recording began, of which there is no message"
    if zero_ns is not None:
        began = f"{zero_ns} ns after 1970, when the first message of the recording was published"
    text = MEANING.format(source=source.name, said=said, zero=began, points=points)
    columns_of = (f"{table.path.name}: {', '.join(columns)}\n" for table, columns in tables.values())
    (folder / README).write_text(text + "\n".join(columns_of), encoding="utf-8", errors="backslashreplace")
    return exported


def _blocks(entry: Entry, zero_ns: int, points: int, exported: Exported) -> list[tuple[str, Block]]:
    topic = known_topic(entry.key)
    if topic is not None and topic not in EXPORTED:
        return []
    if topic is not None:
        with contextlib.suppress(MessageError):
            return list(blocks(decode(topic.message, entry.payload), entry.published_ns, zero_ns, points))
    exported.unreadable += 1
    return []
