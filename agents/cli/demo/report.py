"""The last screen of the demo: what happened, latency per stage, losses, where things lie, what to try next."""

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from agents.launch.session_folder import SessionFolder
from agents.session_report.stages import StageTimes, captured_ns
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import AgentHealth
from schemas.topics import FRAMES, HEALTH, OBSERVATIONS, THREAD, topic_of
from shared.recording.mcap_file import RecordingError, read_recording

STAGES = (FRAMES, OBSERVATIONS, THREAD)


def report(folder: SessionFolder, came_of_it: str, recorder_said: str, seed: int) -> Iterator[str]:
    """The lines of the screen."""
    yield ""
    yield came_of_it
    try:
        stages, healths = _read(folder)
    except (RecordingError, OSError) as error:
        yield f"the recording cannot be read: {error}"
        return
    yield ""
    yield "from capture until published, ms    p50    p99     messages  a second"
    for stage, times in stages.items():
        ms = times.latency_ms
        yield f"  {stage:32}{np.percentile(ms, 50):7.1f}{np.percentile(ms, 99):7.1f}{len(ms):9d}{times.rate_hz:13.1f}"
    yield from _losses(healths)
    yield ""
    yield recorder_said
    written = [path.name for path in (folder.recording, folder.rerun) if path.exists()]
    yield f"{' and '.join(written)} {'lie' if len(written) > 1 else 'lies'} in {folder.path}"
    yield ""
    yield "to try next:"
    yield f"  .venv/bin/suturegrasp inspect {folder.recording} --html report.html"
    if folder.rerun.exists():
        yield f"  .venv/bin/rerun {folder.rerun}"
    yield f"  make demo SEED={seed + 1}"
    yield "  make play       and in another terminal: .venv/bin/suturegrasp goal --s 0.4"


def _read(folder: SessionFolder) -> tuple[dict[str, StageTimes], dict[str, AgentHealth]]:
    """The times of each stage, and the last health of each agent."""
    stages: defaultdict[str, StageTimes] = defaultdict(StageTimes)
    healths: dict[str, AgentHealth] = {}
    for entry in read_recording(folder.recording):
        topic = topic_of(entry.key)
        if topic not in (*STAGES, HEALTH):
            continue
        try:
            message = decode(topic.message, entry.payload)
        except MessageError:
            continue
        if topic is HEALTH:
            healths[f"{message.agent} {message.instance}".removesuffix(" main")] = message
        else:
            stages[str(topic)].add(captured_ns(message), entry.published_ns)
    return dict(stages), healths


def _losses(healths: dict[str, AgentHealth]) -> Iterator[str]:
    """What was dropped because something newer had come, and what was lost."""
    yield ""
    for name, health in sorted(healths.items()):
        for account in health.inputs:
            if account.dropped or account.missed or account.refused:
                yield (
                    f"  {name} took {account.received} of {account.topic}, left out {account.dropped} for newer ones, "
                    f"lost {account.missed}, could not read {account.refused}"
                )
        if health.fault:
            yield f"  {name}: {health.fault}"
