"""What parts of the runtime are worth: one hop with a part left out at a time, beside the whole and bare Zenoh.

    python -m benchmarks.latency --only parts [--rounds 3] [--messages 400]

Parts are left out here, in the processes at either end, and by no option of the product. States are remembered by an
agent that acts on none; what counts of them is the processor's time.
"""

import dataclasses
import os
import sys
import threading
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import zenoh
from rich.console import Console
from rich.table import Table

from benchmarks import hop_ends
from benchmarks.hop_ends import RIG, WARM_UP, End, Load
from benchmarks.hops import between, router
from benchmarks.lost_events import advanced_subscriber, lost_events
from schemas.codec import decode_cutting, encode_joining
from schemas.topics import FRAMES
from shared.clock import processor_s
from shared.runtime import delivery, lossless, session
from shared.runtime.agent import Agent, Command, Input, Received, Reply, Tick
from shared.runtime.attachment import Attachment
from shared.runtime.runner import Runner

WHOLE, BARE, UNREMEMBERED = "nothing left out", "bare Zenoh", "states looked at one by one"
EVENTS, IMAGES, PIXELS, STATES = "1 kB, 1 kHz", "85 kB JPEG, 250 Hz", "2.8 MB raw, 250 Hz", "0.5 kB states, 100 Hz"
LOADS = {
    EVENTS: Load((0, 0), 0, 1000.0),
    IMAGES: Load((960, 540), 0, 250.0, compressed=42_500),
    PIXELS: Load((1280, 360), 0, 250.0),
    STATES: Load((1, 1), 0, 100.0, compressed=250),
}
NEVER = 1 << 62
"""More bytes than any message has."""


def _no_recovery() -> None:
    def publisher(at: Any, name: str, topic: Any) -> Any:
        encoding = delivery.encoding_of(topic.message, name)
        return at.declare_publisher(name, encoding=encoding, congestion_control=zenoh.CongestionControl.BLOCK)

    hop_ends.declare_publisher = publisher
    hop_ends.subscribe = lambda at, name, _topic, receive, _missed: at.declare_subscriber(name, receive)


def _nothing_beside() -> None:
    """Eight bytes tell messages apart, as of bare Zenoh; no key is named, and none looked at."""
    hop_ends.pack = lambda beside: beside.sequence.to_bytes(8, "big")
    hop_ends.beside_of = lambda sample, _: Attachment(0, int.from_bytes(sample.attachment.to_bytes(), "big"), 0, 0.0)
    delivery.encoding_of = lambda *_: None
    delivery.other_key = lossless.other_key = lambda *_: ""


def _framed_by_protobuf() -> None:
    hop_ends.payload_of = lambda _topic, message: encode_joining(message, NEVER)
    hop_ends.decode = lambda kind, data: decode_cutting(kind, data, NEVER)


LACKS: dict[str, tuple[Callable[[], Any], tuple[str, ...]]] = {
    WHOLE: (lambda: None, tuple(LOADS)),
    BARE: (lambda: None, (EVENTS, IMAGES, PIXELS)),
    "no recovery": (_no_recovery, (EVENTS,)),
    "Zenoh's own recovery": (lambda: setattr(delivery, "LosslessSubscriber", advanced_subscriber), (EVENTS,)),
    "no number and key beside": (_nothing_beside, (EVENTS, IMAGES, PIXELS)),
    "no shared memory": (
        lambda: session.COMMON.update({"transport/shared_memory/enabled": False}),
        (EVENTS, IMAGES, PIXELS),
    ),
    "copied to shared memory by Zenoh": (lambda: setattr(delivery, "joined", b"".join), (IMAGES, PIXELS)),
    "a pool for 24 frames": (lambda: setattr(delivery, "POOL_MESSAGES", 24), (PIXELS,)),
    "large fields framed by protobuf": (_framed_by_protobuf, (IMAGES, PIXELS)),
    UNREMEMBERED: (lambda: None, (STATES,)),
}
"""What is left out, and of which loads."""


def _remembering(lack: str) -> Callable[[Any, Load], list[dict[str, float]]]:
    def remember(at: Any, load: Load) -> list[dict[str, float]]:
        """Run an agent until it was fed the last state; of each that it was fed, what the processor had done."""
        rows, over, last = list[dict[str, float]](), threading.Event(), load.count + WARM_UP - 1

        class Listener(Agent):
            kind, tick_hz = "listener", 1.0
            inputs = (Input(FRAMES, only_newest_counts=True, only_remembered=lack != UNREMEMBERED),)

            def step(self, arrived: Received | Tick | Command) -> Iterable[Reply]:
                if isinstance(arrived, Received):
                    row = {"sequence": arrived.sequence, "decoded": np.nan, "receiver's processor": processor_s()}
                    rows.append(row)
                    if arrived.sequence == last:
                        over.set()
                return ()

        runner = Runner(Listener(), at, RIG)
        thread = threading.Thread(target=runner.run)
        thread.start()
        print("ready", flush=True)
        over.wait(2 * hop_ends.PATIENCE_S + last / load.rate_hz)
        runner.stop()
        thread.join()
        return [row for row in rows if row["sequence"] >= WARM_UP]

    return remember


def measure_parts(rounds: int, count: int) -> dict[str, Any]:
    """By load and lack: median hop, processor of both ends a message (ms), how many arrived; and lost events."""
    taken: dict[tuple[str, str], list[tuple[float, float, int]]] = {}
    load_before = os.getloadavg()[0]
    with router() as endpoint:
        for _ in range(rounds):
            for name, load in LOADS.items():
                for lack in (lack for lack, (_, loads) in LACKS.items() if name in loads):
                    counted = dataclasses.replace(load, count=count)
                    ends = (End(role, endpoint, counted, lack == BARE) for role in ("receive", "send"))
                    rows = between(*ends, program=("benchmarks.parts", lack))
                    taken.setdefault((name, lack), []).append(_summary(rows))
    rows = [(*place, *map(float, np.median(found, axis=0))) for place, found in taken.items()]
    run = {"load before": load_before, "rounds": rounds, "messages": count}
    return {**run, "parts": rows, "lost events": lost_events()}


def _summary(rows: list[dict[str, float]]) -> tuple[float, float, int]:
    if not rows:
        return np.nan, np.nan, 0
    hops = [1e3 * (row["decoded"] - row["begun"]) for row in rows]
    spent_s = sum(rows[-1][f"{end}'s processor"] - rows[0][f"{end}'s processor"] for end in ("sender", "receiver"))
    return float(np.median(hops)), 1e3 * spent_s / (rows[-1]["sequence"] - rows[0]["sequence"] or np.nan), len(rows)


def print_parts(console: Console, measured: dict[str, Any]) -> None:
    """One line for each load and lack, with its ratios to bare Zenoh and to the whole."""
    table = Table("load", "left out", "hop p50, ms", "to bare", "to whole", "processor, ms", "to whole", "arrived")
    of = {(load, lack): (hop, spent) for load, lack, hop, spent, _ in measured["parts"]}
    for load, lack, hop, spent, arrived in measured["parts"]:
        whole, bare = of[load, WHOLE], of.get((load, BARE), (np.nan, np.nan))
        told = (
            f"{hop:.3f}",
            f"{hop / bare[0]:.2f}",
            f"{hop / whole[0]:.2f}",
            f"{spent:.3f}",
            f"{spent / whole[1]:.2f}",
        )
        table.add_row(load, lack, *told, f"{arrived:.0f}")
    run = f"{measured['rounds']} rounds of {measured['messages']} messages"
    console.print(f"{run}, load {measured['load before']:.1f} before the start")
    console.print(table)
    console.print(f"over killed routers and links that are cut: {measured['lost events']}")


def main() -> None:
    """Be one end of a hop, as `benchmarks.hop_ends` is, without what the first argument names."""
    lack = sys.argv.pop(1)
    LACKS[lack][0]()
    if hop_ends.end_of(sys.argv[1]).load.rate_hz == LOADS[STATES].rate_hz:
        hop_ends.receive = _remembering(lack)
    hop_ends.main()


if __name__ == "__main__":
    main()
