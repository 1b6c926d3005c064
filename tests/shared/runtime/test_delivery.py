"""Each delivery class behind a real router, with receivers that are late, slow, cut off, or share no memory."""

import contextlib
import dataclasses
import functools
import json
import subprocess
import sys

import numpy as np
import pytest
import zenoh

from schemas.codec import LARGE_BYTES, decode, encode
from schemas.messages import FrameStamp, Image, ImageEncoding, StereoFrame
from schemas.topics import CALIBRATION, FRAMES, PLAN, key
from shared.runtime.delivery import POOL_MESSAGES, declare_publisher, joined, payload_of, subscribe
from shared.runtime.session import SessionSettings, open_router, open_session

DEADLINE_S = 60.0
FRAME_KEY, PLAN_KEY = key("test", FRAMES), key("test", PLAN)


@pytest.fixture
def publish(session, keep):
    """Publishes on a topic."""
    publisher = functools.cache(lambda topic: keep(declare_publisher(session, key("test", topic), topic)))
    return lambda topic, payload: publisher(topic).put(payload)


@pytest.fixture
def listen(receiver, keep):
    """Hears a topic: a list of payloads, and one of reported misses."""

    def start(topic):
        heard, missed = [], []
        take = lambda sample: heard.append(sample.payload.to_bytes())  # noqa: E731
        keep(subscribe(receiver, key("test", topic), topic, take, missed.append))
        return heard, missed

    return start


def test_a_late_joiner_gets_the_last_state_the_kept_events_and_nothing_old_else(publish, listen, until, monkeypatch):
    # a publisher that has been silent for long tells of itself by its token alone
    monkeypatch.setattr("shared.runtime.delivery.MISS_HEARTBEAT_S", 10 * DEADLINE_S)
    (states, _), (frames, _) = listen(CALIBRATION), listen(FRAMES)
    more = dataclasses.replace(PLAN, kept=PLAN.kept + 500)
    sent = [number.to_bytes(2, "big") for number in range(PLAN.kept + 200)]
    for payload in sent:
        publish(more, payload)
    for number in range(5):
        publish(CALIBRATION, bytes([number]))
    # what is still on its way to the router would be new to whoever joins meanwhile
    until(lambda: b"\x04" in states)
    until(lambda: publish(FRAMES, b"old") or frames)
    publish(FRAMES, b"the last of the old")
    until(lambda: frames[-1] == b"the last of the old")
    (states, _), (frames, _), (plans, missed), (of_table, _) = (listen(t) for t in (CALIBRATION, FRAMES, more, PLAN))
    until(lambda: states)
    publish(CALIBRATION, b"new")
    until(lambda: b"new" in states)
    until(lambda: publish(FRAMES, b"new") or b"new" in frames)
    assert (states, set(frames)) == ([b"\x04", b"new"], {b"new"})
    until(lambda: len(plans) == len(sent) and of_table and of_table[-1] == sent[-1])
    assert (plans, missed, of_table) == (sent, [], sent[-PLAN.kept :])


def test_events_survive_a_restart_of_the_router_in_order_and_without_a_hole(router, until):
    heard, missed = [], []
    with contextlib.ExitStack() as stack:
        routing = contextlib.ExitStack()
        stack.push(routing)
        endpoint = routing.enter_context(router())
        sender, receiver = (stack.enter_context(open_session(SessionSettings("test", endpoint))) for _ in range(2))
        publisher = declare_publisher(sender, PLAN_KEY, PLAN)
        kept = subscribe(receiver, PLAN_KEY, PLAN, lambda s: heard.append(int(s.payload.to_string())), missed.append)
        publisher.put("0")
        until(lambda: heard == [0])
        routing.close()
        for number in range(1, 20):
            publisher.put(str(number))
        with open_router(endpoint):
            until(lambda: len(heard) == 20)
            for declared in (kept, publisher):
                declared.undeclare()
    assert (heard, missed) == (list(range(20)), [])


def without_shared_memory(endpoint):
    config = zenoh.Config()
    settings = {"mode": "client", "connect/endpoints": [endpoint], "scouting/multicast/enabled": False}
    for name, value in (settings | {"transport/shared_memory/enabled": False}).items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)


@pytest.mark.parametrize("shares", [True, False], ids=["shared", "by network"])
def test_a_frame_arrives_whole_whether_or_not_memory_is_shared(session, settings, keep, until, shares):
    publisher, heard = keep(declare_publisher(session, FRAME_KEY, FRAMES)), []
    pixels = np.random.default_rng(1).integers(0, 256, LARGE_BYTES, np.uint8).tobytes()
    image = Image(ImageEncoding.RAW, LARGE_BYTES // 64, 64, 1, pixels)
    sent = StereoFrame(FrameStamp(1, 1, 2, "c"), image, image)
    with open_session(settings) if shares else without_shared_memory(settings.endpoint) as other:
        kept = subscribe(other, FRAME_KEY, FRAMES, lambda s: heard.append(s.payload.to_bytes()), print)
        until(lambda: publisher.matching_status.matching)
        publisher.put(payload_of(FRAMES, sent))
        until(lambda: heard)
        kept.undeclare()
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


def test_where_the_pool_is_full_a_payload_is_bytes():
    parts = [b"head", bytes(range(256)) * (1 << 14), np.arange(1 << 20, dtype=np.uint8).data]
    expected = b"".join(parts)
    held = [joined(parts) for _ in range(2 * POOL_MESSAGES + 1)]
    # the first may be bytes too, while the pool still holds what an earlier test has let go
    assert bytes in {type(payload) for payload in held}
    assert all(bytes(payload) == expected for payload in held)
    held.clear()
    assert type(joined(parts)) is not bytes
