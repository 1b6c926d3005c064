"""Tables as files, written row by row, so that their length does not matter: CSV, JSON, or NumPy's npz."""

import csv
import json
import math
import shutil
import zipfile
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np

from agents.inspection.export_columns import Block, row_count


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
