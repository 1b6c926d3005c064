"""How long it takes from capture until each stage has published.

A result carries the capture time of the images that it descends from. So what one stage adds to a frame is the time
from the publication of the stage before until its own, for messages of one capture; on the way between two hosts the
difference of their clocks is part of that.
"""

from array import array
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from agents.session_report.contents import LATEST_NS
from schemas.topics import FRAMES, PLAN, ROBOT_STATE, TOPICS, Topic

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
