"""Large payloads in shared memory, towards those who share it and those who do not."""

import json
import platform
import subprocess
import sys

import numpy as np
import pytest
import zenoh

from schemas.codec import LARGE_BYTES, decode, encode
from schemas.messages import FrameStamp, Image, ImageEncoding, LogLevel, LogRecord, StereoFrame
from schemas.topics import FRAMES, LOG, key
from shared.runtime.delivery import POOL_BYTES, declare_publisher, joined, payload_of, subscribe
from shared.runtime.process import keep_freed_memory
from shared.runtime.session import open_session


def frame(sequence):
    pixels = np.random.default_rng(sequence).integers(0, 256, LARGE_BYTES, np.uint8).tobytes()
    image = Image(ImageEncoding.RAW, LARGE_BYTES // 64, 64, 1, pixels)
    return StereoFrame(FrameStamp(sequence, 1, 2, "c"), image, image)


def without_shared_memory(endpoint):
    config = zenoh.Config()
    for name, value in {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": False,
    }.items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)


@pytest.mark.parametrize("shares", [True, False], ids=["shared", "by network"])
def test_a_frame_arrives_whole_whether_or_not_memory_is_shared(session, settings, until, shares):
    publisher = declare_publisher(session, key("test", FRAMES), FRAMES)
    with open_session(settings) if shares else without_shared_memory(settings.endpoint) as other:
        heard = []
        kept = subscribe(other, key("test", FRAMES), FRAMES, lambda s: heard.append(s.payload.to_bytes()), print)
        until(lambda: publisher.matching_status.matching)
        sent = frame(1)
        publisher.put(payload_of(FRAMES, sent))
        until(lambda: heard)
        for declared in (*kept, publisher):
            declared.undeclare()
    assert heard == [encode(sent)]
    assert decode(StereoFrame, heard[0]) == sent


UNLOCKED = """
import ctypes, os, resource, sys
CAP_IPC_LOCK, PR_CAPBSET_DROP = 14, 24
ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_IPC_LOCK, 0, 0, 0)
resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
os.execv(sys.executable, [sys.executable, "-c", sys.argv[1], sys.argv[2]])
"""
"""Begins a program that may lock no memory, which takes the right to do so from root as well."""
ASKS = """
import sys
from shared.runtime.session import SessionSettings, open_session
from shared.runtime.delivery import joined
with open_session(SessionSettings("test", sys.argv[1])) as session:
    print(len(session.info.routers_zid()), type(joined([b"x" * 10000])).__name__)
"""


def test_where_no_memory_may_be_shared_a_session_goes_by_network_and_says_so(settings):
    done = subprocess.run(
        [sys.executable, "-c", UNLOCKED, ASKS, settings.endpoint], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["1", "bytes"]
    assert "large messages go by network" in done.stderr
    assert "LimitMEMLOCK" in done.stderr


def test_where_the_pool_is_full_a_payload_is_bytes():
    parts = [b"head", bytes(range(256)) * (1 << 14), np.arange(1 << 20, dtype=np.uint8).data]
    expected = b"".join(parts)
    held = [joined(parts) for _ in range(POOL_BYTES // len(expected) + 2)]
    # the first may be bytes too, while the pool still holds what an earlier test has let go
    kinds = {type(payload) for payload in held}
    assert bytes in kinds
    assert len(kinds) <= 2
    assert all(bytes(payload) == expected for payload in held)
    held.clear()
    assert type(joined(parts)) is not bytes


def test_what_is_small_is_put_as_its_bytes():
    line = LogRecord(1, "camera", "main", LogLevel.INFO, "words")
    assert payload_of(LOG, line) == encode(line)


def test_freed_memory_is_kept_where_the_c_library_can():
    assert keep_freed_memory() is (platform.libc_ver()[0] == "glibc")
