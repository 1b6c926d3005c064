"""Messages of the robot as bytes: ours beside those of other libraries, and how long they take."""

import contextlib
import importlib
import statistics
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from agents.emulator import messages as written
from shared.clock import processor_s
from shared.ros import types

KINDS = {
    types.JOINT_STATE: "JointState",
    types.POSE_STAMPED: "PoseStamped",
    types.OPERATING_STATE: "OperatingState",
    types.STRING_STAMPED: "StringStamped",
    types.STRING: "String",
    types.BOOL: "Bool",
    types.FLOAT64: "Float64",
    types.EMPTY: "Empty",
}
MESSAGES = 1000
PYCDR2, CYCLONE = "pycdr2", "cyclonedds"


def others() -> dict[str, Any]:
    """The libraries that are there, each with the emulator's messages written by it."""
    found = {PYCDR2: written}
    with contextlib.suppress(ImportError):
        found[CYCLONE] = _by_cyclone()
    return found


def compared(count: int = MESSAGES) -> list[dict[str, Any]]:
    """A row for each type of message: in how many of random ones the bytes are the same, and the times of ours."""
    return [_row(name, kind, count) for name, kind in KINDS.items()]


def _row(name: str, kind: str, count: int) -> dict[str, Any]:
    rng = np.random.default_rng(7)
    said = [_random(written, kind, rng) for _ in range(count)]
    data = [one.serialize() for one in said]
    row: dict[str, Any] = {"type": name, "messages": count, "bytes": statistics.median(map(len, data))}
    for library, module in others().items():
        rng = np.random.default_rng(7)
        theirs = [_random(module, kind, rng).serialize() for _ in range(count)]
        ours = [types.encode(name, types.decode(name, one)) for one in theirs]
        row[library] = sum(bytes(a) == b for a, b in zip(theirs, ours, strict=True))
    read = [types.decode(name, one) for one in data]
    row["decode µs"] = _microseconds(lambda: [types.decode(name, one) for one in data], count)
    row["encode µs"] = _microseconds(lambda: [types.encode(name, one) for one in read], count)
    return row


def _microseconds(work: Callable[[], Any], count: int) -> float:
    """The least of five, in the processor's time."""
    taken: list[float] = []
    for _ in range(5):
        begun_s = processor_s()
        work()
        taken.append((processor_s() - begun_s) / count * 1e6)
    return min(taken)


def _random(of: Any, kind: str, rng: np.random.Generator) -> Any:
    """A message with values that no field has by default."""
    at = of.header(int(rng.integers(0, 2**60)), "".join(map(chr, rng.integers(97, 123, rng.integers(0, 12)))))
    word = "".join(map(chr, rng.integers(0x20, 0x7E, rng.integers(0, 40))))
    n = int(rng.integers(0, 9))
    match kind:
        case "JointState":
            names = [f"joint{i}" * int(rng.integers(0, 3)) for i in range(n)]
            return of.JointState(at, names, rng.normal(size=n).tolist(), rng.normal(size=n).tolist(), [])
        case "PoseStamped":
            p, q = rng.normal(size=3).tolist(), rng.normal(size=4).tolist()
            return of.PoseStamped(at, of.Pose(of.Point(*p), of.Quaternion(*q)))
        case "OperatingState":
            return of.OperatingState(at, word, bool(rng.integers(2)), bool(rng.integers(2)))
        case "StringStamped":
            return of.StringStamped(at, word)
        case "String":
            return of.String(word)
        case "Bool":
            return of.Bool(bool(rng.integers(2)))
        case "Float64":
            return of.Float64(float(rng.normal()))
        case _:
            return of.Empty()


def _by_cyclone() -> Any:
    """The emulator's messages once more, as the classes of Cyclone DDS's own library.

    Raises:
        ImportError: where it is not installed.
    """
    idl = importlib.import_module("cyclonedds.idl")
    before = {name: sys.modules[name] for name in ("pycdr2", "pycdr2.types", written.__name__)}
    try:
        sys.modules["pycdr2"], sys.modules["pycdr2.types"] = idl, importlib.import_module("cyclonedds.idl.types")
        del sys.modules[written.__name__]
        return importlib.import_module(written.__name__)
    finally:
        sys.modules.update(before)
