"""Messages that no honest sender makes: random, cut off, with bits flipped, and well formed with absurd values.

Made from one valid message of each kind, so that some pass a first look, and a few even all checks.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.descriptor import FieldDescriptor

import schemas
from schemas.codec import encode
from schemas.messages import (
    AgentConfiguration,
    Arm,
    ChangeState,
    Checked,
    FrameNotice,
    FrameStamp,
    GraspCheck,
    GraspGoal,
    Heartbeat,
    Hold,
    HostClock,
    HostClocks,
    LogLevel,
    LogRecord,
    Policy,
    Prompt,
    PullGoal,
    ReplayClock,
    SetParameter,
    StateWord,
    ToolCandidate,
    ToolCorrection,
    ToolStatus,
)
from schemas.topics import TOPICS, Topic, topic_of
from schemas.wire import wire_type
from shared.clock import now_ns
from shared.recording.mcap_file import read_recording
from shared.runtime.commands import new_header

EXAMPLE = Path(__file__).parents[3] / "docs" / "example" / "session.mcap"
NEWEST = Path(__file__).parents[2] / "schemas" / "released" / schemas.__version__ / "recording.mcap"
"""One message of each topic, for those that the example is too old for."""
FLOATS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, -0.0, -1.0, 1e18)
INTEGERS = (0, 1, -1, 2**31 - 1, -(2**31), 2**32 - 1, 2**62, 2**63 - 1, -(2**63), 2**64 - 1)
TEXTS = ("", "\0", "x" * 5000, "../../etc/passwd", "**", "@adv/pub", "\u202e", "%s%n{0}", "1e999", "[" * 3000)
SHAPES = ((), (0,), (2**32 - 1,), (2**31, 2**31), (1,) * 40, (0, 2**32 - 1), (3, 3), (4, 4))
LONGEST_RANDOM, MOST_REPEATED = 4096, 300


def valid_messages(arm: str, plan_id: str = "p") -> dict[Topic, Callable[[], bytes]]:
    """By topic, what makes a valid message of it as it travels; a command is made anew, as its time is short."""
    recorded = {topic_of(entry.key): entry.payload for path in (NEWEST, EXAMPLE) for entry in read_recording(path)}
    made: dict[type, Callable[[], Any]] = {
        GraspGoal: lambda: GraspGoal(new_header("x"), arm, Policy.CAPTURE_SLIDE_GRASP, 0.5, None, None),
        PullGoal: lambda: PullGoal(new_header("x"), arm, 0.02, np.array([10.0, 20.0])),
        Arm: lambda: Arm(new_header("x"), arm, plan_id),
        Hold: lambda: Hold(new_header("x"), arm),
        ChangeState: lambda: ChangeState(new_header("x"), arm, StateWord.PAUSE),
        Prompt: lambda: Prompt(new_header("x"), np.array([10.0, 20.0])),
        SetParameter: lambda: SetParameter(new_header("x"), "least_probability", "0.5"),
        FrameNotice: lambda: FrameNotice(FrameStamp(7, now_ns(), now_ns(), "calibration")),
        Heartbeat: lambda: Heartbeat(arm, plan_id, now_ns(), "a"),
        ReplayClock: lambda: ReplayClock(now_ns(), 1.0),
        GraspCheck: lambda: _checked(arm, plan_id),
        ToolCorrection: lambda: _followed(arm),
        LogRecord: lambda: LogRecord(now_ns(), "x", "main", LogLevel.INFO, "a line"),
        HostClocks: lambda: HostClocks(now_ns(), (HostClock("camera", "main", "desk", 0.1, 0.05),)),
        AgentConfiguration: lambda: AgentConfiguration("x", "main", now_ns(), "{}", (), "abc"),
    }
    return {
        topic: (lambda topic=topic: encode(made[topic.message]()))
        if topic.message in made
        else (lambda topic=topic: recorded[topic])
        for topic in TOPICS
    }


def _checked(arm: str, plan_id: str) -> GraspCheck:
    stamp = FrameStamp(7, now_ns(), now_ns(), "calibration")
    moved = 0.005, 0.0049, 0.0003, 0.99
    return GraspCheck(plan_id, arm, "goal", Checked.HELD, stamp, stamp, *moved, 1, 3, "", "held: the thread moved")


def _followed(arm: str) -> ToolCorrection:
    stamp, tip = FrameStamp(7, now_ns(), now_ns(), "calibration"), np.array((0.0, 0.0, 0.1))
    outline, score = np.ones((3, 2)), np.zeros((16, 16, 16), np.uint8)
    candidate = ToolCandidate(np.zeros(6), np.eye(6), score, 9, 0.9, 0.8, 0.5)
    off, outlines = (0.004, 0.02, 3e-4, 0.01), (outline, outline, outline)
    turned = np.eye(4), tip, tip
    return ToolCorrection(
        arm, stamp, now_ns(), ToolStatus.CONVERGED, "", *turned, *off, *outlines, (candidate,), 0, 0, 5
    )


def malformed(topic: Topic, valid: Callable[[], bytes], draw: np.random.Generator) -> Iterator[bytes]:
    """One payload after another, without end."""
    while True:
        way = draw.random()
        if way < 0.15:
            yield draw.bytes(int(draw.integers(0, LONGEST_RANDOM)))
        elif way < 0.3:
            whole = valid()
            yield whole[: int(draw.integers(0, len(whole)))]
        elif way < 0.5:
            yield flipped(valid(), draw)
        elif way < 0.97:
            yield with_absurd_fields(topic, valid(), draw)
        else:
            yield valid() * 2


def flipped(whole: bytes, draw: np.random.Generator) -> bytes:
    """A message with a few of its bits the other way."""
    changed = bytearray(whole)
    for _ in range(int(draw.integers(1, 9))):
        # half of them where fields and lengths are, which images would leave untouched
        place = int(draw.integers(0, len(changed) if draw.random() < 0.5 else min(200, len(changed))))
        changed[place] ^= 1 << int(draw.integers(0, 8))
    return bytes(changed)


def with_absurd_fields(topic: Topic, whole: bytes, draw: np.random.Generator) -> bytes:
    """A message that protobuf reads, in which one to three fields say what they should not."""
    wire = wire_type(topic.message).FromString(whole)
    for _ in range(int(draw.integers(1, 4))):
        places = list(_places(wire))
        _spoil(*places[int(draw.integers(0, len(places)))], draw)
    return wire.SerializeToString()


def _places(wire: Any) -> Iterator[tuple[Any, FieldDescriptor]]:
    """Every field of a message and of those within it; of what is repeated, of the first alone."""
    for field in wire.DESCRIPTOR.fields:
        yield wire, field
        if field.type == FieldDescriptor.TYPE_MESSAGE:
            held = getattr(wire, field.name)
            if _is_repeated(wire, field):
                yield from _places(held[0]) if held else ()
            elif wire.HasField(field.name):
                yield from _places(held)


def _is_repeated(wire: Any, field: FieldDescriptor) -> bool:
    return hasattr(getattr(wire, field.name), "extend")


def _spoil(wire: Any, field: FieldDescriptor, draw: np.random.Generator) -> None:
    if _is_repeated(wire, field):
        _spoil_repeated(wire, field, draw)
    elif field.type == FieldDescriptor.TYPE_MESSAGE or draw.random() < 0.15:
        wire.ClearField(field.name)
    else:
        setattr(wire, field.name, _absurd(field, getattr(wire, field.name), draw))


def _spoil_repeated(wire: Any, field: FieldDescriptor, draw: np.random.Generator) -> None:
    held = getattr(wire, field.name)
    if field.name == "shape":
        del held[:]
        held.extend(SHAPES[int(draw.integers(0, len(SHAPES)))])
    elif len(held) == 0 or draw.random() < 0.5:
        wire.ClearField(field.name)
    else:
        more = list(held) * (MOST_REPEATED // len(held) + 1)
        held.extend(more[: int(draw.integers(1, MOST_REPEATED))])


def _absurd(field: FieldDescriptor, value: Any, draw: np.random.Generator) -> Any:
    if field.type in (FieldDescriptor.TYPE_DOUBLE, FieldDescriptor.TYPE_FLOAT):
        return float(FLOATS[int(draw.integers(0, len(FLOATS)))])
    if field.type == FieldDescriptor.TYPE_STRING:
        return TEXTS[int(draw.integers(0, len(TEXTS)))]
    if field.type == FieldDescriptor.TYPE_BYTES:
        return _absurd_bytes(value, draw)
    if field.type == FieldDescriptor.TYPE_BOOL:
        return not value
    if field.type == FieldDescriptor.TYPE_ENUM:
        return int(draw.integers(-1, 9))
    lowest, highest = _RANGES[field.type]
    fitting = [n for n in INTEGERS if lowest <= n <= highest]
    return fitting[int(draw.integers(0, len(fitting)))]


def _absurd_bytes(value: bytes, draw: np.random.Generator) -> bytes:
    """Of an array: as many bytes as before, where some numbers are none; or too many, too few, none."""
    way = draw.random()
    if way < 0.6 and len(value) >= 8 and len(value) % 8 == 0:
        numbers = np.frombuffer(value, np.float64).copy()
        chosen = draw.random(len(numbers)) < draw.choice([0.02, 1.0])
        numbers[chosen] = FLOATS[int(draw.integers(0, len(FLOATS)))]
        return numbers.tobytes()
    return draw.bytes(len(value)) if way < 0.7 else value + b"\0" * 7 if way < 0.8 else value[: len(value) // 2]


_RANGES = {
    FieldDescriptor.TYPE_INT32: (-(2**31), 2**31 - 1),
    FieldDescriptor.TYPE_UINT32: (0, 2**32 - 1),
    FieldDescriptor.TYPE_INT64: (-(2**63), 2**63 - 1),
    FieldDescriptor.TYPE_UINT64: (0, 2**64 - 1),
    FieldDescriptor.TYPE_SINT32: (-(2**31), 2**31 - 1),
    FieldDescriptor.TYPE_SINT64: (-(2**63), 2**63 - 1),
}
