"""The perception agent: frames and a calibration in, ordered observations out."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.perception.observe import observe
from agents.perception.rectification import (
    Rectification,
    RectificationError,
    rectification,
    rectified_camera,
    rectify_image,
)
from agents.perception.search import Looked, Pair, Remembered, look_everywhere, look_near, remember
from schemas.messages import (
    CommandAnswer,
    FrameStamp,
    ImageEncoding,
    Judgement,
    RectifiedStereo,
    Severity,
    Status,
    StereoCalibration,
    StereoFrame,
    ThreadObservations,
)
from schemas.topics import CALIBRATION, FRAMES, MAIN, OBSERVATIONS, SURFACE, Topic
from shared.calibration.identity import calibration_id
from shared.images import ImageDataError, decode_image, encode_image
from shared.runtime.agent import Command, Input, Output, Received, Tick

LARGEST_IMAGE_PIXELS = 1 << 26


@dataclass(frozen=True)
class PerceptionConfig:
    """How thread is found; `segmenter` None takes what suits the left image."""

    segmenter: str | None = None


class Perception:
    """Rectifies, segments and observes every frame; without a calibration it waits for one.

    Where thread was observed in one frame, the next is looked at near it first: so what is said of a frame follows from
    the frames before it, too.
    """

    kind = "perception"
    instance = MAIN
    inputs = (Input(FRAMES), Input(CALIBRATION, only_newest_counts=True))
    outputs = (SURFACE, OBSERVATIONS)
    commands: tuple[Topic, ...] = ()
    tick_hz = None

    def __init__(self, config: PerceptionConfig = PerceptionConfig()) -> None:
        self._config = config
        self._calibration: StereoCalibration | None = None
        self._calibration_id = ""
        # made for the first frame of its size: a calibration may claim any size
        self._rectification: Rectification | None = None
        self._remembered: Remembered | None = None

    def step(self, arrived: Received | Tick | Command) -> Iterable[Output | CommandAnswer]:
        """Observations for each frame once there is a calibration; an unusable frame is a failure with its reason."""
        if not isinstance(arrived, Received):
            return
        if arrived.topic is CALIBRATION:
            self._calibration, self._rectification, self._remembered = arrived.message, None, None
            self._calibration_id = calibration_id(arrived.message)
        elif self._calibration is not None:
            yield Output(OBSERVATIONS, self._observe(arrived.message, self._calibration))

    def _observe(self, frame: StereoFrame, calibration: StereoCalibration) -> ThreadObservations:
        camera = _nominal_camera(calibration) if self._rectification is None else self._rectification.camera
        if reason := self._mismatch(frame, calibration):
            return _unusable(frame, camera, reason)
        try:
            left, right = _colour(decode_image(frame.left)), _colour(decode_image(frame.right))
            self._rectification = self._rectification or rectification(calibration)
        except (ImageDataError, RectificationError) as error:
            return _unusable(frame, camera, str(error))
        camera = self._rectification.camera
        images = rectify_image(left, self._rectification.map_left), rectify_image(right, self._rectification.map_right)
        before, self._remembered = self._remembered, None
        looked = look_near(images, before, frame.stamp.sequence) if before else None
        if looked is not None:
            observed = self._observed(frame.stamp, camera, images, looked)
            if observed.status is Status.OK:
                return observed
        return self._observed(frame.stamp, camera, images, look_everywhere(images, self._config.segmenter))

    def _observed(self, stamp: FrameStamp, camera: RectifiedStereo, images: Pair, looked: Looked) -> ThreadObservations:
        carried_on = looked.near.carried_on if looked.near else None
        observed = observe(stamp, camera, *images, *looked.coverage, looked.segmenter, carried_on)
        if observed.status is Status.OK:
            self._remembered = remember(looked, images[0], stamp.sequence, observed.judgements)
        return observed

    def _mismatch(self, frame: StereoFrame, calibration: StereoCalibration) -> str:
        """Why a frame does not go with the calibration; empty where it does."""
        taken_with = frame.stamp.calibration_id
        if taken_with not in ("", self._calibration_id):
            return f"the frame was taken with calibration {taken_with}, and the newest known is {self._calibration_id}"
        size, wanted = (frame.left.width, frame.left.height), (calibration.image_width, calibration.image_height)
        if size != wanted:
            return f"the images are {size[0]}x{size[1]} and the calibration is for {wanted[0]}x{wanted[1]}"
        return ""


def _unusable(frame: StereoFrame, camera: RectifiedStereo, reason: str) -> ThreadObservations:
    """No observations, because the frame or the calibration cannot be used, and why."""
    # a calibration may claim any size, and then nothing of that size is made
    pixels = camera.image_height * camera.image_width
    shape = (camera.image_height, camera.image_width) if pixels <= LARGEST_IMAGE_PIXELS else (1, 1)
    nothing = encode_image(np.zeros(shape, np.uint8), ImageEncoding.PNG)
    return ThreadObservations(
        stamp=frame.stamp,
        camera=camera,
        status=Status.FAILED,
        reason=reason,
        segmenter="",
        points_camera=np.zeros((0, 3)),
        half_size_px=np.zeros((0, 2)),
        matched_px=np.zeros((0, 3)),
        match_cost=np.zeros((0, 2)),
        inlier=np.zeros(0, bool),
        mask_left=nothing,
        mask_right=nothing,
        judgements=(Judgement("unusable_input", Severity.FAULT, reason, "check the camera and its calibration"),),
    )


def _nominal_camera(calibration: StereoCalibration) -> RectifiedStereo:
    """What the rectified camera would be, were the images rectified: for messages about those that cannot be."""
    baseline = float(np.linalg.norm(calibration.T_right_left[:3, 3]))
    return rectified_camera(calibration, calibration.K_left, baseline)


def _colour(pixels: Any) -> Any:
    return pixels if pixels.ndim == 3 else pixels[:, :, None].repeat(3, axis=2)
