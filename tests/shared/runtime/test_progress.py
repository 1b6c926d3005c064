"""Consumers tell how far they have got."""

from typing import Any

from schemas.codec import encode
from schemas.messages import Consumed, FrameStamp, Image, ImageEncoding, StereoFrame
from schemas.topics import FRAMES, LOG, key
from shared.runtime.agent import Agent, Input
from shared.runtime.attachment import Attachment, pack
from shared.runtime.delivery import declare_publisher
from shared.runtime.progress import ask_progress, matches
from shared.runtime.taps import tap

IMAGE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))
FRAME = encode(StereoFrame(FrameStamp(0, 0, 0, ""), IMAGE, IMAGE))
NAME = key("test", FRAMES)


class Perception(Agent):
    """Looks at frames."""

    kind, instance, inputs, outputs, commands, tick_hz = "perception", "main", (Input(FRAMES),), (), (), None

    def step(self, arrived: Any):
        return ()


def test_an_agent_and_a_listener_tell_what_they_are_done_with_readable_or_not(running, session, until):
    kept = tap(session, "test", (FRAMES, LOG), lambda _: None, lambda *_: None)
    running(Perception())
    until(lambda: "perception/main" in ask_progress(session, "test"))
    publisher = declare_publisher(session, NAME, FRAMES, waits=True)
    said = {}
    for number, payload in enumerate((FRAME, b"\xff", FRAME, b"\xff")):

        def done(number=number, payload=payload):
            # whoever has just declared a subscription may miss the first one
            publisher.put(payload, attachment=pack(Attachment(5, number, 0, 0.0)))
            said = ask_progress(session, "test")
            return all(Consumed(NAME, 5, number) in progress.handled for progress in said.values()) and said

        said = until(done)
    taps = [name for name in said if name.startswith("tap/")]
    assert sorted(said) == ["perception/main", *taps]
    assert said["perception/main"].listens == NAME
    assert said[taps[0]].listens.split() == ["suturegrasp/test/camera/*/frames", "suturegrasp/test/*/*/log"]
    for declared in (*kept, publisher):
        declared.undeclare()
    until(lambda: list(ask_progress(session, "test")) == ["perception/main"])


def test_a_star_stands_for_one_part_of_a_key():
    assert matches("a/b/c", "a/b/c")
    assert matches("a/*/c", "a/b/c")
    for selector, name in (("a/*/c", "a/b/d"), ("a/*", "a/b/c"), ("a/*/c/d", "a/b/c")):
        assert not matches(selector, name)
