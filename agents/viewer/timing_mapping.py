"""How long the way from the camera to the screen takes, as Rerun shows it, in milliseconds.

latency/{stage}             from when the left eye saw a frame to when a stage published its result: the last stage's
                            is the latency from end to end
stage_ms/{stage}            from when a stage's input was published to when its result was, waiting included
step_ms/{stage}             how long the stage's step itself took; recordings do not hold it
clock/arrival_ms/{agent}    the least of each second from when an agent published something, by its clock, to when it
                            came to the recorder, or live to the viewer, by that one's clock: what the network takes,
                            and how far the two clocks are apart (a clock that is ahead makes it negative)
"""

import math
from collections import OrderedDict

import rerun as rr

from agents.viewer.entity import Entity
from schemas.topics import THREAD, TOPICS, Topic
from shared.runtime.attachment import Attachment

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
