"""How observations and reconstructions fared: what failed and why, confidence, and the track from frame to frame."""

import re
from array import array
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64, Int64

from schemas.messages import Status, ThreadObservations, ThreadReconstruction
from shared.arc_length import length

NUMBER = re.compile(r"\d+([.,]\d+)?")


@dataclass
class ThreadQuality:
    """Counts and curves over time.

    Fields:
        failed: by topic and reason, its numbers left out, how many results failed.
        steps: what became of the track, by frame.
        methods: segmenters and methods that were used.
        length: of each curve, in the calibration's unit; `metres_per_unit` is that of the last.
    """

    results: Counter[str] = field(default_factory=Counter[str])
    failed: Counter[tuple[str, str]] = field(default_factory=Counter[tuple[str, str]])
    steps: Counter[str] = field(default_factory=Counter[str])
    methods: Counter[tuple[str, str]] = field(default_factory=Counter[tuple[str, str]])
    metres_per_unit: float | None = None
    _at: "array[int]" = field(default_factory=lambda: array("q"))
    _confidence: "array[float]" = field(default_factory=lambda: array("d"))
    _length: "array[float]" = field(default_factory=lambda: array("d"))

    def add(self, topic: str, message: ThreadObservations | ThreadReconstruction) -> None:
        """Count a result of perception or reconstruction."""
        self.results[topic] += 1
        if message.status is not Status.OK:
            self.failed[topic, NUMBER.sub("#", message.reason)] += 1
        if isinstance(message, ThreadObservations):
            self.methods["segmenter", message.segmenter] += 1
            return
        self.methods["method", message.method] += 1
        if message.track is not None:
            self.steps[message.track.step.name.lower()] += 1
        if message.status is Status.OK:
            self.metres_per_unit = message.camera.metres_per_unit
            self._at.append(message.stamp.capture_left_ns)
            self._confidence.append(float(message.confidence.mean()) if len(message.confidence) else np.nan)
            self._length.append(length(message.knots, message.control_points_camera, message.degree))

    @property
    def captured_ns(self) -> Int64[np.ndarray, "n"]:
        """When each frame with a curve was captured."""
        return np.array(self._at, np.int64)

    @property
    def confidence(self) -> Float64[np.ndarray, "n"]:
        """The mean confidence along each curve."""
        return np.array(self._confidence, np.float64)

    @property
    def length(self) -> Float64[np.ndarray, "n"]:
        """The length of each curve, in the calibration's unit."""
        return np.array(self._length, np.float64)
