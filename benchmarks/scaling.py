"""Ten rigs on one router, a link that is too narrow, two sites, and a central recorder: what each costs, what breaks.

    python -m benchmarks.scaling [--rigs 1 2 5 10] [--seconds 10] [--only bytes rigs narrow sites recorder]
        [--session SESSION] [--json out/scaling.json]

A rig is two processes: one publishes what its agents publish, by the runtime's own delivery classes, with the payloads
of a recorded session at the rates of the topic table; one hears what its agents hear. The router is a third. All
share this machine's processors, so what they take counts, and ratios, more than what is still well at which number.
Namespaces, for the narrow link and the two sites, need root.
"""

import json
import os
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro
from rich.box import MARKDOWN
from rich.console import Console
from rich.table import Table

from agents.cli.lab.rehearsal.network import CannotError
from benchmarks.scaling_load import AUDIENCES, SESSION, rate_hz, streams
from benchmarks.scaling_narrow import measure_narrow
from benchmarks.scaling_record import measure_recorder
from benchmarks.scaling_rigs import WAYS, measure
from benchmarks.scaling_sites import measure_sites
from schemas.codec import decode
from schemas.messages import StereoFrame
from schemas.topics import FRAMES

CONSOLE = Console(width=220)
Part = Literal["bytes", "rigs", "narrow", "sites", "recorder"]
GIGABIT_MB = 117
"""Of payload a second, each way: 1448 of every 1538 bytes on the wire are TCP payload."""
SHOWN_TOPICS = ("camera/frames", "perception/observations", "reconstruction/thread", "robot_bridge/state")


@dataclass(frozen=True)
class Options:
    """What to measure, and how long each run counts.

    Fields:
        narrow_rigs, megabits: of the link that is too narrow.
        recorded_rigs: how many rigs one recorder records.
        session: whose payloads are sent; docs/example/session.mcap where unset.
    """

    only: tuple[Part, ...] = ("bytes", "rigs", "narrow", "sites", "recorder")
    rigs: tuple[int, ...] = (1, 2, 5, 10)
    seconds: float = 10.0
    narrow_rigs: tuple[int, ...] = (1, 2, 3)
    megabits: int = 100
    recorded_rigs: tuple[int, ...] = (1, 5, 10)
    session: Path | None = None
    json: Path | None = None


def main() -> None:
    """Measure, print tables, and write JSON where asked to."""
    options = tyro.cli(Options)
    if options.session:
        os.environ[SESSION] = str(options.session)
    measured: dict[str, Any] = {}
    CONSOLE.print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before the start")
    with tempfile.TemporaryDirectory() as folder:
        for part in options.only:
            try:
                measured[part] = _measured(part, options, Path(folder))
            except CannotError as error:
                CONSOLE.print(f"{part} was left out: {error}")
                continue
            PRINT[part](measured[part])
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(measured, indent=1) + "\n")


def _measured(part: Part, options: Options, folder: Path) -> list[dict[str, Any]]:
    match part:
        case "bytes":
            return rig_bytes()
        case "rigs":
            runs = [(way, rigs) for way in WAYS for rigs in options.rigs]
            return [measure(way, rigs, options.seconds, _made(folder / f"{way} {rigs}")) for way, rigs in runs]
        case "narrow":
            return measure_narrow(options.narrow_rigs, options.megabits, options.seconds, folder)
        case "sites":
            return measure_sites(options.seconds, _made(folder / "sites"))
        case "recorder":
            runs = [(rigs, foxglove) for foxglove in (True, False) for rigs in options.recorded_rigs]
            return [measure_recorder(rigs, options.seconds, foxglove, folder) for rigs, foxglove in runs]


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def rig_bytes() -> list[dict[str, Any]]:
    """Of one rig, what each topic costs in bytes per second, those of agents that all have together."""
    rows: dict[str, dict[str, Any]] = {}
    for stream in streams():
        agents = sum(stream.topic in topics for topics in AUDIENCES["agents"].values())
        new = {
            "topic": str(stream.topic),
            "bytes": 0.0,
            "keys": 0,
            "Hz": stream.rate_hz,
            "kB/s": 0.0,
            "heard by": agents,
        }
        row = rows.setdefault(str(stream.topic), new)
        row["bytes"] = (row["bytes"] * row["keys"] + stream.bytes) / (row["keys"] + 1)
        row["keys"] += 1
        row["kB/s"] += 1e-3 * stream.bytes * stream.rate_hz
    ordered = sorted(rows.values(), key=lambda row: -row["kB/s"])
    return [{**row, "bytes": round(row["bytes"]), "kB/s": round(row["kB/s"], 1)} for row in ordered]


def raw_frame_bytes() -> int:
    """Of the two images of the recorded frames, as pixels."""
    (frames,) = (stream for stream in streams() if stream.topic is FRAMES)
    frame = decode(StereoFrame, frames.payloads[0])
    return sum(image.width * image.height * image.channels for image in (frame.left, frame.right))


def _print_bytes(rows: list[dict[str, Any]]) -> None:
    _print("what one rig publishes", rows)
    into, out = (sum(row["kB/s"] * times(row) for row in rows) for times in (lambda _: 1, lambda row: row["heard by"]))
    CONSOLE.print(f"into the router {1e-3 * into:.2f} MB/s, out to its agents {1e-3 * out:.2f} MB/s")
    CONSOLE.print(f"frames as raw pixels would be {1e-6 * raw_frame_bytes() * rate_hz(FRAMES):.0f} MB/s")
    fits = {"in": into, "out": out, "out, recorded": out + into, "out, recorded and viewed": out + 2 * into}
    gigabit = ", ".join(f"{name} {1e3 * GIGABIT_MB // kilobytes:.0f}" for name, kilobytes in fits.items())
    CONSOLE.print(f"rigs through a port of 1 Gbit/s ({GIGABIT_MB} MB/s of payload): {gigabit}\n")


def _print_rigs(rows: list[dict[str, Any]]) -> None:
    _print("what the router takes", (_without(row, "topics", "seconds", "router threads") for row in rows))
    _print("what arrives: delivered %, p50 / p99 ms", map(_arrived, rows))


def _arrived(row: dict[str, Any]) -> dict[str, Any]:
    topics = row["topics"]
    shown = {name: _in_words(topics[name]) for name in SHOWN_TOPICS}
    lost = sum(round(t["sent"] * (100 - t["delivered %"]) / 100) for t in topics.values())
    told = sum(t["told lost"] for t in topics.values())
    return {"way": row["way"], "rigs": row["rigs"], **shown, "not heard": lost, "told lost": told}


def _in_words(topic: dict[str, Any]) -> str:
    return f"{topic['delivered %']}, {topic['p50 ms']} / {topic['p99 ms']}"


def _print_narrow(rows: list[dict[str, Any]]) -> None:
    megabits = rows[0]["megabits"]
    wanted = {row["rigs"]: 8e-3 * sum(one["kB/s"] for one in rig_bytes()) * row["rigs"] for row in rows}
    loads = ", ".join(f"{row['load before']}" for row in rows)
    wishes = ", ".join(f"{n} rigs {w:.0f}" for n, w in wanted.items())
    CONSOLE.print(f"a link of {megabits} Mbit/s; wanted: {wishes}; load before {loads}")
    shown = [
        {"topic": name, **{f"{row['rigs']} rigs": _in_words(row["topics"][name]) for row in rows}}
        for name in rows[0]["topics"]
    ]
    _print("what arrives: delivered %, p50 / p99 ms", shown)


def _print_sites(rows: list[dict[str, Any]]) -> None:
    _print("over the link between two sites", (_without(row, "topics", "at the sites") for row in rows))
    for row in rows:
        if heard := row["topics"].values():
            least, most_ms = min(t["delivered %"] for t in heard), max(t["p99 ms"] for t in heard)
            CONSOLE.print(f"{row['reader']}: of each topic {least} % or more came, 99 % within {most_ms} ms")
    CONSOLE.print()


def _print_recorder(rows: list[dict[str, Any]]) -> None:
    _print("one recorder", (_without(row, "said", "missing by topic") for row in rows))
    for row in rows:
        if row["missing"]:
            CONSOLE.print(f"{row['rigs']} rigs, foxglove {row['foxglove']}: missing {row['missing by topic']}")


PRINT = {
    "bytes": _print_bytes,
    "rigs": _print_rigs,
    "narrow": _print_narrow,
    "sites": _print_sites,
    "recorder": _print_recorder,
}


def _without(row: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in row.items() if name not in names}


def _print(title: str, rows: Iterable[dict[str, Any]]) -> None:
    listed = list(rows)
    if not listed:
        return
    CONSOLE.print(f"{title}:")
    table = Table(*listed[0], box=MARKDOWN)
    for row in listed:
        table.add_row(*(str(value) for value in row.values()))
    CONSOLE.print(table)


if __name__ == "__main__":
    main()
