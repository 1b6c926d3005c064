"""Messages of the robot and its camera as bytes: ours beside those of other libraries, and how long they take."""

import contextlib
import importlib
import statistics
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from agents.emulator import messages as written
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
    rng = np.random.default_rng(7)
    said = [_random(_all(written, images), kind, rng) for _ in range(count)]
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
        case "Empty":
            return of.Empty()
        case _:
            return _random_image(of, kind, at, word, rng)


def _random_image(of: Any, kind: str, at: Any, word: str, rng: np.random.Generator) -> Any:
    height, width, n = (int(count) for count in rng.integers(0, 20, 3))
    match kind:
        case "Joy":
            # a float32 as Python has it
            axes = rng.normal(size=n).astype(np.float32).tolist()
            return of.Joy(at, axes, rng.integers(-2, 3, n).tolist())
        case "Image":
            pixels = rng.integers(0, 256, 3 * height * width, np.uint8).tobytes()
            return of.Image(at, height, width, word, int(rng.integers(2)), 3 * width, pixels)
        case "CompressedImage":
            return of.CompressedImage(at, word, rng.integers(0, 256, n, np.uint8).tobytes())
        case _:
            k, r, p = (rng.normal(size=size).tolist() for size in (9, 9, 12))
            roi = of.Roi(*(int(side) for side in rng.integers(0, 99, 4)), bool(rng.integers(2)))
            rest = (k, r, p, *(int(factor) for factor in rng.integers(0, 4, 2)), roi)
            return of.CameraInfo(at, height, width, word, rng.normal(size=n).tolist(), *rest)


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
