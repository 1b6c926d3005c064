"""How long perception takes for a stereo pair, in its first frame and around the last thread.

The same pair is seen again and again, each time some pixels on, as a thread moves. Times are the least of some runs:
by the clock on the wall with as many threads as perception takes, and as time of the processor.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from agents.perception.agent import Perception, PerceptionConfig
from agents.perception.centrelines import thread_centrelines
from agents.perception.following.pair import FollowedPair, follow_pair
from agents.perception.observe import observe
from agents.perception.search import Looked, look_everywhere, look_near
from agents.perception.told_apart import as_sent
from benchmarks.scenes import Pair, Scene
from schemas.messages import FrameStamp, ImageEncoding, RectifiedStereo, StereoFrame, ThreadObservations
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS
from shared.clock import Stopwatch, processor_s
from shared.images import encode_image
from shared.runtime.agent import Received, outputs_in

STEP_PX = (3, 2)
"""Columns and rows by which the thread moves from frame to frame."""
FRAMES_TRACKED, REPEATS = 4, 3
RATE_HZ = 30.0

Result = TypeVar("Result")


def times_ms(scene: Scene, camera: RectifiedStereo, segmenter: str) -> dict[str, float]:
    """Milliseconds of one scene whose images are rectified; those whose names end in `cpu` are of the processor.

    `first` leads from the whole of both images to centrelines, `near` does so around the last thread, followed where
    it can be; `pixels near` where it may not be followed. `step first` and `step near` are what the agent takes in all
    for a frame of raw images, from message to message, with masks, judgement and surface. `tracked` counts the frames
    that were looked at near the last thread alone, `followed` those of them in which it was followed.
    """
    found: dict[str, float] = {}
    looked, found["first"], found["first cpu"] = _least(lambda: _first(scene.images, segmenter))
    first = _observed(0, camera, scene.images, looked)
    near, followed = _tracked(scene.images, first)
    pixels, _ = _tracked(scene.images, replace(first, trail_left=None, trail_right=None))
    found |= {"tracked": float(len(near)), "followed": float(followed)}
    return found | _medians("near", near) | _medians("pixels near", pixels) | _of_agent(scene, segmenter)


def _tracked(images: Pair, last: ThreadObservations) -> tuple[list[tuple[float, float]], int]:
    """Times of frames around the last thread, as long as they do without a look at the whole; how many were followed.

    Thread is followed only where the first observations say by what.
    """
    times: list[tuple[float, float]] = []
    followed, may_follow = 0, last.trail_left is not None
    for number in range(1, FRAMES_TRACKED + 1):
        now, before = moved(images, number), last
        seen, *took = _least(lambda now=now, before=before, number=number: _near(now, before, number))
        if seen is None:
            break
        times.append((took[0], took[1]))
        if isinstance(seen, FollowedPair):
            last, followed = as_sent(seen.observed), followed + 1
        else:
            last = _observed(number, before.camera, now, seen)
            last = last if may_follow else replace(last, trail_left=None, trail_right=None)
    return times, followed


def moved(images: Pair, frames: int) -> Pair:
    """Both images after some frames of a steady motion; what leaves on one side comes in on the other."""
    by = STEP_PX[1] * frames, STEP_PX[0] * frames
    return np.roll(images[0], by, axis=(0, 1)), np.roll(images[1], by, axis=(0, 1))


def _first(images: Pair, segmenter: str) -> Looked:
    looked = look_everywhere(images, 0, segmenter)
    _lines(images, looked)
    return looked


def _near(images: Pair, last: ThreadObservations, number: int) -> FollowedPair | Looked | None:
    if (followed := follow_pair(_stamp(number), last.camera, images, last)) is not None:
        return followed
    looked = look_near(images, last, number)
    if looked is not None:
        _lines(images, looked)
    return looked


def _lines(images: Pair, looked: Looked) -> None:
    """One eye after the other, as `observe` does."""
    for image, coverage in zip(images, looked.coverage, strict=True):
        thread_centrelines(image, coverage)


def _observed(number: int, camera: RectifiedStereo, images: Pair, looked: Looked) -> ThreadObservations:
    seen = observe(
        _stamp(number), camera, *images, *looked.coverage, looked.segmenter, looked.judgements or (), matching=False
    )
    return replace(as_sent(seen), looked_sequence=looked.looked_sequence, is_bright=looked.is_bright)


def _of_agent(scene: Scene, segmenter: str) -> dict[str, float]:
    agent = Perception(PerceptionConfig(segmenter=segmenter))
    list(agent.step(Received(CALIBRATION, str(CALIBRATION), 1, scene.calibration)))
    first: list[tuple[float, float]] = []
    near: list[tuple[float, float]] = []
    for number in range(FRAMES_TRACKED + 1):
        left, right = (encode_image(image, ImageEncoding.RAW) for image in moved(scene.images, number))
        frame = StereoFrame(_stamp(number), left, right)
        outputs, *times = _timed(lambda frame=frame: outputs_in(agent.step(Received(FRAMES, str(FRAMES), 1, frame))))
        seen = next(out.message for out in outputs if out.topic is OBSERVATIONS)
        (first if seen.looked_sequence == number else near).append((times[0], times[1]))
    return _medians("step first", first) | _medians("step near", near)


def _medians(name: str, times: list[tuple[float, float]]) -> dict[str, float]:
    if not times:
        return {}
    ms, cpu_ms = np.median(times, axis=0)
    return {name: float(ms), name + " cpu": float(cpu_ms)}


def _stamp(number: int) -> FrameStamp:
    at_ns = round(1e9 * number / RATE_HZ)
    return FrameStamp(number, at_ns, at_ns, "")


def _timed(function: Callable[[], Result]) -> tuple[Result, float, float]:
    watch, before_s = Stopwatch("all"), processor_s()
    with watch.step("all"):
        result = function()
    return result, watch.ms["all"], 1e3 * (processor_s() - before_s)


def _least(function: Callable[[], Result]) -> tuple[Result, float, float]:
    results = [_timed(function) for _ in range(REPEATS)]
    return results[0][0], min(ms for _, ms, _ in results), min(cpu_ms for _, _, cpu_ms in results)
