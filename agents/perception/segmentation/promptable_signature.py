"""What an ONNX file says it takes and gives, read from its outermost fields alone.

A file of weights has gigabytes, and OpenCV tells the names of what a network gives, not of what it takes. The wire
format of protobuf names the length of every field, so that all others are stepped over unread. Fields as numbered in
ONNX's onnx.proto: ModelProto.graph 7; GraphProto.initializer 5, input 11, output 12; TensorProto.name 8;
ValueInfoProto.name 1, type 2; TypeProto.tensor_type 1; its shape 2, dim 1; Dimension.dim_value 1.
"""

import mmap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

VARINT, EIGHT_BYTES, LENGTH, FOUR_BYTES = 0, 1, 2, 5
"""Kinds of fields on the wire."""
LONGEST_VARINT = 10

Shape = tuple[int | None, ...]
Field = tuple[int, int, int, int]
"""Number, kind, and where the value begins and ends; of a varint, its value in place of the beginning."""


class NotOnnxError(ValueError):
    """Bytes that are no ONNX model."""


@dataclass(frozen=True)
class Signature:
    """Names and shapes of what a network takes and gives; None in a shape is a side that may have any length."""

    inputs: dict[str, Shape]
    outputs: dict[str, Shape]


def signature_of(path: Path) -> Signature:
    """What the ONNX file takes and gives.

    Raises:
        OSError: where it cannot be read.
        NotOnnxError: where it is none.
    """
    with path.open("rb") as file:
        try:
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            raise NotOnnxError("it is empty") from None
        with data:
            graphs = [
                (begin, end)
                for number, kind, begin, end in _fields(data, 0, len(data))
                if (number, kind) == (7, LENGTH)
            ]
            if not graphs:
                raise NotOnnxError("it holds no graph")
            return _graph(data, *graphs[-1])


def _graph(data: mmap.mmap, begin: int, end: int) -> Signature:
    parts: dict[int, list[tuple[int, int]]] = {5: [], 11: [], 12: []}
    for number, kind, first, last in _fields(data, begin, end):
        if kind == LENGTH and number in parts:
            parts[number].append((first, last))
    # up to version 3 of the format, weights are listed as inputs too
    weights = {_text(data, *at) for part in parts[5] for at in _inside(data, part, 8)}
    inputs, outputs = (dict(_value(data, part) for part in parts[number]) for number in (11, 12))
    return Signature({name: shape for name, shape in inputs.items() if name not in weights}, outputs)


def _value(data: mmap.mmap, part: tuple[int, int]) -> tuple[str, Shape]:
    names = [_text(data, *at) for at in _inside(data, part, 1)]
    dimensions = [part]
    for number in (2, 1, 2, 1):
        dimensions = [at for outer in dimensions for at in _inside(data, outer, number)]
    return (names or [""])[-1], tuple(_length(data, at) for at in dimensions)


def _length(data: mmap.mmap, part: tuple[int, int]) -> int | None:
    for number, kind, value, _ in _fields(data, *part):
        if (number, kind) == (1, VARINT):
            return value
    return None


def _inside(data: mmap.mmap, part: tuple[int, int], wanted: int) -> list[tuple[int, int]]:
    return [(begin, end) for number, kind, begin, end in _fields(data, *part) if (number, kind) == (wanted, LENGTH)]


def _text(data: mmap.mmap, begin: int, end: int) -> str:
    return data[begin:end].decode("utf-8", "replace")


def _fields(data: mmap.mmap, begin: int, end: int) -> Iterator[Field]:
    at = begin
    while at < end:
        tag, at = _varint(data, at, end)
        number, kind = tag >> 3, tag & 7
        if kind == VARINT:
            value, at = _varint(data, at, end)
            yield number, kind, value, at
            continue
        if kind == LENGTH:
            length, at = _varint(data, at, end)
        elif kind in (EIGHT_BYTES, FOUR_BYTES):
            length = 8 if kind == EIGHT_BYTES else 4
        else:
            raise NotOnnxError("its bytes are no protobuf message")
        if number == 0 or at + length > end:
            raise NotOnnxError("its bytes are no protobuf message, or it is cut off")
        yield number, kind, at, at + length
        at += length


def _varint(data: mmap.mmap, at: int, end: int) -> tuple[int, int]:
    value = 0
    for k in range(LONGEST_VARINT):
        if at + k >= end:
            break
        byte = data[at + k]
        value |= (byte & 127) << (7 * k)
        if byte < 128:
            return value, at + k + 1
    raise NotOnnxError("its bytes are no protobuf message, or it is cut off")
