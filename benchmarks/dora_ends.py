"""The two ends of the same hop in dora-rs: this file is run by dora's own Python and imports nothing of ours.

An array of bytes goes from one node to another, begun when it is handed over and ended when it is a NumPy array. There
is no codec and no check: that is what dora-rs needs for the payload alone.
"""

import json
import os
import sys
import time  # noqa: TID251  dora's Python has no shared/clock.py
from typing import Any

WARM_UP, SETTLE_S = 20, 1.5


def send(node: Any, bytes_each: int, count: int, rate_hz: float) -> None:
    """Send an array of that many bytes again and again."""
    import numpy as np
    import pyarrow as pa

    pixels = pa.array(np.random.default_rng(0).integers(0, 256, bytes_each, np.uint8))
    time.sleep(SETTLE_S)
    next_s = time.monotonic()
    for sequence in range(count + WARM_UP):
        next_s += 1.0 / rate_hz
        time.sleep(max(0.0, next_s - time.monotonic()))
        node.send_output("data", pixels, {"sequence": sequence, "begun_ns": time.monotonic_ns()})


def receive(node: Any, bytes_each: int, readings: str) -> None:
    """Write how many milliseconds each took, one a line of JSON."""
    ms: list[float] = []
    for event in node:
        if event["type"] == "STOP":
            break
        if event["type"] == "INPUT":
            pixels = event["value"].to_numpy(zero_copy_only=True)
            took_ms = (time.monotonic_ns() - event["metadata"]["begun_ns"]) * 1e-6
            if pixels.size == bytes_each and event["metadata"]["sequence"] >= WARM_UP:
                ms.append(took_ms)
    with open(readings, "w") as file:  # noqa: PTH123
        json.dump(ms, file)


if __name__ == "__main__":
    # only dora's own Python has it
    from dora import Node  # pyright: ignore[reportMissingImports]

    given = json.loads(os.environ["HOP"])
    if sys.argv[1:] == ["send"]:
        send(Node(), given["bytes"], given["count"], given["rate_hz"])
    else:
        receive(Node(), given["bytes"], given["readings"])
