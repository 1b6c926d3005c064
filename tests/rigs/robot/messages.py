"""Messages of the robot and its camera as bytes: ours beside those of other libraries, and how long they take."""

import contextlib
import dataclasses
import importlib
import re
import statistics
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, get_type_hints

import numpy as np

from agents.dvrk_emulator import messages as written
from shared.clock import processor_s
from shared.ros import types
from tests.rigs.robot import image_messages as images

KINDS = {
    types.JOINT_STATE: "JointState",
    types.POSE_STAMPED: "PoseStamped",
    types.OPERATING_STATE: "OperatingState",
    types.STRING_STAMPED: "StringStamped",
    types.STRING: "String",
    types.BOOL: "Bool",
    types.FLOAT64: "Float64",
    types.EMPTY: "Empty",
    types.JOY: "Joy",
    types.IMAGE: "Image",
    types.COMPRESSED_IMAGE: "CompressedImage",
    types.CAMERA_INFO: "CameraInfo",
}
MESSAGES = 1000
PYCDR2, CYCLONE = "pycdr2", "cyclonedds"
MANY = re.compile(r"(?:sequence|array)\[(?P<of>\w+)(?:, (?P<count>\d+))?\]")


def others() -> dict[str, Any]:
    """The libraries that are there, each with the same messages written by it."""
    found = {PYCDR2: _all(written, images)}
    with contextlib.suppress(ImportError):
        found[CYCLONE] = _by_cyclone()
    return found


def compared(count: int = MESSAGES, only: str = "") -> list[dict[str, Any]]:
    """A row for each type of message, or one: how many of random ones are the same bytes, and the times of ours."""
    return [_row(name, kind, count) for name, kind in KINDS.items() if only in ("", name)]


def _row(name: str, kind: str, count: int) -> dict[str, Any]:
    row: dict[str, Any] = {"type": name, "messages": count}
    data: list[bytes] = []
    for library, module in others().items():
        rng = np.random.default_rng(7)
        theirs = [bytes(_random(getattr(module, kind), rng).serialize()) for _ in range(count)]
        data = data or theirs
        row["bytes"] = statistics.median(map(len, data))
        row[library] = sum(one == types.encode(name, types.decode(name, one)) for one in theirs)
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


def _random(kind: Any, rng: np.random.Generator) -> Any:
    """A value of a type as either library writes it; of a message, with values that no field has by default."""
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return kind(*(_random(of, rng) for of in get_type_hints(kind, include_extras=True).values()))
    told = kind.__name__ if isinstance(kind, type) else str(kind.__metadata__[0])
    if many := MANY.fullmatch(told):
        values = [_number(many["of"], rng) for _ in range(int(many["count"] or rng.integers(0, 20)))]
        return bytes(values) if many["of"] == "uint8" else values
    return _number(told, rng)


def _number(kind: str, rng: np.random.Generator) -> Any:
    """A number, a text or a truth."""
    match kind:
        case "str":
            return "".join(map(chr, rng.integers(0x20, 0x7E, rng.integers(0, 40))))
        case "bool":
            return bool(rng.integers(2))
        case "float32":
            # as Python has it
            return float(np.float32(rng.normal()))
        case "float64":
            return float(rng.normal())
        case _:
            bits = int(kind.lstrip("uint"))
            lowest = 0 if kind.startswith("u") else -(2 ** (bits - 1))
            return int(rng.integers(lowest, lowest + 2**bits))


def _all(*modules: Any) -> SimpleNamespace:
    """The classes of several modules in one."""
    return SimpleNamespace(**{name: value for module in modules for name, value in vars(module).items()})


def _by_cyclone() -> Any:
    """The emulator's messages once more, as the classes of Cyclone DDS's own library.

    Raises:
        ImportError: where it is not installed.
    """
    idl = importlib.import_module("cyclonedds.idl")
    again = written.__name__, images.__name__
    before = {name: sys.modules[name] for name in ("pycdr2", "pycdr2.types", *again)}
    try:
        sys.modules["pycdr2"], sys.modules["pycdr2.types"] = idl, importlib.import_module("cyclonedds.idl.types")
        for name in again:
            del sys.modules[name]
        return _all(*(importlib.import_module(name) for name in again))
    finally:
        sys.modules.update(before)
