"""The tool tracker of one arm: frames and the arm's states in, by what rigid motion its instrument is off out.

It looks at a frame every FOLLOWING_S while the instrument is followed, and every SEARCHING_S while it is
searched for, by the frames' own time; what that costs is told in docs/tool_tracking.md.
"""

from collections.abc import Iterable

from agents.tool_tracker import ToolTrackerConfig
from agents.tool_tracker.refinement import View
from agents.tool_tracker.search import soft_pair
from agents.tool_tracker.track import begun, followed, missed
from agents.tool_tracker.track_message import told_of, track_of
from agents.tool_tracker.tubes import Placed, in_metres, placed_at
from schemas.messages import RobotState, StereoCalibration, StereoFrame, ToolCorrection, ToolStatus
from schemas.topics import CALIBRATION, FRAMES, ROBOT_STATE, TOOL
from shared.calibration.identity import calibration_id
from shared.frame_checks import apart, mismatch
from shared.images import ImageDataError
from shared.rectification import (
    Rectification,
    RectificationError,
    RectifiedPair,
    decoded_pair,
    rectification,
    rectified_pair,
)
from shared.runtime.agent import Agent, Command, Input, Output, Received, Tick

FOLLOWING_S, SEARCHING_S = 0.2, 0.4
MOST_STATES = 200


class ToolTracker(Agent):
    """Looks for one instrument where its arm's states have it, and goes on from its last message alone."""

    kind = "tool_tracker"
    config: ToolTrackerConfig
    outputs = (TOOL,)
    goes_on_from = TOOL

    def __init__(self, config: ToolTrackerConfig | None = None) -> None:
        self.config = config or ToolTrackerConfig()
        self.instance = self.config.arm
        self.inputs = (
            Input(FRAMES, only_newest_counts=True),
            Input(CALIBRATION, only_newest_counts=True),
            Input(ROBOT_STATE, self.instance),
        )
        self._calibration: StereoCalibration | None = None
        self._calibration_id = ""
        self._rectification: Rectification | None = None
        self._last: ToolCorrection | None = None
        self._frame: StereoFrame | None = None
        self._states: list[RobotState] = []

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output]:
        """A correction for each frame that is due, as soon as a state of the arm is as new as the frame."""
        if not isinstance(arrived, Received):
            return
        if arrived.topic is CALIBRATION:
            self._calibration, self._rectification, self._frame = arrived.message, None, None
            self._calibration_id = calibration_id(arrived.message)
        elif arrived.topic is TOOL:
            self._go_on_from(arrived.message)
        elif arrived.topic is ROBOT_STATE:
            self._states = [*self._states[1 - MOST_STATES :], arrived.message]
            yield from self._looked()
        elif arrived.topic is FRAMES and self._due(arrived.message):
            self._frame = arrived.message
            yield from self._looked()

    def _go_on_from(self, last: ToolCorrection) -> None:
        """Nothing but the last message counts from here on, so that a replay can begin with it."""
        self._last, self._frame, self._states = last, None, []

    def _due(self, frame: StereoFrame) -> bool:
        last = self._last
        if last is None:
            return True
        waited_s = (frame.stamp.capture_left_ns - last.stamp.capture_left_ns) * 1e-9
        return not 0 <= waited_s < (FOLLOWING_S if last.status is ToolStatus.CONVERGED else SEARCHING_S) - 1e-3

    def _looked(self) -> Iterable[Output]:
        frame = self._frame
        if frame is None or not self._states or self._calibration is None:
            return
        at_ns = frame.stamp.capture_left_ns
        if self._states[-1].measured_ns < at_ns:
            return
        self._frame = None
        placed = placed_at(self._states, at_ns)
        if placed is not None:
            told = self._told(frame, placed, self._calibration)
            if told is not None:
                self._go_on_from(told)
                yield Output(TOOL, told)

    def _told(self, frame: StereoFrame, placed: Placed, calibration: StereoCalibration) -> ToolCorrection | None:
        """What the frame says; None where it cannot be used, and nothing was seen before."""
        last, pair = self._last, self._rectified(frame, calibration)
        track = track_of(last) if last is not None else None
        if isinstance(pair, str):
            if track is None or self._rectification is None:
                return None
            view = self._view(placed, self._rectification)
            return told_of(self.config.arm, frame.stamp, placed.measured_ns, missed(track, pair), view)
        view = View(in_metres(pair.camera), (), *placed.place)
        waited_s = FOLLOWING_S
        if last is not None:
            waited_s = max((frame.stamp.capture_left_ns - last.stamp.capture_left_ns) * 1e-9, 0.0)
        seen = followed(track or begun(view), soft_pair(*pair.images), view, waited_s, 0)
        return told_of(self.config.arm, frame.stamp, placed.measured_ns, seen, view)

    def _view(self, placed: Placed, ready: Rectification) -> View:
        return View(in_metres(ready.camera), (), *placed.place)

    def _rectified(self, frame: StereoFrame, calibration: StereoCalibration) -> RectifiedPair | str:
        """The rectified pair, or why there is none."""
        if calibration.metres_per_unit is None:
            return "the calibration does not say its unit of length"
        last = self._last.stamp if self._last is not None else None
        if reason := mismatch(frame, calibration, self._calibration_id) or apart(frame.stamp, last):
            return reason
        try:
            raw = decoded_pair(frame)
            self._rectification = self._rectification or rectification(calibration)
        except (ImageDataError, RectificationError) as error:
            return str(error)
        return rectified_pair(raw, self._rectification)
