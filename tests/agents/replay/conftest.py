"""A recording of two seconds for all tests of this folder, made without running anything."""

from types import SimpleNamespace

import pytest

from schemas.codec import encode, encoding_name
from schemas.messages import CommandHeader, CommandRecord, FrameStamp, Image, ImageEncoding, Prompt, StereoFrame
from schemas.topics import CALIBRATION, COMMANDS, FRAMES, HEALTH, LOG, PLAN, PROMPT, ROBOT_STATE, THREAD, key
from shared.recording.mcap_file import Entry, RecordingWriter
from shared.runtime.commands import accepted

BEGIN_NS = 1_700_000_000 * 10**9
MS = 10**6
SECONDS = 2
IMAGE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))
FOREIGN = "suturegrasp/recorded/somebody/main/whatever"


def frame(number, at_ns):
    return encode(StereoFrame(FrameStamp(number, at_ns, at_ns, ""), IMAGE, IMAGE))


def prompt_record(at_ns):
    """The record of a prompt, as perception leaves it once the prompt is carried out."""
    prompt = Prompt(CommandHeader("p1", at_ns + 2 * 10**9, "a test"), None)
    return encode(CommandRecord(str(PROMPT), encoding_name(Prompt), encode(prompt), at_ns, accepted("p1")))


def recorded_entries():
    """Frames at 20 Hz, the arm's state at 100 Hz, threads at 10 Hz, a little of everything else, and a foreign key."""
    rig, rows = "recorded", []
    for topic, period, instance in ((FRAMES, 50, "main"), (ROBOT_STATE, 10, "psm1"), (THREAD, 100, "main")):
        for number, ms in enumerate(range(5, SECONDS * 1000, period)):
            payload = frame(number, BEGIN_NS + ms * MS) if topic is FRAMES else f"{topic} {number}".encode()
            rows.append((ms, topic, key(rig, topic, instance), number, payload))
    rows.append((1, CALIBRATION, key(rig, CALIBRATION), 0, b"calibration"))
    rows += [(100 * n, LOG, key(rig, LOG, agent="camera"), n, f"line {n}".encode()) for n in range(20)]
    rows += [(500 * n, HEALTH, key(rig, HEALTH, agent="perception"), n, b"well") for n in range(4)]
    rows.append((700, PLAN, key(rig, PLAN), 0, b"a plan"))
    rows.append((900, COMMANDS, key(rig, COMMANDS, agent="perception"), 0, prompt_record(BEGIN_NS + 800 * MS)))
    rows.append((950, LOG, FOREIGN, 0, b"?"))
    for ms, topic, name, number, payload in sorted(rows, key=lambda row: row[0]):
        at_ns = BEGIN_NS + ms * MS
        yield topic, Entry(name, 7, number, payload, at_ns - MS, at_ns)


@pytest.fixture(scope="session")
def recording(tmp_path_factory):
    """The recording's path, what it holds in order, and its first moment."""
    path = tmp_path_factory.mktemp("recorded") / "session.mcap"
    writer = RecordingWriter(path)
    for number, (topic, entry) in enumerate(recorded_entries()):
        writer.write(topic, entry)
        # so that damage of one part leaves those before it
        if number % 40 == 39:
            writer.flush()
    writer.close()
    return SimpleNamespace(path=path, entries=[entry for _, entry in recorded_entries()], begin_ns=BEGIN_NS)
