"""The two ends of one hop, each a process: as agents send and receive, with the runtime's own parts.

    python -m benchmarks.hop_ends '{"role": "receive", "endpoint": "tcp/127.0.0.1:7447", "link": "", "load": {...}}'

A frame goes the way of a *latest* topic (ring, receiving thread, inbox, loop), an event that of an *event* topic. The
time begins before the message is encoded and ends when its pixels are NumPy arrays. Both ends read the machine's one
monotonic clock; the sender's readings travel in the message, or are written beside it.
"""

import contextlib
import json
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import zenoh

from schemas.codec import decode
from schemas.messages import FrameStamp, Image, ImageEncoding, LogLevel, LogRecord, StereoFrame
from schemas.topics import FRAMES, LOG, Topic, key
from shared.clock import monotonic_s, processor_s
from shared.images import decode_image
from shared.runtime.attachment import Attachment, beside_of, pack
from shared.runtime.delivery import declare_publisher, payload_of, subscribe
from shared.runtime.intake import Arrival, Inbox
from shared.runtime.process import keep_freed_memory
from shared.runtime.session import SessionSettings, open_session

RIG, AGENT = "hop", "camera"
EVENT_BYTES = 1000
SETTLE_S = 0.5
PATIENCE_S = 5.0
WARM_UP = 20
"""Messages at the beginning that do not count."""


@dataclass(frozen=True)
class Load:
    """What goes over the hop.

    Fields:
        size: width and height of each raw colour image of a frame, in pixels; zeros for an event of 1 kB.
        count: messages that count.
        compressed: bytes of each image where they are compressed, and so looked at by nobody; 0 where they are raw.
    """

    size: tuple[int, int]
    count: int
    rate_hz: float
    compressed: int = 0

    @property
    def is_frame(self) -> bool:
        return self.size[0] > 0

    @property
    def bytes(self) -> int:
        """Of what matters in a message."""
        if not self.is_frame:
            return EVENT_BYTES
        return 2 * (self.compressed or 3 * self.size[0] * self.size[1])

    @property
    def topic(self) -> Topic:
        return FRAMES if self.is_frame else LOG

    @property
    def key(self) -> str:
        return key(RIG, self.topic, agent=AGENT)


@dataclass(frozen=True)
class End:
    """Which end it is, `send` or `receive`, and on which router.

    Fields:
        bare: whether bytes alone go over it, by Zenoh's Python interface and nothing of ours.
    """

    role: str
    endpoint: str
    load: Load
    bare: bool = False

    def to_json(self) -> str:
        """As it is handed to the process."""
        return json.dumps(asdict(self))


def end_of(text: str) -> End:
    given = json.loads(text)
    return End(given["role"], given["endpoint"], Load(**given["load"]), given["bare"])


def main() -> None:
    """Be the end that the first argument describes; readings are printed as one line of JSON."""
    keep_freed_memory()
    end = end_of(sys.argv[1])
    with contextlib.ExitStack() as stack:
        session = stack.enter_context(open_session(SessionSettings(rig=RIG, endpoint=end.endpoint)))
        if end.bare:
            readings = (receive_bare if end.role == "receive" else send_bare)(session, end.load)
        else:
            readings = (receive if end.role == "receive" else send)(session, end.load)
    print(json.dumps(readings), flush=True)


def send(session: Any, load: Load) -> list[dict[str, float]]:
    """Publish at the given rate; of each message when it was begun, encoded and handed to Zenoh, in seconds."""
    publisher = declare_publisher(session, load.key, load.topic)
    message = message_of(load)
    readings: list[dict[str, float]] = []
    for sequence in _paced(load):
        begun_s = monotonic_s()
        payload = payload_of(load.topic, message(sequence))
        encoded_s = monotonic_s()
        publisher.put(payload, attachment=pack(Attachment(1, sequence, 0, 0.0)))
        readings.append({"sequence": sequence, "begun": begun_s, "encoded": encoded_s, "put": monotonic_s()})
        readings[-1]["sender's processor"] = processor_s()
    return readings[WARM_UP:]


def _paced(load: Load) -> Iterator[int]:
    """The number of each message when it is time for it."""
    pause, next_s = threading.Event(), monotonic_s() + SETTLE_S
    for sequence in range(load.count + WARM_UP):
        pause.wait(max(0.0, next_s - monotonic_s()))
        next_s += 1.0 / load.rate_hz
        yield sequence
    pause.wait(SETTLE_S)


def receive(session: Any, load: Load) -> list[dict[str, float]]:
    """Of each message when it was received, taken up by the loop and decoded, in seconds."""
    inbox = Inbox()
    latest = load.is_frame
    received: dict[int, float] = {}

    def put_away(sample: Any) -> None:
        at_s = monotonic_s()
        beside = beside_of(sample, load.key)
        (inbox.put_newest if latest else inbox.put)(Arrival(load.topic, load.key, sample.payload.to_bytes, beside))
        received[_number(beside)] = at_s

    subscriber = subscribe(session, load.key, load.topic, put_away, lambda _: None)
    print("ready", flush=True)
    readings: list[dict[str, float]] = []
    quiet_until_s = monotonic_s() + 4 * PATIENCE_S
    while monotonic_s() < quiet_until_s:
        arrival = inbox.take(0.5)
        if arrival is None:
            continue
        taken_s = monotonic_s()
        _look_at(decode(load.topic.message, arrival.payload()), load)
        decoded_s = monotonic_s()
        sequence = _number(arrival.beside)
        processor = {"receiver's processor": processor_s()}
        readings.append({"sequence": sequence, "taken": taken_s, "decoded": decoded_s, **processor})
        quiet_until_s = decoded_s + (PATIENCE_S if sequence < load.count + WARM_UP - 1 else 0.0)
    subscriber.undeclare()
    return [{**row, "received": received[int(row["sequence"])]} for row in readings if row["sequence"] >= WARM_UP]


def send_bare(session: Any, load: Load) -> list[dict[str, float]]:
    """Publish as many bytes at that rate, made beforehand; of each message when it was begun, in seconds."""
    bulky, key_of_bytes = load.is_frame, load.key
    publisher = session.declare_publisher(
        key_of_bytes,
        congestion_control=zenoh.CongestionControl.DROP if bulky else zenoh.CongestionControl.BLOCK,
        express=not bulky,
    )
    payload, readings = bytes(load.bytes), list[dict[str, float]]()
    for sequence in _paced(load):
        readings.append({"sequence": sequence, "begun": monotonic_s()})
        publisher.put(payload, attachment=sequence.to_bytes(8, "big"))
        readings[-1]["sender's processor"] = processor_s()
    return readings[WARM_UP:]


def receive_bare(session: Any, load: Load) -> list[dict[str, float]]:
    """Of each message when its bytes were there, in seconds: frames out of a ring, events in a callback."""
    came: list[dict[str, float]] = []
    newest, turn = [monotonic_s() + 4 * PATIENCE_S], threading.Event()

    def take(sample: Any) -> None:
        assert len(sample.payload.to_bytes()) == load.bytes
        at_s = monotonic_s()
        came.append({"sequence": int.from_bytes(sample.attachment.to_bytes(), "big"), "decoded": at_s})
        came[-1]["receiver's processor"] = processor_s()
        newest[0] = at_s + PATIENCE_S
        if came[-1]["sequence"] == load.count + WARM_UP - 1:
            turn.set()

    if load.is_frame:
        subscriber = session.declare_subscriber(load.key, zenoh.handlers.RingChannel(1))
        emptying = threading.Thread(target=_empty, args=(subscriber.handler, take), daemon=True)
    else:
        subscriber = session.declare_subscriber(load.key, take)
        emptying = threading.Thread()
    emptying.start()
    print("ready", flush=True)
    while not turn.is_set() and monotonic_s() < newest[0]:
        turn.wait(0.5)
    subscriber.undeclare()
    emptying.join(PATIENCE_S)
    return [row for row in came if row["sequence"] >= WARM_UP]


def _empty(channel: Any, take: Callable[[Any], None]) -> None:
    with contextlib.suppress(zenoh.ZError):
        while True:
            take(channel.recv())


def _number(beside: Attachment | None) -> int:
    assert beside is not None, "the sender's attachment is whole"
    return beside.sequence


def message_of(load: Load) -> Any:
    """A function from a message's number to the message; pixels are those of noise, and made beforehand."""
    if not load.is_frame:
        return lambda sequence: LogRecord(sequence, AGENT, "main", LogLevel.INFO, "x" * EVENT_BYTES)
    width, height = load.size
    encoding = ImageEncoding.JPEG if load.compressed else ImageEncoding.RAW
    random, count = np.random.default_rng(0), load.compressed or width * height * 3
    left, right = (
        Image(encoding, width, height, 3, random.integers(0, 256, count, np.uint8).tobytes()) for _ in range(2)
    )
    return lambda sequence: StereoFrame(FrameStamp(sequence, 0, 0, "none"), left, right)


def _look_at(message: Any, load: Load) -> None:
    if isinstance(message, StereoFrame) and not load.compressed:
        for image in (message.left, message.right):
            assert decode_image(image).shape == (load.size[1], load.size[0], 3)


if __name__ == "__main__":
    main()
