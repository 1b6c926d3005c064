"""Readers of bytes that others wrote, each with what must hold of whatever bytes there are.

A target returns where its bytes were read, or refused by the reader's one exception; anything else is a defect.
"""

import contextlib
import json
import math
import tempfile
from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.guard import cdr
from agents.operator.wire import WireError, parsed
from schemas.checks import MessageError
from schemas.codec import decode, encode
from schemas.messages import (
    Arm,
    ChallengeEcho,
    CommandHeader,
    FrameNotice,
    FrameStamp,
    Heartbeat,
    Hold,
    LogLevel,
    LogRecord,
)
from schemas.topics import LOG
from schemas.topics import key as topic_key
from shared.calibration import read_calibration
from shared.calibration.hand_eye.file import read_hand_eye
from shared.calibration.own_file import opencv_text
from shared.calibration.stated import CalibrationError
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as BASE
from shared.recording.entry import Entry, RecordingError
from shared.recording.mcap_file import read_recording
from shared.recording.writer import RecordingWriter
from shared.ros import crtk
from shared.ros.guarded import (
    ALIVE,
    CHALLENGE,
    SET_POINT,
    Alive,
    Challenge,
    Gate,
    GuardedError,
    SetPoint,
    alive_bytes,
    alive_from,
    challenge_bytes,
    challenge_from,
    key_of,
    set_point_bytes,
    set_point_from,
)
from shared.ros.types import RosMessageError
from tests.rigs.boards import endoscope

MOST_READ = 64_000_000
ECHO = (ChallengeEcho("psm1", 7),)


def console(data: bytes) -> None:
    """The guard's reader of the console's messages, beside the bridge's: what both take, they take alike."""
    with contextlib.suppress(cdr.CdrError, RosMessageError):
        joints = cdr.joint_positions(data)
        assert len(joints) <= cdr.MOST_VALUES
        assert crtk.joints(data).position.tolist() == list(joints) or any(map(math.isnan, joints))
    with contextlib.suppress(cdr.CdrError, RosMessageError):
        assert cdr.pressed(data) == crtk.button(data)


def ros(data: bytes) -> None:
    """The bridge's readers of what a console says."""
    for read in (crtk.joints, crtk.pose, crtk.operating_state, crtk.flag, crtk.button, crtk.text):
        with contextlib.suppress(RosMessageError):
            read(data)


def guarded(data: bytes) -> None:
    """What bridge and guard say to each other: read as one kind, it is none of the others, and is written the same."""
    taken = (
        _taken(SET_POINT, set_point_from, set_point_bytes, data),
        _taken(ALIVE, alive_from, alive_bytes, data),
        _taken(CHALLENGE, challenge_from, challenge_bytes, data),
    )
    assert sum(taken) <= 1


def _taken(topic: str, read: Callable[[str, bytes], Any], written: Callable[[str, Any], bytes], data: bytes) -> bool:
    own = key_of("PSM1", topic)
    try:
        said = read(own, data)
    except GuardedError:
        return False
    try:
        again = read(own, written(own, said))
    except GuardedError:
        # numbers that are none are read, so that the monitor holds for them, and never written
        assert isinstance(said, SetPoint)
        return True
    # reasons are cut off, and what is no text in them is replaced
    bare = [replace(each, reason="") if isinstance(each, Challenge) else each for each in (said, again)]
    assert repr(bare[0]) == repr(bare[1])
    return True


def heartbeats(data: bytes) -> None:
    """Messages that let an arm move, or stop it, as the codec takes them."""
    for kind in (Heartbeat, Arm, Hold, FrameNotice):
        with contextlib.suppress(MessageError):
            said = decode(kind, data)
            assert decode(kind, encode(said)) == said


def page(data: bytes) -> None:
    """What a browser says on its WebSocket; all numbers that are taken are finite."""
    with contextlib.suppress(WireError, UnicodeDecodeError):
        said = parsed(data.decode())
        for value in vars(said).values():
            numbers = value if isinstance(value, tuple) else (value,)
            assert all(math.isfinite(number) for number in numbers if isinstance(number, float))


def mcap(data: bytes) -> None:
    """A recording; it never becomes much larger than its file."""
    with _file(data, ".mcap") as path, contextlib.suppress(RecordingError):
        size = 0
        for entry in read_recording(path):
            size += len(entry.payload)
            assert size <= max(MOST_READ, 101 * len(data))


def calibration(data: bytes) -> None:
    """A stereo calibration, in any of the forms that are read."""
    for ending in (".yaml", ".json", ".ini"):
        with _file(data, ending) as path, contextlib.suppress(CalibrationError):
            found = read_calibration(path, unit="mm", image_size=(320, 180)).calibration
            assert np.isfinite(found.K_left).all()


def hand_eye(data: bytes) -> None:
    """A base before the camera: a rotation, and near enough."""
    with _file(data, ".json") as path, contextlib.suppress(CalibrationError):
        found = read_hand_eye(path)
        assert np.allclose(found.T[:3, :3] @ found.T[:3, :3].T, np.eye(3), atol=1e-3)


@contextlib.contextmanager
def _file(data: bytes, ending: str) -> Generator[Path]:
    with tempfile.NamedTemporaryFile(suffix=ending) as file:
        file.write(data)
        file.flush()
        yield Path(file.name)


def _recording() -> bytes:
    name = topic_key("lab", LOG, agent="camera")
    with tempfile.TemporaryDirectory() as folder:
        writer = RecordingWriter(Path(folder) / "a.mcap")
        for number in range(3):
            payload = encode(LogRecord(number, "camera", "main", LogLevel.INFO, "x"))
            writer.write(LOG, Entry(name, 7, number, payload, 1000 + number, 2000 + number))
        writer.close()
        return (Path(folder) / "a.mcap").read_bytes()


def seeds(name: str) -> list[bytes]:
    """What a target reads as it should."""
    header, stamp = CommandHeader("b", 9, "ann"), FrameStamp(1, 5, 5, "c", ECHO)
    point, alive = SetPoint(3, 5, "a1", (0.1, 0.2, 0.1, 0.0, 0.0, 0.0, 0.5)), Alive(4, 5, "a1", ended=True)
    asked = Challenge(5, 4, 1.5, Gate.HELD, pedal=True, arming_id="a1", reason="nobody stands by")
    joints = cdr.joint_state((0.1, 0.2, 0.1, 0.0, 0.0, 0.0), 10**18)
    made: dict[str, Callable[[], list[bytes]]] = {
        "console": lambda: [joints, cdr.joint_state((), 0)],
        "ros": lambda: [joints, crtk.pose_command(np.eye(4), 1), crtk.state_command("pause", 1), crtk.empty()],
        "guarded": lambda: [
            set_point_bytes(key_of("PSM1", SET_POINT), point),
            alive_bytes(key_of("PSM1", ALIVE), alive),
            challenge_bytes(key_of("PSM1", CHALLENGE), asked),
        ],
        "heartbeats": lambda: [
            encode(Heartbeat("psm1", "p1", 9, "a1", 7, 8, pressed=True)),
            encode(Arm(header, "psm1", "p1", 7, pressed=True, segments=4)),
            encode(Hold(header, "psm1")),
            encode(FrameNotice(stamp)),
        ],
        "page": lambda: [
            b'{"kind": "hello", "secret": "s"}',
            b'{"kind": "shown", "frame": 4, "at_ms": 1700000000000.5}',
            b'{"kind": "press", "arm": "psm1", "plan_id": "p1"}',
            b'{"kind": "beat", "challenge": "c"}',
            b'{"kind": "prompt", "pixel": [4.5, 3.25]}',
        ],
        "mcap": lambda: [_recording()],
        "calibration": lambda: [opencv_text(endoscope(320, 180)).encode()],
        "hand_eye": lambda: [json.dumps({"T_camera_base": BASE.tolist(), "unit": "m"}).encode()],
    }
    return made[name]()


TARGETS: dict[str, Callable[[bytes], None]] = {
    target.__name__: target for target in (console, ros, guarded, heartbeats, page, mcap, calibration, hand_eye)
}
