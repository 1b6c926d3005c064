"""Owners who send what is malformed, with their own certificates, and who accounts for it.

Newest messages are sent a few at a time, and the next ones once the consumers have handled them: a ring of a receiver
that overflows would lose unnumbered messages, which nobody could count.
"""

import itertools
import re
import threading
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents.operator.operator import ask_for_grasp
from schemas.codec import decode
from schemas.messages import CommandAnswer, Outcome, Policy, Progress, Status
from schemas.topics import (
    COMMANDS,
    CONFIGURATION,
    EXECUTION,
    FRAMES,
    HEALTH,
    HEARTBEAT,
    LOG,
    MAIN,
    PLAN,
    PROMPT,
    ROBOT_STATE,
    Delivery,
    Topic,
    key,
)
from shared.clock import monotonic_s, now_ns
from shared.recording.entry import Entry
from shared.recording.losses import LOST as LOST_NOTE
from shared.recording.losses import ON_THE_WAY
from shared.recording.mcap_file import read_with_notes
from shared.runtime.attachment import LAYOUT, Attachment, pack
from shared.runtime.commands import STATUS
from shared.runtime.delivery import declare_publisher
from tests.rigs.intruder.malformed import malformed, valid_messages
from tests.rigs.intruder.rig import ARM, BRIDGE, DESK, NAMES, OPERATOR, Rig, owned_topics
from tests.rigs.intruder.rows import Row
from tests.rigs.intruder.rules import commands_of_rig

EPOCH = 0x0DD
AT_ONCE = {Delivery.LATEST: 6}
"""Fewer than a ring holds."""
AT_ONCE_LOSSLESS = 200
HANDLED_S, ACCOUNTS_S, ANSWER_S, PLAN_S = 90.0, 20.0, 30.0, 120.0
WEIGHTS = {FRAMES: 0.1, PROMPT: 0.1}
"""A frame that can be read is searched for thread, which takes a while, and once more where one is prompted."""
ASK_AGAIN_S = 0.25
ASKED_AT_ONCE = 8
HUGE_BYTES = 40_000_000
LARGEST_BYTES = (1 << 28) + 1
LOST = re.compile(r"(\d+) of (suturegrasp/\S+?)(?:,|;|$)")
UNNUMBERED = re.compile(r"(\d+) came without a number")


@dataclass
class Flood:
    """What was sent, and the counts of each consumer before.

    Fields:
        sent: by key.
        runs: epochs that were claimed, by key.
        unnumbered: by key, those without a number that anybody could read.
        before: by consumer and topic, what its health said; others: what honest owners had sent by then.
    """

    rig: Rig
    draw: np.random.Generator
    sent: Counter[str] = field(default_factory=Counter[str])
    unnumbered: Counter[str] = field(default_factory=Counter[str])
    runs: defaultdict[str, set[int]] = field(default_factory=lambda: defaultdict(set))
    rows: list[Row] = field(default_factory=list[Row])
    notes: list[str] = field(default_factory=list[str])
    _next: Counter[str] = field(default_factory=Counter[str])

    def topic(self, topic: Topic, kind: str, count: int, payloads: Iterator[bytes] | None = None) -> None:
        """Send so many malformed messages of a topic as its owner."""
        name = key(self.rig.config.rig, topic, _instance(topic, kind), kind)
        session = self.rig.session(NAMES.get(kind, f"{kind}.main"))
        publisher = declare_publisher(session, name, topic, waits=True)
        made = payloads or malformed(topic, valid_messages(ARM)[topic], self.draw)
        consumers = [c for c, health in self.rig.heard.health.items() if any(_of(i, topic) for i in health.inputs)]
        at_once, left = AT_ONCE.get(topic.delivery, AT_ONCE_LOSSLESS), count
        while left > 0:
            batch = min(at_once, left)
            for place in range(batch):
                beside = self._beside(name, last=place == batch - 1)
                publisher.put(next(made), attachment=beside)
            self.sent[name] += batch
            left -= batch
            self._until_handled(name, consumers)
        publisher.undeclare()

    def _beside(self, name: str, last: bool) -> bytes | None:
        """What travels beside: mostly what agents send; nothing, too little, or anything at all."""
        way = 0.0 if last else self.draw.random()
        if way < 0.8:
            number = self._next[name]
            self._next[name] += 1
            self.runs[name].add(EPOCH)
            return pack(Attachment(EPOCH, number, now_ns(), 0.0))
        if way < 0.95:
            self.unnumbered[name] += 1
            length = int(self.draw.integers(0, 2 * LAYOUT.size))
            return None if way < 0.87 else self.draw.bytes(length + (length == LAYOUT.size))
        anything = self.draw.bytes(LAYOUT.size)
        self.runs[name].add(LAYOUT.unpack(anything)[0])
        return anything

    def _until_handled(self, name: str, consumers: list[str]) -> None:
        wanted = self._next[name] - 1
        self.rig.until(lambda: self.rig.heard.newest.get((name, EPOCH), -1) >= wanted, f"{name} to be heard", HANDLED_S)
        for kind in consumers:
            self.rig.until(lambda kind=kind: self._handled(kind, name) == wanted, f"{kind} to handle {name}", HANDLED_S)

    def _handled(self, kind: str, name: str) -> int:
        for reply in self.rig.session(f"{OPERATOR}.{DESK}").get(f"{self.rig.root(kind)}/progress", timeout=ANSWER_S):
            if reply.ok is not None:
                told = decode(Progress, reply.ok.payload.to_bytes())
                return next((c.sequence for c in told.handled if (c.key, c.epoch) == (name, EPOCH)), -1)
        return -1

    def accounts(self, topic: Topic, kind: str) -> None:
        """A row for each consumer of a topic, by its own account; what honest owners sent is taken off."""
        name = key(self.rig.config.rig, topic, _instance(topic, kind), kind)
        for consumer, health in list(self.rig.heard.health.items()):
            if any(_of(i, topic) for i in health.inputs):
                row = self._row(consumer, topic, name)
                began_s, since = monotonic_s(), self.rig.heard.health[consumer].heartbeat
                while row.unaccounted and monotonic_s() < began_s + ACCOUNTS_S:
                    self.rig.until(
                        lambda c=consumer, s=since: self.rig.heard.health[c].heartbeat != s, "health", ACCOUNTS_S
                    )
                    since = self.rig.heard.health[consumer].heartbeat
                    row = self._row(consumer, topic, name)
                self.rows.append(row)

    def _row(self, consumer: str, topic: Topic, name: str) -> Row:
        health = self.rig.heard.health[consumer]
        account = next(i for i in health.inputs if _of(i, topic))
        at_s = monotonic_s() - (now_ns() - health.at_ns) * 1e-9
        runs = self.runs[name] | {None}
        others = sum(
            sum(t <= at_s for t in list(times))
            for (other, run), times in list(self.rig.heard.times_s.items())
            if other == name and run not in runs
        )
        crashed = len(self.rig.ended())
        return Row(
            f"malformed {topic} at {consumer}",
            self.sent[name],
            account.received - others,
            account.refused,
            account.dropped,
            account.missed,
            crashed,
        )


Place = tuple[Topic, str]
"""A topic, and the kind of agent that owns the key."""


def flooded(rig: Rig, messages: int, seed: int, huge: bool = True) -> tuple[list[Row], list[str]]:
    """Malformed messages on every topic and every command; what became of them, and what is worth knowing besides."""
    flood = Flood(rig, np.random.default_rng(seed))
    topics, commands = owned_topics(), commands_of_rig(rig)
    weights = {(t, kind): WEIGHTS.get(t, 1.0) for t, kind in topics}
    each = messages / (sum(weights.values()) + sum(WEIGHTS.get(t, 1.0) for t, _, _ in commands))
    counts = {place: max(1, round(each * weight)) for place, weight in weights.items()}
    early = [
        p for p in topics if p[1] not in ("robot_bridge", OPERATOR) and p[0] is not PLAN and p[0] not in EVERYBODYS
    ]
    # from the end of the dataflow to its beginning: what follows from malformed messages is not on the way yet
    order = sorted(early, key=lambda p: KINDS_BACKWARDS.index(p[1]))
    _sent_and_accounted(flood, order, counts)
    rig.start("simulator")
    rig.until_ready("simulator")
    _sent_and_accounted(flood, [(ROBOT_STATE, "robot_bridge"), (EXECUTION, "robot_bridge")], counts)
    rig.start(BRIDGE)
    rig.until_ready("robot_bridge")
    _sent_and_accounted(flood, [(PLAN, "planner"), (HEARTBEAT, OPERATOR)], counts)
    for topic, kind in topics:
        if topic in EVERYBODYS:
            flood.topic(topic, kind, counts[topic, kind])
    if huge:
        _huge(flood)
    for topic, name, kind in commands:
        flood.rows.append(_commanded(flood, topic, name, kind, max(1, round(each * WEIGHTS.get(topic, 1.0)))))
    flood.rows.append(_afterwards(flood))
    flood.rows.append(_recorded(flood))
    told = [f"{kind} said of itself: {fault}" for kind, said in sorted(rig.heard.faults.items()) for fault in said]
    return flood.rows, flood.notes + told


def _sent_and_accounted(flood: Flood, places: list[Place], counts: dict[Place, int]) -> None:
    for place in places:
        flood.topic(*place, counts[place])
    for place in places:
        flood.accounts(*place)


EVERYBODYS = (HEALTH, LOG, COMMANDS, CONFIGURATION)
KINDS_BACKWARDS = ("planner", "reconstruction", "perception", "camera", "simulator")


def _huge(flood: Flood) -> None:
    """One message below what may be sent, and one above."""
    before = len(flood.rows)
    for size in (HUGE_BYTES, LARGEST_BYTES):
        flood.topic(PLAN, "planner", 1, iter([bytes(size)]))
    flood.accounts(PLAN, "planner")
    flood.rows[before:] = [
        Row(r.attack + ", with two huge ones", r.sent, r.delivered, r.refused, r.dropped, r.missed, r.crashed)
        for r in flood.rows[before:]
    ]


def _commanded(flood: Flood, topic: Topic, name: str, kind: str, count: int) -> Row:
    """Malformed commands, each of which is to be answered; every twentieth asks for the status of an id instead."""
    session, answers = flood.rig.session(f"{OPERATOR}.{DESK}"), Counter[Outcome]()
    made = malformed(topic, valid_messages(ARM)[topic], flood.draw)

    def asked(turn: int, payload: bytes) -> list[Outcome]:
        selector = f"{name}?{STATUS}=none-{turn}" if turn % 20 == 19 else name
        replies = list(session.get(selector, payload=payload, timeout=ANSWER_S))
        return [decode(CommandAnswer, r.ok.payload.to_bytes()).outcome for r in replies if r.ok is not None]

    with ThreadPoolExecutor(ASKED_AT_ONCE) as pool:
        for first in range(0, count, AT_ONCE_LOSSLESS):
            turns = range(first, min(first + AT_ONCE_LOSSLESS, count))
            for outcomes in pool.map(asked, turns, itertools.islice(made, len(turns))):
                answers.update(outcomes)
    refused = answers[Outcome.REFUSED] + answers[Outcome.UNKNOWN]
    return Row(
        f"malformed {topic} to {kind}", count, answers[Outcome.ACCEPTED], refused, crashed=len(flood.rig.ended())
    )


def _afterwards(flood: Flood) -> Row:
    """Whether a goal gets a plan that can be armed, after all of it."""
    rig, said, asked = flood.rig, Counter[str](), itertools.count(1)
    places = itertools.cycle((0.5, 0.4, 0.6, 0.3, 0.7))
    number = 0

    def planned() -> bool:
        nonlocal number
        number = next(asked)
        threading.Event().wait(ASK_AGAIN_S)
        answer, plan = ask_for_grasp(rig.connection, ARM, Policy.CAPTURE_SLIDE_GRASP, s=next(places))
        if answer.outcome is Outcome.ACCEPTED and plan is not None and plan.status is Status.OK:
            return True
        said[answer.reason or (plan.reason if plan is not None else "no plan came")] += 1
        return False

    try:
        rig.until(planned, "a plan", PLAN_S)
        flood.notes.append(f"afterwards a goal got its plan, at attempt {number}")
        return Row("afterwards: a goal gets its plan", 1, 1, 0, crashed=len(rig.ended()))
    except TimeoutError as error:
        flood.notes += [str(error), *(f"  {count} times: {reason}" for reason, count in said.most_common(5))]
        return Row("afterwards: a goal gets its plan", 1, 0, 0, crashed=len(rig.ended()))


def _recorded(flood: Flood) -> Row:
    """What the recording holds of it, and says that it lacks."""
    crashed = flood.rig.ended()
    child = next(c for c in flood.rig.supervisor.children if c.name == "recorder")
    if child.process is not None:
        child.process.terminate()
        child.process.wait(ANSWER_S * 6)
    said = child.log.read_text().strip().splitlines()[-1]
    held, honest = Counter[str](), 0
    for entry in read_with_notes(flood.rig.folder / "session.mcap"):
        if isinstance(entry, Entry):
            held[entry.key] += entry.epoch in flood.runs[entry.key]
        elif entry.name == LOST_NOTE:
            # ours were paced; what is lost on the way is that of owners who send a hundred times a second
            told = (text for name, text in entry.facts.items() if name in flood.sent and ON_THE_WAY in text)
            honest += sum(int(text.split(":")[0]) for text in told)
    lost = sum(int(n) for n, name in LOST.findall(said) if name in flood.sent) - honest
    unnumbered = int(found[1]) if (found := UNNUMBERED.search(said)) else 0
    flood.notes.append(f"the recorder said: {said[:300]}")
    sent = sum(flood.sent.values())
    return Row("malformed, all topics, at the recorder", sent, sum(held.values()), unnumbered, 0, lost, len(crashed))


def _instance(topic: Topic, kind: str) -> str:
    return ARM if topic.per_arm or kind == "robot_bridge" else MAIN


def _of(account: Any, topic: Topic) -> bool:
    return account.topic == str(topic)
