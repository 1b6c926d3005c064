"""How well `suturegrasp replay` keeps the spacing of a recording, as the sender and as a subscriber see it.

    python -m benchmarks.replaying [session.mcap] [--rate 1] [--json out/replaying.json]

Router, replay and subscriber are processes of their own. Of two messages of one key that follow each other, recorded d
apart, the error is how much more or less than d / rate apart they were sent, or came. Without a recording, one is made:
ten seconds of 30 frames a second (240 kB each), the arm at 100 Hz, the field at 60 Hz and 30 results a second.
"""

import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
from collections import defaultdict
from dataclasses import asdict, dataclass
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from agents.replay.contents import contents_of
from agents.replay.flow import Spacing, spacing_errors_ms, spacing_of
from benchmarks.tables import Goal, Row, print_goals, print_rows, write_json
from schemas.topics import FRAMES, OBSERVATIONS, ROBOT_STATE, SIMULATOR_STATE, TOPICS, Topic, key, known_topic
from shared.clock import monotonic_s
from shared.recording.mcap_file import Entry, RecordingWriter, UntilDamage
from shared.runtime.connection import connected
from shared.runtime.session import SessionSettings, free_local_endpoint
from shared.runtime.taps import Tapped

RIG, SECONDS, WAIT_S = "replayed", 10, 30.0
MADE: tuple[tuple[Topic, float, int, str], ...] = (
    (FRAMES, 30.0, 240_000, "main"),
    (OBSERVATIONS, 30.0, 30_000, "main"),
    (SIMULATOR_STATE, 60.0, 4_000, "main"),
    (ROBOT_STATE, 100.0, 600, "psm1"),
)
GOAL_P99_MS = 2.0
BEGIN_NS = 1_700_000_000 * 10**9
SAID = re.compile(r"spacing error p50 ([\d.]+) ms, p99 ([\d.]+) ms, worst ([\d.]+) ms")
Heard = list[tuple[str, int, float]]
"""Key, number and time of arrival of each message."""


@dataclass(frozen=True)
class Options:
    """What to replay, and how fast."""

    recording: Annotated[Path | None, tyro.conf.Positional] = None
    rate: float = 1.0
    json: Path | None = None


def main() -> None:
    """Measure, print a table, and write JSON where asked to."""
    options = tyro.cli(Options, description=__doc__)
    with tempfile.TemporaryDirectory() as folder:
        measured = measure(options.recording or made(Path(folder) / "made.mcap"), options.rate, Path(folder))
    sent, heard = measured["sent"], measured["heard"]
    told = {name: measured[name] for name in ("rate", "messages", "not heard", "load before")}
    print_rows(
        "spacing of a replay: error in ms",
        [{"where": name} | told | of for name, of in (("sent", sent), ("heard", heard))],
    )
    met = sent["p99_ms"] <= GOAL_P99_MS
    print_goals("goals", [Goal("p99 as sent, idle machine, ms", f"{sent['p99_ms']:.2f}", f"≤ {GOAL_P99_MS:g}", met)])
    write_json(options.json, measured)


def measure(recording: Path, rate: float, folder: Path) -> Row:
    """Replay a recording once; errors of its spacing in milliseconds, of sender and subscriber, and what got lost."""
    endpoint, load = free_local_endpoint(), os.getloadavg()[0]
    config = folder / "rig.toml"
    config.write_text(f'rig = "{RIG}"\n[router]\nendpoint = "{endpoint}"\n')
    command = [sys.executable, "-m", "agents.cli"]
    with subprocess.Popen([*command, "router", "--config", str(config)], stdout=subprocess.DEVNULL) as router:
        try:
            heard, said = _replayed(recording, rate, endpoint, [*command, "replay", "--config", str(config)])
        finally:
            router.terminate()
    sent = SAID.search(said)
    if sent is None:
        raise SystemExit(f"the replay told no spacing: {said}")
    came, total = _spacing_of_heard(recording, heard, rate)
    return {
        "rate": rate,
        "messages": total,
        "not heard": total - len(heard),
        "sent": asdict(Spacing(came.pairs, *map(float, sent.groups()))),
        "heard": asdict(came),
        "load before": load,
        "cores": os.cpu_count(),
    }


def made(path: Path) -> Path:
    """A recording of known spacing, with the jitter of a real one."""
    rng, rows = np.random.default_rng(1), list[tuple[int, Topic, str, int, bytes]]()
    for topic, rate_hz, size, instance in MADE:
        payload = rng.bytes(size)
        for number in range(int(SECONDS * rate_hz)):
            at_ns = round((number + rng.uniform(0, 0.3)) / rate_hz * 1e9)
            rows.append((at_ns, topic, key(RIG, topic, instance), number, payload))
    writer = RecordingWriter(path)
    for at_ns, topic, name, number, payload in sorted(rows, key=lambda row: row[0]):
        writer.write(topic, Entry(name, 1, number, payload, BEGIN_NS + at_ns, BEGIN_NS + at_ns))
    writer.close()
    return path


def _replayed(recording: Path, rate: float, endpoint: str, command: list[str]) -> tuple[Heard, str]:
    context = multiprocessing.get_context("spawn")
    ready, ended, results = context.Event(), context.Event(), context.Queue()
    subscriber = context.Process(target=_subscribe, args=(endpoint, ready, ended, results))
    subscriber.start()
    try:
        if not ready.wait(WAIT_S):
            raise SystemExit("the subscriber did not come up")
        done = subprocess.run(
            [*command, str(recording), "--rate", str(rate)], capture_output=True, text=True, check=False
        )
        ended.set()
        heard = results.get(timeout=WAIT_S)
    finally:
        ended.set()
        subscriber.join(WAIT_S)
    return heard, done.stdout + done.stderr


def _subscribe(endpoint: str, ready: Event, ended: Event, results: "Queue[Heard]") -> None:
    heard: Heard = []

    def receive(tapped: Tapped) -> None:
        if tapped.beside is not None:
            heard.append((tapped.key, tapped.beside.sequence, monotonic_s()))

    with connected(SessionSettings(RIG, endpoint), WAIT_S) as connection:
        connection.listen(tuple(topic for topic in TOPICS if topic.recorded), receive)
        ready.set()
        ended.wait()
    results.put(heard)


def _spacing_of_heard(recording: Path, heard: Heard, rate: float) -> tuple[Spacing, int]:
    """The spacing at the subscriber, where both neighbours came; and how many messages were to be sent."""
    keys = {name: _on_rig(name) for name in contents_of(recording).counts}
    times = defaultdict[str, list[int]](list)
    for entry in UntilDamage(recording).entries():
        if entry.key in keys and known_topic(entry.key) is not None:
            times[keys[entry.key]].append(entry.received_ns)
    came = {(name, number): at_s for name, number, at_s in heard}
    played = {name for name, _ in came}
    errors = [np.empty(0)]
    for name in played:
        there = np.array([came.get((name, n), np.nan) for n in range(len(times[name]))])
        one_run = np.zeros(len(there), dtype=np.int64)
        errors.append(spacing_errors_ms(there, np.array(times[name]), one_run, rate))
    spacing = spacing_of(np.concatenate(errors)[np.isfinite(np.concatenate(errors))])
    if spacing is None:
        raise SystemExit("nothing was heard")
    return spacing, sum(len(times[name]) for name in played)


def _on_rig(name: str) -> str:
    parts = name.split("/")
    return "/".join((parts[0], RIG, *parts[2:]))


if __name__ == "__main__":
    main()
