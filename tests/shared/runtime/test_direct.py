"""Images past the router: none comes twice, and they come through the router where the link is missing."""

import contextlib
import itertools
import subprocess
import sys

import pytest

from schemas.topics import CALIBRATION, FRAMES, key
from shared.runtime.accounts import RingLosses
from shared.runtime.attachment import Attachment, pack, unpack
from shared.runtime.delivery import declare_publisher, ring_room
from shared.runtime.direct import (
    DirectLinks,
    DirectPublisher,
    open_direct_consuming,
    open_direct_publishing,
    socket_endpoint,
    subscribe_directly,
)
from shared.runtime.session import open_session

KEY = key("test", FRAMES)
PUBLISHING = """
import sys
from schemas.topics import FRAMES, key
from shared.runtime.direct import DirectPublisher, open_direct_publishing
from shared.runtime.session import SessionSettings, open_session
with open_session(SessionSettings("test", sys.argv[1])) as routed, open_direct_publishing(sys.argv[2]) as direct:
    publisher = DirectPublisher(routed, direct, key("test", FRAMES), FRAMES)
    for line in sys.stdin:
        payload, attachment = line.split()
        publisher.put(payload.encode(), bytes.fromhex(attachment))
"""


@pytest.fixture
def endpoint(tmp_path):
    return socket_endpoint(tmp_path / "sockets", "camera", "main")


@pytest.fixture
def consumer(settings, endpoint):
    """What is heard, as (epoch, sequence), and the losses that are told."""
    heard, losses = [], RingLosses(ring_room(KEY))

    def receive(sample):
        beside = unpack(sample.attachment.to_bytes())
        assert beside is not None
        heard.append((beside.epoch, beside.sequence))

    with open_session(settings) as routed, open_direct_consuming([endpoint]) as direct:
        kept = subscribe_directly(routed, direct, KEY, FRAMES, receive, losses)
        yield heard, losses
        for declared in kept:
            declared.undeclare()


class Told:
    """A publisher in another process, which is told what to publish."""

    def __init__(self, process):
        self._input = process.stdin

    def put(self, payload, attachment):
        self._input.write(f"{payload.decode()} {attachment.hex()}\n")
        self._input.flush()


@contextlib.contextmanager
def linked(session, endpoint):
    with open_direct_publishing(endpoint) as direct:
        publisher = DirectPublisher(session, direct, KEY, FRAMES)
        yield publisher
        publisher.undeclare()


def grown(heard, by):
    already = len(heard)
    return lambda: len(heard) >= already + by


def publish_until(publisher, numbers, condition, until, epoch=1):
    """Publish one after another until something holds."""

    def publish_and_look():
        publisher.put(b"pixels", attachment=pack(Attachment(epoch, next(numbers), 0, 0.0)))
        return condition()

    until(publish_and_look)


def test_what_loses_its_link_is_heard_through_the_router_and_by_the_link_again_and_nothing_twice(
    session, endpoint, consumer, until
):
    heard, losses = consumer
    numbers, by_router = itertools.count(), declare_publisher(session, KEY, FRAMES)
    for _ in range(2):
        with linked(session, endpoint) as publisher:
            publish_until(publisher, numbers, lambda: heard and not by_router.matching_status.matching, until)
            publish_until(publisher, numbers, grown(heard, 20), until)
        publish_until(by_router, numbers, grown(heard, 5), until)
    assert heard == sorted(set(heard))
    assert losses.lost + losses.overwritten <= heard[-1][1] - heard[0][1] + 1 - len(heard)
    by_router.undeclare()


@pytest.mark.slow
def test_a_publisher_that_was_killed_is_heard_again_when_it_is_back(settings, endpoint, consumer, until):
    heard, _ = consumer
    for epoch in (1, 2):
        command = [sys.executable, "-c", PUBLISHING, settings.endpoint, endpoint]
        with subprocess.Popen(command, stdin=subprocess.PIPE, text=True) as process:
            publish_until(Told(process), itertools.count(), grown(heard, 20), until, epoch)
            process.kill()
    assert {epoch for epoch, _ in heard} == {1, 2}
    assert heard == sorted(set(heard))


def test_nobody_else_may_enter_the_folder_of_the_sockets(endpoint, tmp_path):
    assert (tmp_path / "sockets").stat().st_mode & 0o777 == 0o700
    assert endpoint.startswith("unixsock-stream/")


def test_the_links_of_two_agents_carry_frames_past_the_router_and_all_else_through_it(session, tmp_path, until):
    camera, perception = (DirectLinks(tmp_path / "sockets", kind, "main") for kind in ("camera", "perception"))
    heard, told, calibration = [], [], key("test", CALIBRATION)
    kept = perception.subscribe(session, KEY, FRAMES, lambda s: heard.append(bytes(s.payload)), print)
    kept += perception.subscribe(session, calibration, CALIBRATION, lambda s: told.append(bytes(s.payload)), print)
    frames, state = camera.publisher(session, KEY, FRAMES), camera.publisher(session, calibration, CALIBRATION)
    by_router, numbers = declare_publisher(session, KEY, FRAMES), itertools.count()
    publish_until(frames, numbers, lambda: heard and not by_router.matching_status.matching, until)
    publish_until(frames, numbers, grown(heard, 5), until)
    state.put(b"calibrated", attachment=pack(Attachment(1, 0, 0, 0.0)))
    until(lambda: told == [b"calibrated"])
    for declared in (*kept, frames, state, by_router):
        declared.undeclare()
    for links in (perception, camera):
        links.close()
