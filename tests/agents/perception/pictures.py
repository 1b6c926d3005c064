"""Rendered and drawn pictures, and an agent that is fed frames of them over the wire."""

import functools
from typing import Any

import cv2
import numpy as np

from agents.perception.agent import Perception, PerceptionConfig
from schemas.codec import decode, encode
from schemas.messages import FrameStamp, ImageEncoding, StereoCalibration, StereoFrame, ThreadObservations
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, key
from shared.images import encode_image
from shared.rendering.render import make_scene, render
from shared.runtime.agent import Received

TOPICS = {StereoCalibration: CALIBRATION, StereoFrame: FRAMES, ThreadObservations: OBSERVATIONS}


@functools.cache
def rendered(config: str = "easy", seed: int = 12, colour: str = "violet") -> Any:
    """The camera of a scene of tissue, and its rendered pair."""
    scene = make_scene(config, "tissue", seed, colour)
    return scene.camera, render(scene)


def rendered_pair(config: str = "easy", seed: int = 12) -> Any:
    pair = rendered(config, seed)[1]
    return pair.left_bgr, pair.right_bgr


def frame_of(images: Any, sequence: int = 0, encoding: ImageEncoding = ImageEncoding.RAW, **stamp: Any) -> StereoFrame:
    """A frame of these images, of a camera of 30 Hz unless the stamp says otherwise."""
    left, right = (encode_image(image, encoding) for image in images)
    at_ns = 33_000_000 * sequence
    stamp = {"capture_left_ns": at_ns, "capture_right_ns": at_ns, "calibration_id": ""} | stamp
    return StereoFrame(FrameStamp(sequence, **stamp), left, right)


def moved(images: Any, right: int, down: int) -> Any:
    return tuple(np.roll(image, (down, right), axis=(0, 1)) for image in images)


def noisy(images: Any, *seeds: int) -> Any:
    """Images with the noise of a camera, of a seed for each eye."""
    noise = (np.random.default_rng(seed).integers(0, 3, images[0].shape, np.uint8) for seed in seeds)
    return tuple(cv2.add(image, more) for image, more in zip(images, noise, strict=True))


def replies(agent: Perception, message: Any) -> list[Any]:
    """What an agent does about a message that came over the wire."""
    topic = TOPICS[type(message)]
    return list(agent.step(Received(topic, key("lab", topic), 0, decode(topic.message, encode(message)))))


def fed(agent: Perception, *messages: Any) -> list[Any]:
    """What an agent observes on messages, over the wire."""
    outputs = [output for message in messages for output in replies(agent, message) if output.topic is OBSERVATIONS]
    return [decode(ThreadObservations, encode(output.message)) for output in outputs]


def agent_with(calibration: StereoCalibration, *config: Any, **more: Any) -> Perception:
    agent = Perception(PerceptionConfig(*config, **more))
    assert fed(agent, calibration) == []
    return agent


def recall_and_precision(found: np.ndarray, coverage: np.ndarray, around_px: int = 3) -> tuple[float, float]:
    """Of the clear pixels of a thread those near what was found, and of what was found that near the thread."""
    around = np.ones((around_px, around_px), np.uint8)
    near, truly_near = (cv2.dilate(of.astype(np.uint8), around) > 0 for of in (found > 0, coverage > 12))
    return near[coverage > 127].mean(), truly_near[found > 0].mean()
