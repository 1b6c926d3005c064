"""The camera agent: a source of stereo pairs becomes frames, with the calibration beside them.

Each frame echoes the newest challenge of every arm's bridge that was heard before it was captured, by which that bridge
knows how old it is. A notice with the stamp alone follows each frame, for whoever needs no image. Pictures that
come again and again, as of a grabber that has lost its signal, were captured nobody knows when: they echo nothing.
"""

import zlib
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from agents.camera.sources import BrokenOffError, Pair, Source
from schemas.messages import (
    ChallengeEcho,
    CommandAnswer,
    FrameNotice,
    FrameStamp,
    ImageEncoding,
    RectifiedStereo,
    RobotState,
    SimulatorState,
    StereoCalibration,
    StereoFrame,
)
from schemas.topics import CALIBRATION, FRAME_NOTICE, FRAMES, ROBOT_STATE, SIMULATOR_STATE
from shared.calibration.identity import calibration_id
from shared.images import encode_image
from shared.in_parallel import of_both
from shared.runtime.agent import Agent, CannotGoOnError, Command, Input, Output, Received, Tick
from shared.runtime.parameters import Between, settable

CHALLENGES = Input(ROBOT_STATE, instance="*", only_newest_counts=True, only_remembered=True)
MOST_ALIKE, LAST, EVERY_ROW = 5, 8, 8
"""So many frames in a row with a picture that is among the last 8 are nothing new: no sensor is without noise, a
grabber that is faster than its camera repeats a picture once or twice, and one that has stopped goes round its few
buffers. Some rows tell."""
CHALLENGES_KEPT = 60
"""Two seconds of them at 30 frames a second: longer than any capture chain takes."""

Renderer = Callable[[SimulatorState, int], Pair]
"""A simulated field and a frame number to what the cameras see."""


@dataclass(frozen=True)
class CameraConfig:
    """How frames are taken and sent.

    Fields:
        latency_ms: of the capture chain: how long before it arrives a frame was seen.
    """

    rate_hz: float = 30.0
    encoding: ImageEncoding = ImageEncoding.JPEG
    jpeg_quality: int = settable(95, Between(1, 100))
    latency_ms: float = 0.0


class Camera(Agent):
    """Publishes unrectified pairs at a steady rate; a source that has nothing new is left for the next tick."""

    kind = "camera"
    config: CameraConfig
    inputs = (CHALLENGES,)
    outputs = (FRAMES, FRAME_NOTICE, CALIBRATION)
    only_newest_tick_counts = True

    def __init__(self, source: Source, calibration: StereoCalibration, config: CameraConfig) -> None:
        self._source, self._calibration = source, calibration
        self.config, self.tick_hz = config, config.rate_hz
        self._sender, self._announced = FrameSender(config), False

    def configure(self, config: CameraConfig) -> None:
        """Go on with another config, in which only what may be set while the agent runs has changed."""
        self.config = self._sender.config = config

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output | CommandAnswer]:
        """The calibration at the first tick, then one frame a tick; a source that fails is a fault.

        Raises:
            SourceError: where the source gives something that is no pair.
            CannotGoOnError: where it will never give one again.
        """
        if isinstance(arrived, Received):
            self._sender.challenged(arrived.message)
        if not isinstance(arrived, Tick):
            return
        self._sender.ticked(arrived.now_ns)
        if not self._announced:
            self._announced = True
            self._sender.calibrated(self._calibration)
            yield Output(CALIBRATION, self._calibration)
        try:
            pair = self._source.read()
        except BrokenOffError as error:
            raise CannotGoOnError(str(error)) from None
        if pair is not None:
            yield from self._sender.told(pair, arrived.now_ns, self._source.taken_ns)

    def close(self) -> None:
        """Let go of files and devices."""
        self._source.close()


class SceneCamera(Agent):
    """Films the simulated field: the newest state is rendered at every tick."""

    kind = "camera"
    config: CameraConfig
    inputs = (Input(SIMULATOR_STATE, only_newest_counts=True, only_remembered=True), CHALLENGES)
    outputs = (FRAMES, FRAME_NOTICE, CALIBRATION)
    only_newest_tick_counts = True

    def __init__(
        self,
        render: Renderer,
        calibration_of: Callable[[SimulatorState], StereoCalibration],
        config: CameraConfig,
    ) -> None:
        self._render, self._calibration_of = render, calibration_of
        self.config, self.tick_hz = config, config.rate_hz
        self._state: SimulatorState | None = None
        self._camera: RectifiedStereo | None = None
        self._sender = FrameSender(config)

    def configure(self, config: CameraConfig) -> None:
        """Go on with another config, in which only what may be set while the agent runs has changed."""
        self.config = self._sender.config = config

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output | CommandAnswer]:
        """The calibration once the field is known and whenever its camera changes, then one frame a tick."""
        if isinstance(arrived, Received) and isinstance(arrived.message, RobotState):
            self._sender.challenged(arrived.message)
        elif isinstance(arrived, Received):
            self._state = arrived.message
        elif isinstance(arrived, Tick) and self._state is not None:
            self._sender.ticked(arrived.now_ns)
            if self._camera != self._state.camera:
                self._camera, calibration = self._state.camera, self._calibration_of(self._state)
                self._sender.calibrated(calibration)
                yield Output(CALIBRATION, calibration)
            yield from self._sender.told(self._render(self._state, self._sender.sent), arrived.now_ns)


class FrameSender:
    """Turns pairs into numbered messages, which name the calibration they were taken with."""

    def __init__(self, config: CameraConfig) -> None:
        self.config, self._calibration_id = config, ""
        self.sent = 0
        self._pictures: tuple[deque[int], ...] = (deque(maxlen=LAST), deque(maxlen=LAST))
        self._alike: tuple[int, ...] = (0, 0)
        self._came: dict[str, int] = {}
        self._heard: dict[str, deque[tuple[int, int]]] = {}

    def calibrated(self, calibration: StereoCalibration) -> None:
        """The frames from now on are taken with this calibration."""
        self._calibration_id = calibration_id(calibration)

    def challenged(self, state: RobotState) -> None:
        """Take a challenge of an arm's bridge; it was heard before the next tick."""
        self._came[state.arm] = state.challenge_ns

    def ticked(self, now_ns: int) -> None:
        """A tick begins: what came before it was heard by then, which is as late as it can have been."""
        for arm, challenge_ns in self._came.items():
            self._heard.setdefault(arm, deque(maxlen=CHALLENGES_KEPT)).append((now_ns, challenge_ns))
        self._came = {}

    def told(self, pair: Pair, now_ns: int, taken_ns: tuple[int, int] = (0, 0)) -> Iterable[Output]:
        """The next frame, and the notice of it."""
        frame = self.frame(pair, now_ns, taken_ns)
        return Output(FRAMES, frame), Output(FRAME_NOTICE, FrameNotice(frame.stamp))

    def frame(self, pair: Pair, now_ns: int, taken_ns: tuple[int, int] = (0, 0)) -> StereoFrame:
        """The next frame, each image taken so long after now, and seen `latency_ms` before it was taken."""
        latency_ns = round(self.config.latency_ms * 1e6)
        left_ns, right_ns = (now_ns + ns - latency_ns for ns in taken_ns)
        echoes = () if self._is_frozen(pair) else self._echoes(min(left_ns, right_ns))
        stamp = FrameStamp(self.sent, left_ns, right_ns, self._calibration_id, echoes)
        self.sent += 1
        left, right = of_both(
            encode_image, *((image, self.config.encoding, self.config.jpeg_quality) for image in pair)
        )
        return StereoFrame(stamp, left, right)

    def _is_frozen(self, pair: Pair) -> bool:
        """Whether an eye has shown nothing but its last pictures for some frames."""
        pictures = tuple(zlib.crc32(np.ascontiguousarray(image[::EVERY_ROW]).data) for image in pair)
        again = (picture in last for picture, last in zip(pictures, self._pictures, strict=True))
        self._alike = tuple(count + 1 if old else 1 for count, old in zip(self._alike, again, strict=True))
        for picture, last in zip(pictures, self._pictures, strict=True):
            last.append(picture)
        return max(self._alike) >= MOST_ALIKE

    def _echoes(self, captured_ns: int) -> tuple[ChallengeEcho, ...]:
        """The newest challenge of each arm that was heard before the frame was captured."""
        newest = {
            arm: next((told_ns for at_ns, told_ns in reversed(heard) if at_ns <= captured_ns), 0)
            for arm, heard in self._heard.items()
        }
        return tuple(ChallengeEcho(arm, told_ns) for arm, told_ns in sorted(newest.items()) if told_ns)
