"""One recorder for several rigs: what it takes, what its disk needs, and what is missing in the end."""

import contextlib
import os
import subprocess
import sys
import threading
from collections import defaultdict
from pathlib import Path
from typing import Any

from agents.cli.live.up import write_config
from agents.configuration.rig import RigConfig, RouterSection
from benchmarks.scaling_load import ARRIVE_S, WARM_UP_S, End
from benchmarks.scaling_rigs import RIG, SETTLE_S, end_command, instance_of, result, started, tell
from benchmarks.scaling_router import RouterRun, cpu_s, reading
from schemas.topics import FRAMES, key, topic_of
from shared.clock import monotonic_s
from shared.recording.mcap_file import read_recording
from shared.runtime.session import SessionSettings, free_local_endpoint, open_session

STARTS_S, ENDS_S = 30.0, 60.0
SECONDS_PER_HOUR = 3600


def measure_recorder(rigs: int, seconds: float, foxglove: bool, folder: Path) -> dict[str, Any]:
    """One `suturegrasp record` of so many rigs, with nobody else listening."""
    endpoint, path, file = free_local_endpoint(), folder / "rig.json", folder / "session.mcap"
    write_config(path, RigConfig(rig=RIG, router=RouterSection(endpoint=endpoint, start=False)))
    options = [] if foxglove else ["--no-foxglove"]
    command = [sys.executable, "-m", "agents.cli", "record", "--config", str(path), "--output", str(file), *options]
    ends = [End("send", endpoint, RIG, i, i, i, phase=n / rigs) for n, i in enumerate(map(instance_of, range(rigs)))]
    load_before = os.getloadavg()[0]
    with started([RouterRun(endpoint, RIG, "", (), False).command()]) as (router,), contextlib.ExitStack() as stack:
        recorder = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(recorder.kill)
        _wait_for_listener(SessionSettings(RIG, endpoint))
        processes = stack.enter_context(started(map(end_command, ends)))
        threading.Event().wait(SETTLE_S)
        for process in processes:
            tell(process, f"{seconds}\n")
        threading.Event().wait(WARM_UP_S)
        before, bytes_before, cpu_before = reading(router, endpoint), file.stat().st_size, cpu_s(recorder)
        threading.Event().wait(seconds)
        after, bytes_after, cpu_after = reading(router, endpoint), file.stat().st_size, cpu_s(recorder)
        sent = {where: numbers for process in processes for where, numbers in result(process).items()}
        threading.Event().wait(ARRIVE_S)
        recorder.terminate()
        said = (recorder.communicate(timeout=ENDS_S)[0] or "").strip()
    held: defaultdict[str, set[int]] = defaultdict(set)
    for entry in read_recording(file):
        held[entry.key].add(entry.sequence)
    file.unlink()
    missing = {w: sum(number not in held[w] for number in range(*numbers)) for w, numbers in sent.items()}
    by_topic: dict[str, int] = {}
    for where, count in missing.items():
        if count:
            by_topic[str(topic_of(where))] = by_topic.get(str(topic_of(where)), 0) + count
    written = (bytes_after - bytes_before) / seconds
    return {
        "rigs": rigs,
        "foxglove": foxglove,
        "load before": round(load_before, 1),
        "sent": sum(end - first for first, end in sent.values()),
        "missing": sum(missing.values()),
        "recorder cores": round((cpu_after - cpu_before) / seconds, 2),
        "router cores": round((after.cpu_s - before.cpu_s) / seconds, 2),
        "to the recorder MB/s": round(1e-6 * (after.sent - before.sent) / seconds, 1),
        "to the disk MB/s": round(1e-6 * written, 1),
        "GB per hour and rig": round(1e-9 * SECONDS_PER_HOUR * written / rigs, 1),
        "missing by topic": by_topic,
        "said": said,
    }


def _wait_for_listener(settings: SessionSettings) -> None:
    """Until somebody listens to the first camera."""
    with open_session(settings) as session:
        probe: Any = session.declare_publisher(key(settings.rig, FRAMES, instance_of(0)))
        deadline_s, pause = monotonic_s() + STARTS_S, threading.Event()
        while not probe.matching_status.matching:
            assert monotonic_s() < deadline_s, "the recorder does not listen"
            pause.wait(0.05)
