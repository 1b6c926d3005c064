"""How the dataflow fares, as Rerun shows it: health, logs, commands, latency, and what the viewer itself let go.

health/{what}/{agent}       published per second, lost and replaced inputs and their ages, step times, what it uses of
                            its machine, and how far the clock of its host is ahead
log/{who}                   everything that is said in words
viewer/{what}/{topic}       messages shown, thinned, dropped and unreadable
dataflow/graph              agents (round) with the median of their step times, and topics with their rates; an arrow
                            leads from who publishes a topic to the topic, and on to who reads it
dataflow/table              each agent's own account: where it runs, rates, ages, and what it lost
latency/{stage}             from when the left eye saw a frame to when a stage published its result: the last stage's
                            is the latency from end to end; milliseconds
stage_ms/{stage}            from when a stage's input was published to when its result was, waiting included
step_ms/{stage}             how long the stage's step itself took; recordings do not hold it
clock/arrival_ms/{agent}    the least of each second from when an agent published something, by its clock, to when it
                            came to the recorder, or live to the viewer, by that one's clock: what the network takes,
                            and how far the two clocks are apart (a clock that is ahead makes it negative)

Graph and table are made from the agents' health, which comes once a second: what no agent tells of is not there.
"""

import math
from collections import OrderedDict

import rerun as rr

from agents.viewer import colours
from agents.viewer.entity import IN_A_FULL_MACHINE, MOST_PER_SECOND, Entity
from schemas.codec import decode, encoding_name
from schemas.messages import (
    AgentConfiguration,
    AgentHealth,
    CommandRecord,
    GraspGoal,
    HostClocks,
    LogLevel,
    LogRecord,
    Outcome,
)
from schemas.topics import COMMANDS, FRAMES, THREAD, TOPICS, Delivery, Topic
from shared.runtime.attachment import Attachment

_LEVELS = {
    LogLevel.DEBUG: rr.TextLogLevel.DEBUG,
    LogLevel.INFO: rr.TextLogLevel.INFO,
    LogLevel.WARNING: rr.TextLogLevel.WARN,
    LogLevel.ERROR: rr.TextLogLevel.ERROR,
}
_COMMAND_TYPES = {encoding_name(topic.message): topic.message for topic in TOPICS if topic.delivery is Delivery.COMMAND}


def health_entities(health: AgentHealth) -> list[Entity]:
    """An agent's own account of itself as curves, and its fault in words."""
    agent = _agent(health.agent, health.instance)
    entities: list[Entity] = [
        (f"health/rate_hz/{agent}/{_part(output.topic)}", [rr.Scalars(output.rate_hz)]) for output in health.outputs
    ]
    for given in health.inputs:
        entities += [
            (f"health/lost/{agent}/{_part(given.topic)}", [rr.Scalars(float(given.missed + given.refused))]),
            (f"health/replaced/{agent}/{_part(given.topic)}", [rr.Scalars(float(given.dropped))]),
        ]
        if given.age_ms is not None:
            entities.append((f"health/age_ms/{agent}/{_part(given.topic)}", [rr.Scalars(given.age_ms)]))
    for name, step_ms in (("p50", health.step_ms_p50), ("p99", health.step_ms_p99)):
        if step_ms is not None:
            entities.append((f"health/step_ms/{agent}/{name}", [rr.Scalars(step_ms)]))
    if health.processor_share is not None:
        entities.append((f"health/processor_percent/{agent}", [rr.Scalars(100.0 * health.processor_share)]))
    if health.resident_bytes is not None:
        entities.append((f"health/memory_mib/{agent}", [rr.Scalars(health.resident_bytes / (1 << 20))]))
    if health.fault:
        entities.append(said(f"{health.agent}/{health.instance}", health.fault, rr.TextLogLevel.ERROR))
    return entities


def configuration_entities(configuration: AgentConfiguration) -> list[Entity]:
    """What an agent is set to, in words."""
    are_set = [parameter.name for parameter in configuration.settable if parameter.is_set]
    since = f"{', '.join(are_set)} set since it started" if are_set else "as configured"
    return [said(f"{configuration.agent}/{configuration.instance}", f"{since}: {configuration.parameters}")]


def clock_entities(clocks: HostClocks) -> list[Entity]:
    """How far the clocks of the hosts of agents are ahead, of those that answered."""
    return [
        (f"health/clock_ahead_ms/{_agent(clock.agent, clock.instance)}", [rr.Scalars(clock.ahead_ms)])
        for clock in clocks.clocks
        if clock.ahead_ms is not None
    ]


def log_entities(record: LogRecord) -> list[Entity]:
    """A line of an agent's log."""
    return [said(f"{record.agent}/{record.instance}", record.text, _LEVELS[record.level])]


def command_entities(record: CommandRecord) -> list[Entity]:
    """A command with its answer."""
    answer = record.answer
    level = rr.TextLogLevel.INFO if answer.outcome is Outcome.ACCEPTED else rr.TextLogLevel.WARN
    why = f" ({answer.code}): {answer.reason}" if answer.code else ""
    return [said(str(COMMANDS), f"{command_sentence(record)}: {answer.outcome.name.lower()}{why}", level)]


def command_sentence(record: CommandRecord) -> str:
    """Which command it was, and from whom."""
    try:
        command = decode(_COMMAND_TYPES[record.encoding], record.payload)
    except (KeyError, ValueError):
        return f"{record.topic} (unreadable)"
    wanted = f" of {command.arm}" if hasattr(command, "arm") else ""
    if isinstance(command, GraspGoal):
        wanted += _goal(command)
    return f"{record.topic}{wanted} from {command.header.sender}"


def said(who: str, text: str, level: rr.TextLogLevel = rr.TextLogLevel.INFO) -> Entity:
    """Words, and whose they are; `who` may name an agent and its instance."""
    parts = [part for part in who.split("/") if part and part not in ("*", "main")]
    return "/".join(("log", *map(_part, parts))), [rr.TextLog(f"{'/'.join(parts)}: {text}", level=level)]


def lane(path: str, state: str) -> Entity:
    """A state that lasts until the next one, in a colour of its own where it has one."""
    known = colours.STATES
    looks = rr.StateConfiguration(values=list(known), labels=list(known), colors=list(known.values()))
    return f"lanes/{path}", [looks, rr.StateChange(state=state)]


def nothing_yet() -> list[Entity]:
    """What stands where something is told of that has not happened yet."""
    return [
        ("plan/report", [rr.TextDocument("No goal has been named yet.")]),
        ("plan/check", [rr.TextDocument("No grasp was carried out yet.")]),
    ]


def failure(key: str, why: str, count: int) -> Entity:
    """That a message could not be shown, as the viewer says it."""
    return said("viewer", f"message {count} of {key} that cannot be shown: {why}", rr.TextLogLevel.ERROR)


def pace(there_is_room: bool) -> Entity:
    """How many frames are shown from now on, as the viewer says it."""
    if there_is_room:
        return said("viewer", f"the machine has room again: {MOST_PER_SECOND[FRAMES]} frames a second are shown")
    return said("viewer", f"the machine is full: {IN_A_FULL_MACHINE} frames a second are shown", rr.TextLogLevel.WARN)


def count_entities(what: str, counts: dict[str, int]) -> list[Entity]:
    """What the viewer did with messages, by topic."""
    return [(f"viewer/{what}/{_part(topic)}", [rr.Scalars(float(count))]) for topic, count in counts.items()]


def _goal(goal: GraspGoal) -> str:
    if goal.s is not None:
        return f" at s = {goal.s:.3f}"
    if goal.from_swage_m is not None:
        return f" at {1e3 * goal.from_swage_m:.1f} mm of thread from the swage"
    where, place = ("pixel", goal.pixel) if goal.pixel is not None else ("point", goal.point_camera)
    return f" at {where} ({', '.join(f'{number:.4g}' for number in ([] if place is None else place))})"


def _agent(agent: str, instance: str) -> str:
    return _part(agent) if instance == "main" else f"{_part(agent)}/{_part(instance)}"


def _part(name: str) -> str:
    return rr.escape_entity_path_part(name)


SILENT_NS = 3_000_000_000
"""Health comes once a second; an agent that was silent for longer is shown as silent."""

GRID = 170.0
PLACES = {
    "simulator": (0, 0),
    "simulator/state": (1, 0),
    "camera": (2, 0),
    "camera/frames": (3, -0.4),
    "camera/calibration": (3, 0.4),
    "camera/notice": (3, 1.0),
    "perception": (4, 0),
    "perception/observations": (5, -0.4),
    "perception/surface": (5, 0.4),
    "tool_tracker": (4, 1.1),
    "tool_tracker/correction": (3, 1.6),
    "reconstruction": (6, 0),
    "reconstruction/thread": (6, 1),
    "planner": (6, 2),
    "planner/plan": (4, 2),
    "planner/check": (5, 2.6),
    "planner/tail": (3.4, 1.9),
    "operator": (4, 3),
    "operator/heartbeat": (3, 2.7),
    "robot_bridge": (2, 2),
    "robot_bridge/state": (2, 1.1),
    "robot_bridge/execution": (0.8, 1.5),
    "simulator/judgement": (0, 1),
}
"""Columns and rows: from the camera to the right, and back below it to the arm."""

ELSEWHERE = (0, 3.6)
"""Where nodes begin whose place is not known."""


class Dataflow:
    """Remembers each agent's newest health."""

    def __init__(self) -> None:
        self._newest: dict[str, AgentHealth] = {}

    def entities(self, health: AgentHealth) -> list[Entity]:
        """The whole dataflow, as it is with this account."""
        self._newest[name_of(health)] = health
        return [("dataflow/graph", self._graph(health.at_ns)), ("dataflow/table", [self._table(health.at_ns)])]

    def _graph(self, now_ns: int) -> list[rr.AsComponents]:
        nodes, edges = self._nodes(now_ns), self._edges()
        known = {node for edge in edges for node in edge} | set(self._newest)
        for other in sorted(known - set(nodes)):
            nodes[other] = (self._label_of_unknown(other), colours.MUTED, 5.0)
        places = places_of(list(nodes))
        return [
            rr.GraphNodes(
                list(nodes),
                labels=[label for label, _, _ in nodes.values()],
                colors=[rgb for _, rgb, _ in nodes.values()],
                radii=[radius for _, _, radius in nodes.values()],
                positions=[places[node] for node in nodes],
                show_labels=True,
            ),
            rr.GraphEdges(edges, graph_type="directed"),
        ]

    def _nodes(self, now_ns: int) -> dict[str, tuple[str, tuple[int, int, int], float]]:
        """Label, colour and radius of each agent and of each topic that one of them publishes."""
        nodes: dict[str, tuple[str, tuple[int, int, int], float]] = {}
        for name, health in self._newest.items():
            step = "" if health.step_ms_p50 is None else f"  {health.step_ms_p50:.3g} ms"
            nodes[name] = (f"{name}{step}", STATE_RGB[state_of(health, now_ns)], 14.0)
            for output in health.outputs:
                topic = of_instance(output.topic, health)
                lost = sum(
                    i.missed + i.refused for h in self._newest.values() for i in h.inputs if i.topic == output.topic
                )
                rgb = colours.WARNING if lost else colours.TEXT
                label = f"{output.topic.split('/')[-1]}  {_rate(output.topic, output.rate_hz, output.published)}"
                nodes[topic] = (label + (f"  {lost} lost" if lost else ""), rgb, 5.0)
        return nodes

    def _label_of_unknown(self, node: str) -> str:
        """What publishes no health, and topics of such: with the rate at which one of them is read."""
        read = [i for h in self._newest.values() for i in h.inputs if of_instance(i.topic, h) == node]
        return f"{read[0].topic.split('/')[-1]}  {read[0].rate_hz:.3g} Hz read" if read else node

    def _edges(self) -> list[tuple[str, str]]:
        edges: dict[tuple[str, str], None] = {}
        for name, health in self._newest.items():
            edges |= {(name, of_instance(output.topic, health)): None for output in health.outputs}
            for given in health.inputs:
                edges |= {(topic, name): None for topic in self._published_as(given.topic, health)}
        # an operator publishes no health, but what it publishes is read
        readers = {topic for topic, _ in edges} - set(self._newest)
        told = {topic for name, topic in edges if name in self._newest}
        edges |= {(topic.split("/")[0], topic): None for topic in sorted(readers - told)}
        return list(edges)

    def _published_as(self, topic: str, reader: AgentHealth) -> list[str]:
        """The nodes of a topic: one for each instance that publishes it, the reader's own alone where it has one."""
        found = [of_instance(topic, h) for h in self._newest.values() if any(o.topic == topic for o in h.outputs)]
        own = of_instance(topic, reader)
        return [own] if own in found or not found else found

    def _table(self, now_ns: int) -> rr.TextDocument:
        rows = [row_of(name, health, now_ns) for name, health in sorted(self._newest.items())]
        head = (
            "agent",
            "host",
            "state",
            "step ms 50 / 99 %",
            "in Hz",
            "age ms",
            "replaced",
            "lost",
            "refused",
            "out Hz",
        )
        lines = [head, ("---",) * len(head), *rows]
        text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


STATE_RGB = {"well": colours.KEPT, "fault": colours.BAD, "silent": colours.GRID}


def name_of(health: AgentHealth) -> str:
    """An agent, with its instance where there may be several."""
    return health.agent if health.instance == "main" else f"{health.agent}/{health.instance}"


def of_instance(topic: str, health: AgentHealth) -> str:
    """A topic as a node: with the instance, where there is one topic per arm."""
    per_arm = topic in PER_ARM and health.instance != "main"
    return f"{topic}/{health.instance}" if per_arm else topic


PER_ARM = {str(topic) for topic in TOPICS if topic.per_arm}
LOSSLESS = {str(topic) for topic in TOPICS if topic.delivery in (Delivery.STATE, Delivery.EVENT)}


def state_of(health: AgentHealth, now_ns: int) -> str:
    """How an agent fares: `well`, `fault` or `silent`."""
    if now_ns - health.at_ns > SILENT_NS:
        return "silent"
    return "fault" if health.fault else "well"


def row_of(name: str, health: AgentHealth, now_ns: int) -> tuple[str, ...]:
    """An agent's row of the table."""
    ages = [given.age_ms for given in health.inputs if given.age_ms is not None]
    steps = "–" if health.step_ms_p50 is None else f"{health.step_ms_p50:.3g} / {health.step_ms_p99 or 0:.3g}"
    return (
        name,
        health.host,
        state_of(health, now_ns),
        steps,
        " ".join(f"{given.rate_hz:.3g}" for given in health.inputs) or "–",
        f"{max(ages):.3g}" if ages else "–",
        str(sum(given.dropped for given in health.inputs)),
        str(sum(given.missed for given in health.inputs)),
        str(sum(given.refused for given in health.inputs)),
        " ".join(f"{output.rate_hz:.3g}" for output in health.outputs) or "–",
    )


def places_of(nodes: list[str]) -> dict[str, tuple[float, float]]:
    """Where each node stands; further instances stand below the first one, unknown nodes in a row below all."""
    places: dict[str, tuple[float, float]] = {}
    taken: dict[str, int] = {}
    unknown = 0
    for node in nodes:
        kind = next((known for known in (node, node.rsplit("/", 1)[0]) if known in PLACES), None)
        if kind is None:
            column, row = ELSEWHERE[0] + 1.3 * unknown, ELSEWHERE[1]
            unknown += 1
        else:
            column, row = PLACES[kind]
            row += 0.3 * taken.get(kind, 0)
            taken[kind] = taken.get(kind, 0) + 1
        places[node] = (GRID * column, 0.95 * GRID * row)
    return places


def _rate(topic: str, rate_hz: float, published: int) -> str:
    return f"{published} sent" if topic in LOSSLESS else f"{rate_hz:.3g} Hz"


KEPT = 600
"""Frames whose publications are remembered until what was made from them comes."""

ARRIVAL_EVERY_NS = 1_000_000_000


class StageTimes:
    """Remembers when each stage published what it made of a frame."""

    def __init__(self) -> None:
        self._published: dict[Topic, OrderedDict[int, int]] = {}

    def saw(self, topic: Topic, frame: int, published_ns: int) -> float | None:
        """Note a publication; milliseconds since that of its input, None where that is not known."""
        published = self._published.setdefault(topic, OrderedDict())
        published[frame] = published_ns
        while len(published) > KEPT:
            published.popitem(last=False)
        if topic.made_from is None:
            return None
        input_ns = self._published.get(topic.made_from, {}).get(frame)
        return None if input_ns is None else 1e-6 * (published_ns - input_ns)


class Arrivals:
    """The least time that each agent's messages took to arrive, second by second."""

    def __init__(self) -> None:
        self._least_ms: dict[str, float] = {}
        self._began_ns: dict[str, int] = {}

    def count(self, key: str, published_ns: int, received_ns: int) -> list[Entity]:
        """Note an arrival; once a second for each agent, what is to be logged."""
        agent = "/".join(part for part in key.split("/")[2:4] if part != "main")
        took_ms = 1e-6 * (received_ns - published_ns)
        self._least_ms[agent] = min(took_ms, self._least_ms.get(agent, math.inf))
        began_ns = self._began_ns.setdefault(agent, received_ns)
        if 0 <= received_ns - began_ns < ARRIVAL_EVERY_NS:
            return []
        self._began_ns[agent] = received_ns
        return [(f"clock/arrival_ms/{_path(agent)}", [rr.Scalars(self._least_ms.pop(agent))])]


def latency_entities(topic: Topic, capture_ns: int, beside: Attachment, stage_ms: float | None) -> list[Entity]:
    """How old a frame was when this was published, by the clocks of camera and publisher, and what took how long."""
    stage = _stage(topic)
    entities: list[Entity] = [(f"latency/{stage}", [rr.Scalars(1e-6 * (beside.published_ns - capture_ns))])]
    if stage_ms is not None:
        entities.append((f"stage_ms/{stage}", [rr.Scalars(stage_ms)]))
    if math.isfinite(beside.step_ms):
        entities.append((f"step_ms/{stage}", [rr.Scalars(beside.step_ms)]))
    return entities


def _stage(topic: Topic) -> str:
    """An agent's name for the first that it says, and what else it says by that one's own name."""
    first = next(one for one in TOPICS if one.agent == topic.agent)
    return topic.agent if topic is first else topic.name


def end_to_end_name() -> Entity:
    """What the curve of the last stage that every frame goes through is called."""
    return f"latency/{_stage(THREAD)}", [rr.SeriesLines(names=["end to end: reconstruction"], widths=[2.5])]


def _path(agent: str) -> str:
    return "/".join(map(rr.escape_entity_path_part, agent.split("/")))
