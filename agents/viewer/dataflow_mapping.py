"""The dataflow as Rerun shows it: a graph of agents and topics with live rates, and the same as a table.

dataflow/graph      agents (round) with the median of their step times, and topics with their rates; an arrow leads from
                    who publishes a topic to the topic, and on to who reads it
dataflow/table      each agent's own account: where it runs, rates, ages, and what it lost

Both are made from the agents' health, which comes once a second: what no agent tells of is not there.
"""

import rerun as rr

from agents.viewer import colours
from agents.viewer.entity import Entity
from schemas.messages import AgentHealth
from schemas.topics import TOPICS, Delivery

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
