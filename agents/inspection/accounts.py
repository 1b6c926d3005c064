"""What the agents said of themselves: how they fared, what they dropped, their faults and their logs;
what the session was run with; and how long it takes from capture until each stage has published.

A result carries the capture time of the images that it descends from. So what one stage adds to a frame is the time
from the publication of the stage before until its own, for messages of one capture; on the way between two hosts the
difference of their clocks is part of that.
"""

import json
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from agents.inspection.contents import LATEST_NS
from agents.inspection.threads import ThreadQuality
from schemas.messages import AgentHealth, InputHealth, LogLevel, LogRecord, SimulatorState, StereoCalibration
from schemas.topics import FRAMES, MAIN, PLAN, ROBOT_STATE, TOPICS, Topic
from shared.recording.derivation import BEGUN, DERIVED, derivations
from shared.recording.entry import Note
from shared.recording.losses import AT, LOSSES

GRAVE = (LogLevel.WARNING, LogLevel.ERROR)
FAULT = "FAULT"
KINDS_KEPT = 1000


@dataclass
class Remark:
    """A warning, an error or a fault, as often as it was said in the same words."""

    agent: str
    level: str
    text: str
    first_ns: int
    last_ns: int
    count: int = 1


@dataclass(frozen=True)
class Drops:
    """What became of one agent's input over all of its runs within the recording, as its health counts it."""

    agent: str
    topic: str
    received: int
    dropped: int
    missed: int
    refused: int


@dataclass(frozen=True)
class AgentAccount:
    """One agent of a session.

    Fields:
        runs: how often it was started, as far as health tells.
        step_ms_p50: the median of what it reported each second; step_ms_p99: the largest. None where it never stepped.
    """

    name: str
    host: str
    version: str
    config_hash: str
    runs: int
    step_ms_p50: float | None
    step_ms_p99: float | None
    drops: tuple[Drops, ...]


@dataclass
class _Agent:
    """What one agent said of itself, by run: last, and first where the run had begun before the recording."""

    last: dict[int, AgentHealth] = field(default_factory=dict[int, AgentHealth])
    before: dict[int, AgentHealth] = field(default_factory=dict[int, AgentHealth])
    p50_ms: list[float] = field(default_factory=list[float])
    p99_ms: list[float] = field(default_factory=list[float])
    fault: str = ""


class AccountCollector:
    """Takes health and logs one by one."""

    def __init__(self) -> None:
        self._agents: dict[str, _Agent] = {}
        self._remarks: dict[tuple[str, str, str], Remark] = {}

    def add_health(self, epoch: int, health: AgentHealth, first: bool = True) -> None:
        """Take what an agent says of itself each second; `first`: it is the first that its run said."""
        name = name_of(health.agent, health.instance)
        agent = self._agents.setdefault(name, _Agent())
        if not first and epoch not in agent.last:
            agent.before[epoch] = health
        agent.last[epoch] = health
        if health.step_ms_p50 is not None:
            agent.p50_ms.append(health.step_ms_p50)
        if health.step_ms_p99 is not None:
            agent.p99_ms.append(health.step_ms_p99)
        # health repeats a fault each second; it is one
        if health.fault and health.fault != agent.fault:
            self._remark(name, FAULT, health.fault, health.at_ns)
        agent.fault = health.fault

    def add_log(self, record: LogRecord) -> None:
        """Take a line of a log; only warnings and errors are kept."""
        if record.level in GRAVE:
            self._remark(name_of(record.agent, record.instance), record.level.name, record.text, record.at_ns)

    def agents(self) -> tuple[AgentAccount, ...]:
        """The agents by name."""
        return tuple(_account(name, agent) for name, agent in sorted(self._agents.items()))

    def remarks(self) -> tuple[Remark, ...]:
        """What was said, in the order in which it was said first."""
        return tuple(sorted(self._remarks.values(), key=lambda remark: remark.first_ns))

    def _remark(self, agent: str, level: str, text: str, at_ns: int) -> None:
        # the traceback of an error is in the agent's own log
        line = text.splitlines()[0] if text else ""
        name = agent, level, line
        if name not in self._remarks and len(self._remarks) >= KINDS_KEPT:
            name = agent, level, "(further kinds)"
        if name in self._remarks:
            self._remarks[name].count += 1
            self._remarks[name].last_ns = at_ns
        else:
            self._remarks[name] = Remark(agent, level, name[2], at_ns, at_ns)


def name_of(kind: str, instance: str) -> str:
    """An agent as people call it."""
    return kind if instance == MAIN else f"{kind} {instance}"


def _account(name: str, agent: _Agent) -> AgentAccount:
    healths = list(agent.last.values())
    inputs: dict[str, list[InputHealth]] = {}
    before: dict[str, list[InputHealth]] = {}
    for counted, all_of_them in ((inputs, healths), (before, agent.before.values())):
        for health in all_of_them:
            for account in health.inputs:
                counted.setdefault(account.topic, []).append(account)
    newest = healths[-1]
    return AgentAccount(
        name=name,
        host=newest.host,
        version=newest.version,
        config_hash=newest.config_hash,
        runs=len(healths),
        step_ms_p50=float(np.median(agent.p50_ms)) if agent.p50_ms else None,
        step_ms_p99=max(agent.p99_ms, default=None),
        drops=tuple(_drops(name, topic, accounts, before.get(topic, [])) for topic, accounts in inputs.items()),
    )


def _drops(agent: str, topic: str, accounts: list[InputHealth], before: list[InputHealth]) -> Drops:
    """The counts of all runs, each of which counts from its own start: without those of before the recording."""
    received, dropped, missed, refused = (
        sum(getattr(account, count) for account in accounts) - sum(getattr(account, count) for account in before)
        for count in ("received", "dropped", "missed", "refused")
    )
    return Drops(agent, topic, received, dropped, missed, refused)


EPOCH = ".epoch"
"""Which run it was is drawn by chance, and says nothing of how it was run."""
LONGEST_VALUE = 2000


def noted_facts(notes: list[Note]) -> dict[str, str]:
    """What was noted of the session as a whole, one fact a line; JSON within a fact is taken apart."""
    facts: dict[str, str] = {}
    for note in notes:
        if note.name not in (LOSSES, DERIVED, BEGUN) and not is_of_a_moment(note):
            for name, text in note.facts.items():
                facts.update(_flat(f"{_name(note)}.{name}", _parsed(text)))
    for number, one in enumerate(derivations(notes), 1):
        told = asdict(one)
        # how long steps took differs from run to run, and says nothing of how it was run
        told["agents"] = {name: {"outputs": anew.outputs, "kept": anew.kept} for name, anew in one.agents.items()}
        facts.update(_flat(f"derived {number}", {name: value for name, value in told.items() if value != ""}))
    return {name: value for name, value in facts.items() if not name.endswith(EPOCH)}


def _name(note: Note) -> str:
    """The name of a note, with the agent that it is about, where there is one for each."""
    agent = " ".join(note.facts[name] for name in ("agent", "instance") if name in note.facts)
    return f"{note.name} {agent}".strip()


def is_of_a_moment(note: Note) -> bool:
    """Whether a note tells of something that happened at one time."""
    return note.facts.get(AT, "").isdecimal()


def attached_facts(files: Mapping[str, bytes]) -> dict[str, str]:
    """What attached JSON files say, one fact a line, each under the name of its file without its suffix."""
    facts: dict[str, str] = {}
    for name, data in files.items():
        document = _parsed(data.decode("utf-8", "replace").strip())
        if not isinstance(document, str):
            facts.update(_flat(name.removesuffix(".json"), document))
    return facts


def facts_of_messages(
    calibration: StereoCalibration | None,
    scene: SimulatorState | None,
    agents: tuple[AgentAccount, ...],
    quality: ThreadQuality,
) -> dict[str, str]:
    """What the messages themselves say of how the session was run."""
    facts: dict[str, str] = {}
    if calibration is not None:
        facts |= _calibration_facts(calibration)
    if scene is not None:
        facts |= {
            "scene.background": scene.background,
            "scene.colour": scene.colour,
            "scene.seed": str(scene.seed),
            "scene.distance_mm": f"{scene.distance_m * 1e3:g}",
        }
    for kind in ("segmenter", "method"):
        names = sorted(name for of, name in quality.methods if of == kind and name)
        if names:
            facts[f"thread.{kind}"] = ", ".join(names)
    for name in ("version", "host", "config_hash"):
        facts |= _common({f"{agent.name}.{name}": getattr(agent, name) for agent in agents}, f"agents.{name}")
    return facts


def _common(facts: dict[str, str], name: str) -> dict[str, str]:
    """One fact under that name where all are the same, else each under its own; empty ones are left out."""
    told = {key: value for key, value in facts.items() if value}
    values = set(told.values())
    return {name: values.pop()} if len(values) == 1 and len(told) == len(facts) else told


def _calibration_facts(calibration: StereoCalibration) -> dict[str, str]:
    unit = calibration.metres_per_unit
    baseline = float(np.linalg.norm(calibration.T_right_left[:3, 3]))
    return {
        "calibration.image_px": f"{calibration.image_width}x{calibration.image_height}",
        "calibration.focal_px": f"{calibration.K_left[0, 0]:.2f}",
        "calibration.baseline_mm" if unit else "calibration.baseline": f"{baseline * (unit * 1e3 if unit else 1):.4g}",
        "calibration.metres_per_unit": "unknown" if unit is None else f"{unit:g}",
    }


def _parsed(text: str) -> Any:
    if text[:1] in ("{", "["):
        try:
            return json.loads(text)
        except (ValueError, RecursionError):
            return text
    return text


def _flat(name: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        for key, one in value.items():
            yield from _flat(f"{name}.{key}", one)
    else:
        text = value if isinstance(value, str) else json.dumps(value)
        yield name, text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}…"


STAGES = tuple(topic for topic in TOPICS if topic is FRAMES or (topic.made_from is not None and not topic.per_arm))
BEFORE = {str(topic): str(topic.made_from) for topic in STAGES if topic is not PLAN and topic.made_from is not None}
"""Of a plan the time is its goal's: it waits for nobody's frame."""
PERCENTILES = (50.0, 90.0, 99.0, 100.0)


@dataclass
class StageTimes:
    """When the messages of one stage were captured and published."""

    captured: "array[int]" = field(default_factory=lambda: array("q"))
    published: "array[int]" = field(default_factory=lambda: array("q"))

    def add(self, captured_ns: int, published_ns: int) -> None:
        """Count a message."""
        self.captured.append(captured_ns)
        self.published.append(min(published_ns, LATEST_NS))

    @property
    def captured_ns(self) -> Int64[np.ndarray, "n"]:
        """When the images, or what else was measured, were taken."""
        return np.array(self.captured, np.int64)

    @property
    def published_ns(self) -> Int64[np.ndarray, "n"]:
        """When the results were published."""
        return np.array(self.published, np.int64)

    @property
    def latency_ms(self) -> Float64[np.ndarray, "n"]:
        """Milliseconds from capture until publication."""
        return (self.published_ns - self.captured_ns) * 1e-6

    @property
    def rate_hz(self) -> float:
        """Messages a second from the first to the last; 0 for fewer than two."""
        lasted_ns = float(np.ptp(self.published_ns)) if self.published else 0.0
        return (len(self.published) - 1) * 1e9 / lasted_ns if lasted_ns else 0.0


def stage_of(topic: Topic, instance: str) -> str:
    """The name of the stage that a message belongs to; empty for none."""
    if topic is ROBOT_STATE:
        return f"{topic} {instance}"
    return str(topic) if topic in STAGES else ""


def in_order(stage: str) -> tuple[int, str]:
    """A key that sorts stages as frames pass through them."""
    names = [str(topic) for topic in STAGES]
    return names.index(stage) if stage in names else len(names), stage


def captured_ns(message: Any) -> int:
    """When what a stage's message is about was seen by the first eye, or measured."""
    if hasattr(message, "measured_ns"):
        return message.measured_ns
    return min(message.stamp.capture_left_ns, message.stamp.capture_right_ns)


def added_ms(before: StageTimes, stage: StageTimes) -> Float64[np.ndarray, "m"]:
    """Milliseconds from the publication of the stage before until that of a stage, for captures that both have."""
    _, i, j = np.intersect1d(before.captured_ns, stage.captured_ns, return_indices=True)
    return (stage.published_ns[j] - before.published_ns[i]) * 1e-6


def percentiles(values: Float64[np.ndarray, "n"]) -> tuple[float, ...]:
    """The 50th, 90th and 99th percentile and the maximum; none of nothing."""
    return tuple(float(p) for p in np.percentile(values, PERCENTILES)) if len(values) else ()
