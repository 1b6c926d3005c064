"""One look at the field: a frame through perception and reconstruction, and where goals lie on what they found."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from agents.simulated_trials.protocol import Trial, Tried
from schemas.messages import Status, StereoCalibration, StereoFrame, ThreadReconstruction
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, SURFACE, THREAD, Topic, key
from shared.runtime.agent import Agent, Output, Received, outputs_in

FINE = 4001


@dataclass(frozen=True)
class Look:
    """What was published of one frame, the thread last."""

    said: tuple[Output, ...]
    thread: ThreadReconstruction

    def moved(self, by_m: Float64[np.ndarray, "3"]) -> "Look":
        """The same with the thread moved as a whole, in metres."""
        if self.thread.status is not Status.OK or not by_m.any():
            return self
        by = by_m / (self.thread.camera.metres_per_unit or 1.0)
        thread = replace(self.thread, control_points_camera=self.thread.control_points_camera + by)
        return Look((*self.said[:-1], Output(THREAD, thread)), thread)


def looked(
    perception: Agent,
    reconstruction: Agent,
    calibration: StereoCalibration,
    frame: StereoFrame,
    following: StereoFrame | None = None,
) -> Look:
    """What perception and reconstruction make of a frame.

    Args:
        following: a frame after it, of which nothing counts but the surface: perception makes none of its first one.
    """
    said = [Output(CALIBRATION, calibration), Output(FRAMES, frame)]
    for output in fed(perception, CALIBRATION, calibration) + fed(perception, FRAMES, frame):
        said.append(output)
        if output.topic is OBSERVATIONS:
            said += fed(reconstruction, OBSERVATIONS, output.message)
    if following is not None:
        said += [output for output in fed(perception, FRAMES, following) if output.topic is SURFACE]
    # perception may tell of the surface after it has told of the thread
    said.sort(key=lambda output: output.topic is THREAD)
    return Look(tuple(said), said[-1].message)


def seen_places(thread: ThreadReconstruction, count: int) -> Float64[np.ndarray, "n"]:
    """So many s, evenly along what both images show of a thread; none where there is none."""
    if thread.status is not Status.OK:
        return np.zeros(0)
    s = np.linspace(0.0, 1.0, FINE)
    hidden = _within(s, thread.unseen)
    if thread.hidden is not None:
        hidden |= _within(s, thread.hidden)
    travelled = np.cumsum(~hidden)
    if not travelled[-1]:
        return np.zeros(0)
    return s[np.searchsorted(travelled, (np.arange(count) + 0.5) / count * travelled[-1])]


def _within(s: Float64[np.ndarray, "n"], stretches: Iterable[Any]) -> Any:
    inside = np.zeros(len(s), bool)
    for start, end in stretches:
        inside |= (s >= start) & (s <= end)
    return inside


def fed(agent: Agent, topic: Topic, message: Any) -> list[Output]:
    """What an agent says when it hears a message."""
    received = Received(topic, key("evaluation", topic, "main"), 0, message)
    return outputs_in(agent.step(received))


Outcome = Literal["held", "failed", "declined"]


class Came(Tried):
    """What came of a trial. Lengths in metres, times in seconds of the simulated world.

    Fields:
        outcome: `declined` where planner or robot bridge would not, so that nothing moved.
        code: the cause in one word; sentence: the same in the words of whoever said so.
        s, s_capture: of the reconstruction; s_caught: of the true thread.
        goal_px: where the goal was in the left image, as reconstructed; capture_px likewise.
        probability: of success, as the plan promised.
        error_m, capture_error_m: how far the reconstructed goal, and capture, were from the true thread.
        injected_m: by how much the thread was moved before it was planned for.
        took_s, least_s: from armed to finished, and what the limits of speed alone ask for.
        attempts: how many grasps were tried; said: what the planner's own check said of the last one.
    """

    trial: Trial
    outcome: Outcome
    code: str
    sentence: str
    s: float | None = None
    s_capture: float | None = None
    s_caught: float | None = None
    goal_px: tuple[float, float] | None = None
    capture_px: tuple[float, float] | None = None
    probability: float | None = None
    slide_m: float | None = None
    error_m: float | None = None
    capture_error_m: float | None = None
    injected_m: float = 0.0
    took_s: float | None = None
    least_s: float | None = None
    peak_force_n: float | None = None
    slipped_m: float | None = None
    attempts: int = 1
    said: str | None = None
    processor_s: float = 0.0
