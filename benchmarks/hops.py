"""One hop from process to process, step by step: through our router, and beside dora-rs.

What is Zenoh's and its Python interface's own shows in a row of the same bytes without anything of ours.

Rounds take turns, so that whatever else the machine does meets all of them; of each the median of the rounds counts.

dora-rs is installed into a virtual environment of its own, and run for the same payload at the same rate.
"""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.hop_ends import End, Load
from shared.runtime.session import free_local_endpoint

LIMIT_S = 120.0
SIZES = {"1 kB": (0, 0), "1.5 MB": (720, 360), "2.8 MB": (1280, 360)}
"""A log record, which is an event, and stereo frames of raw colour images of that size."""
CAMERA_HZ = 60.0
"""About a camera's rate: processors fall asleep and caches go cold between two messages."""
QUICK_HZ = {"1 kB": 1000.0, "1.5 MB": 250.0, "2.8 MB": 250.0}
"""Neither happens: published figures of such systems are usually taken so."""
ROUTER, BARE, DORA = "router", "bare Zenoh", "dora-rs"
STEPS = {
    "encode": ("begun", "encoded"),
    "put": ("encoded", "put"),
    "travel": ("encoded", "received"),
    "hand over": ("received", "taken"),
    "decode": ("taken", "decoded"),
    "hop": ("begun", "decoded"),
}
"""Travelling begins with the put, which therefore does not count twice."""

ROUTER_PROGRAM = """
import sys
from shared.runtime.session import open_router
with open_router(sys.argv[1]):
    print("up", flush=True)
    sys.stdin.read()
"""


def measure_hops(rounds: int, count: int) -> dict[str, Any]:
    """Milliseconds by rate, payload, way and step: medians over rounds of p50 and p99, and how many messages came."""
    try:
        environment, without = dora_environment(), ""
    except NoDoraError as error:
        environment, without = None, str(error)
    taken: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    load_before = os.getloadavg()[0]
    with router() as endpoint:
        for _ in range(rounds):
            for payload, size in SIZES.items():
                for rate_hz in (CAMERA_HZ, QUICK_HZ[payload]):
                    load = Load(size, count, rate_hz)
                    place = f"{rate_hz:.0f} Hz", payload
                    taken.setdefault((*place, ROUTER), []).append(_summary(one_hop(endpoint, load)))
                    taken.setdefault((*place, BARE), []).append(_summary_of_hop(bare_ms(endpoint, load)))
                    if environment is not None:
                        ms = dora_ms(environment, load)
                        taken.setdefault((*place, DORA), []).append(_summary_of_hop(ms))
    rows = [
        {"rate": rate, "payload": payload, "way": way, **_over_rounds(summaries)}
        for (rate, payload, way), summaries in taken.items()
    ]
    return {"load before": load_before, "rounds": rounds, "messages": count, "without dora": without, "hops": rows}


def one_hop(endpoint: str, load: Load) -> list[dict[str, float]]:
    """Of each message that arrived, in seconds, when it reached each step."""
    return between(*(End(role, endpoint, load) for role in ("receive", "send")))


def bare_ms(endpoint: str, load: Load) -> list[float]:
    """Milliseconds of each hop of as many bytes by Zenoh's Python interface alone, by way of the router."""
    rows = between(*(End(role, endpoint, load, bare=True) for role in ("receive", "send")))
    return [1e3 * (row["decoded"] - row["begun"]) for row in rows]


def between(*ends: End, program: tuple[str, ...] = ("benchmarks.hop_ends",)) -> list[dict[str, float]]:
    """What a receiving and a sending end read of each message that arrived, both run by a module."""
    receiver = _end(ends[0], program)
    assert receiver.stdout is not None
    assert receiver.stdout.readline() == "ready\n", "the receiving end has not started"
    sent, _ = _end(ends[1], program).communicate(timeout=LIMIT_S)
    received, _ = receiver.communicate(timeout=LIMIT_S)
    of_sender = {row["sequence"]: row for row in json.loads(sent)}
    return [of_sender[row["sequence"]] | row for row in json.loads(received)]


@contextlib.contextmanager
def router(endpoint: str = "") -> Generator[str]:
    """The endpoint of a router that is a process of its own; it is killed in the end."""
    endpoint = endpoint or free_local_endpoint()
    command = [sys.executable, "-c", ROUTER_PROGRAM, endpoint]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n", "the router has not started"
        try:
            yield endpoint
        finally:
            process.kill()


def _end(end: End, program: tuple[str, ...]) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", *program, end.to_json()]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def _summary(rows: list[dict[str, float]]) -> dict[str, Any]:
    steps = {name: [1e3 * (row[end] - row[begin]) for row in rows] for name, (begin, end) in STEPS.items()}
    return {"arrived": len(rows), **{name: _percentiles(ms) for name, ms in steps.items()}}


def _summary_of_hop(ms: list[float]) -> dict[str, Any]:
    return {"arrived": len(ms), "hop": _percentiles(ms)}


def _percentiles(ms: list[float]) -> dict[str, float]:
    # on a busy machine nothing at all may have come
    p50, p99 = np.percentile(ms, (50, 99)) if ms else (np.nan, np.nan)
    return {"p50 ms": float(p50), "p99 ms": float(p99)}


def _over_rounds(summaries: list[dict[str, Any]]) -> dict[str, Any]:
    steps = [name for name in STEPS if name in summaries[0]]
    return {
        "arrived": [summary["arrived"] for summary in summaries],
        **{
            name: {p: float(np.nanmedian([s[name][p] for s in summaries])) for p in ("p50 ms", "p99 ms")}
            for name in steps
        },
    }


def print_hops(console: Console, measured: dict[str, Any]) -> None:
    """One line for each rate, payload and way, with each step's median and the ratio to dora-rs in the same run."""
    table = Table("rate", "payload", "way", *(f"{step} p50" for step in STEPS), "hop p99", "to dora-rs", "arrived")
    table.title, table.title_justify = "one hop, ms", "left"
    for row in measured["hops"]:
        medians = [f"{row[step]['p50 ms']:.2f}" if step in row else "" for step in STEPS]
        ratio = _ratio_to_dora(row, measured["hops"])
        arrived = " ".join(map(str, row["arrived"]))
        table.add_row(row["rate"], row["payload"], row["way"], *medians, f"{row['hop']['p99 ms']:.2f}", ratio, arrived)
    run = f"{measured['rounds']} rounds of {measured['messages']} messages"
    console.print(f"{run}, load {measured['load before']:.1f} before the start")
    console.print(table)
    if measured["without dora"]:
        console.print(f"without dora-rs to compare with: {measured['without dora']}")


def _ratio_to_dora(row: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    same = [r for r in rows if r["way"] == DORA and (r["rate"], r["payload"]) == (row["rate"], row["payload"])]
    return f"{row['hop']['p50 ms'] / same[0]['hop']['p50 ms']:.2f}" if same and row["way"] != DORA else ""


PACKAGES = ("dora-rs==1.1.0", "dora-rs-cli==1.1.0", "pyarrow", "numpy")
INSTALL_LIMIT_S = 300.0
NEWEST, EVERY = 1, 1000
"""Messages that wait at dora's receiver: as ours, of frames the newest counts, and of events each one."""
ENDS = Path(__file__).with_name("dora_ends.py")


class NoDoraError(RuntimeError):
    """dora-rs cannot be had or does not run here; the text says why."""


def dora_environment() -> Path:
    """The folder of a virtual environment with dora-rs, made when first asked for and kept in the user's cache.

    Raises:
        NoDoraError: where its packages cannot be installed.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = cache / "suturegrasp" / "dora-1.1.0"
    done = folder / "done"
    if done.exists():
        return folder
    try:
        _run([sys.executable, "-m", "venv", str(folder)])
        _run([str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet", *PACKAGES])
    except (OSError, subprocess.SubprocessError) as error:
        said = getattr(error, "stderr", "") or str(error)
        raise NoDoraError(f"dora-rs cannot be installed: {said.strip().splitlines()[-1]}") from error
    done.touch()
    return folder


def dora_ms(environment: Path, load: Load) -> list[float]:
    """Milliseconds of each hop between two Python nodes of dora-rs.

    Raises:
        NoDoraError: where its dataflow fails.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        readings = folder / "readings.json"
        given = {"bytes": load.bytes, "count": load.count, "rate_hz": load.rate_hz, "readings": str(readings)}
        (folder / "flow.yml").write_text(json.dumps(_dataflow(json.dumps(given), NEWEST if load.is_frame else EVERY)))
        path = os.pathsep.join((str(environment / "bin"), os.environ["PATH"]))
        try:
            _run([str(environment / "bin" / "dora"), "run", "flow.yml"], folder, os.environ | {"PATH": path})
            return json.loads(readings.read_text())
        except (OSError, subprocess.SubprocessError) as error:
            raise NoDoraError(f"dora-rs does not run here: {error}") from error


def _dataflow(given: str, waiting: int) -> dict[str, object]:
    """Two nodes; JSON is YAML too."""
    common = {"path": str(ENDS), "env": {"HOP": given}}
    of = {"data": {"source": "send/data", "queue_size": waiting}}
    send = common | {"id": "send", "args": "send", "outputs": ["data"]}
    return {"nodes": [send, common | {"id": "receive", "args": "receive", "inputs": of}]}


def _run(command: list[str], folder: Path | None = None, environment: dict[str, str] | None = None) -> None:
    subprocess.run(
        command, check=True, cwd=folder, env=environment, capture_output=True, text=True, timeout=INSTALL_LIMIT_S
    )
