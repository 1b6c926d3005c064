"""Whether the recordings of a lab hold every event that was heard beside the recorder."""

from collections import defaultdict

from schemas.topics import EXECUTION, JUDGEMENT, LOG, PLAN, topic_of
from shared.recording.mcap_file import read_recording
from tests.rigs.faults.lab import Lab

EVENTS = (LOG, PLAN, EXECUTION, JUDGEMENT)
OWN = "/recorder/"
"""What the recorder says itself, it does not record."""


def missing_events(lab: Lab) -> tuple[int, dict[str, int]]:
    """Stop the recorder; how many events were heard, and by key how many of them no recording holds."""
    heard = defaultdict[tuple[str, int], set[int]](set)
    for topic in EVENTS:
        for one in lab.observer.messages(topic):
            beside = one.tapped.beside
            if beside is not None and OWN not in one.tapped.key:
                heard[one.tapped.key, beside.epoch].add(beside.sequence)
    lab.let_pass(1.0)
    missing: defaultdict[str, int] = defaultdict(int)
    if not lab.processes.stop("record"):
        missing["the recorder did not end when asked to"] = 1
    for path in sorted(lab.recording.parent.glob("*.mcap")):
        for entry in read_recording(path):
            if topic_of(entry.key) in EVENTS:
                heard[entry.key, entry.epoch].discard(entry.sequence)
    total = sum(1 for topic in EVENTS for _ in lab.observer.messages(topic))
    for (key, _), numbers in heard.items():
        missing[key] += len(numbers)
    return total, {key: count for key, count in missing.items() if count}
