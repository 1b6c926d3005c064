"""The perception agent: frames and a calibration in, ordered observations out."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from agents.perception.background_search import FRAMES_BETWEEN_LOOKS_WATCHED, begun_beside, may_be_watched, watched
from agents.perception.following.pair import FollowedPair, follow_pair
from agents.perception.instances import as_sent, told_apart
from agents.perception.judging.each_frame import judge_each, lasting, one_eye_stands_still, pictured
from agents.perception.judging.whole import judge_whole
from agents.perception.needle import needle_observed
from agents.perception.observe import observe
from agents.perception.occluders import instruments_in
from agents.perception.prompt import reach_px
from agents.perception.schedule import Due, due
from agents.perception.search import FRAMES_BETWEEN_LOOKS, Looked, look_everywhere, look_near
from agents.perception.segmentation.choice import segmenters_with
from agents.perception.segmentation.promptable_model import PromptableFiles
from agents.perception.segmenter_names import GIVEN_MASKS, NETWORK, PROMPTABLE, SEGMENTER_NAMES
from agents.perception.surface import tissue_surface
from agents.perception.unusable import nominal_camera, unusable
from schemas.messages import (
    CommandAnswer,
    FrameStamp,
    Prompt,
    RightEye,
    Status,
    StereoCalibration,
    StereoFrame,
    ThreadObservations,
    ThreadReconstruction,
    TrackStep,
)
from schemas.topics import CALIBRATION, FRAMES, NEEDLE_SEEN, OBSERVATIONS, PROMPT, SURFACE, THREAD
from shared.background import begun
from shared.calibration.identity import calibration_id
from shared.calibration.uncertainty import covariance_of
from shared.frame_checks import apart, mismatch
from shared.images import ImageDataError, decode_image
from shared.rectification import (
    Rectification,
    RectificationError,
    RectifiedPair,
    decoded_pair,
    rectification,
    rectified_pair,
)
from shared.right_eye import right_eye_of, whole_rows
from shared.runtime.agent import Agent, Command, Input, Later, Output, Received, Reply, Tick
from shared.runtime.commands import accepted, refused
from shared.runtime.parameters import OneOf, settable

Pixel = Float64[np.ndarray, "2"]
LATEST_CURVE_NS = 500_000_000
"""So long a curve is a prediction of the next one, as for reconstruction."""
FOLLOWED = (NETWORK,)
"""Segmenters for tissue, whose thread may be followed in between; `threshold` takes no longer than that."""


@dataclass(frozen=True)
class PerceptionConfig:
    """How thread is found; `segmenter` None takes what suits the left image.

    Fields:
        matching: whether pixels are matched as well, which takes the longest and only method `paper` needs.
        needle: whether lines around a needle are looked for as well, which the agent `needle` needs.
        promptable: where the network lies that segmenter `promptable` needs.

    Raises:
        ValueError: where segmenter `promptable` lacks its network.
    """

    segmenter: str | None = settable(None, OneOf((None, *(name for name in SEGMENTER_NAMES if name != GIVEN_MASKS))))
    matching: bool = False
    needle: bool = False
    promptable: PromptableFiles | None = None

    def __post_init__(self) -> None:
        if self.segmenter == PROMPTABLE and self.promptable is None:
            raise ValueError("it needs promptable_encoder and promptable_decoder in the configuration of perception")


class Perception(Agent):
    """Rectifies, segments and observes every frame; without a calibration it waits for one.

    Where thread was observed in one frame, the next is looked at near it first. All that counts of earlier frames and
    prompts is in the last observations and the newest thread.
    """

    kind = "perception"
    config: PerceptionConfig
    inputs = (
        Input(FRAMES, only_newest_counts=True),
        Input(CALIBRATION, only_newest_counts=True),
        Input(THREAD, only_newest_counts=True, only_remembered=True),
    )
    outputs = (SURFACE, NEEDLE_SEEN, OBSERVATIONS)
    goes_on_from = OBSERVATIONS
    commands = (PROMPT,)

    def __init__(self, config: PerceptionConfig = PerceptionConfig()) -> None:
        self.config = config
        self._segmenters = segmenters_with(config.promptable)
        self._calibration: StereoCalibration | None = None
        self._calibration_id = ""
        # made for the first frame of its size: a calibration may claim any size
        self._rectification: Rectification | None = None
        self._last: ThreadObservations | None = None
        self._thread: ThreadReconstruction | None = None
        self._prompt_px: Pixel | None = None
        self._frame: StereoFrame | None = None

    def step(self, arrived: Received | Tick | Command) -> Iterable[Reply]:
        """Observations for each frame once there is a calibration; an unusable frame is a failure with its reason."""
        if isinstance(arrived, Command):
            yield self._prompted(arrived.message)
        elif not isinstance(arrived, Received):
            return
        elif arrived.topic is CALIBRATION:
            self._calibration, self._rectification, self._frame = arrived.message, None, None
            self._calibration_id, self._thread = calibration_id(arrived.message), None
            self._go_on_from(None)
        elif arrived.topic is THREAD:
            self._thread = arrived.message
        elif arrived.topic is OBSERVATIONS:
            self._go_on_from(arrived.message)
        elif self._calibration is not None:
            self._frame = arrived.message
            yield from self._seen(arrived.message, self._calibration)

    def _go_on_from(self, last: ThreadObservations | None) -> None:
        self._last, self._prompt_px = last, last.prompt_px if last else None

    def _seen(self, frame: StereoFrame, calibration: StereoCalibration) -> Iterable[Output | Later]:
        """What follows from a frame; the observations first, since reconstruction waits for them."""
        last = self._last
        surface_sequence = last.surface_sequence if last else None
        now_due = None if last is None else due(frame.stamp, last, self._is_watched(last))
        surface_due = False
        pictures = pictured(frame, last)
        pair = (
            apart(frame.stamp, last.stamp if last else None)
            or one_eye_stands_still(pictures)
            or self._rectified(frame, calibration)
        )
        if isinstance(pair, str):
            camera = nominal_camera(calibration) if self._rectification is None else self._rectification.camera
            observed = unusable(frame, camera, pair, self._prompt_px)
            judgements = observed.judgements
        else:
            surface_due = now_due is Due.SURFACE
            observed = self._observe(frame.stamp, pair, now_due)
            judgements = (*lasting(observed.judgements), *judge_each(pictures, pair.images))
        observed = replace(
            as_sent(observed),
            judgements=judgements,
            picture_left=pictures.left,
            picture_right=pictures.right,
            picture_left_since=pictures.left_since,
            picture_right_since=pictures.right_since,
            surface_sequence=frame.stamp.sequence if surface_due else surface_sequence,
            calibration_covariance=covariance_of(calibration),
        )
        self._go_on_from(observed)
        yield Output(OBSERVATIONS, observed)
        if not isinstance(pair, str):
            yield from self._beside_thread(observed, pair, surface_due)

    def _beside_thread(self, observed: ThreadObservations, pair: RectifiedPair, surface_due: bool) -> Iterable[Later]:
        """The tissue, and the needle whenever instruments were looked for."""
        stamp, occluders = observed.stamp, observed.occluders
        needle_due = self.config.needle and occluders is not None and occluders.sequence == stamp.sequence
        if not (needle_due or surface_due):
            return
        pair = pair.in_line(right_eye_of(observed))
        if needle_due:
            yield Later(NEEDLE_SEEN, begun(needle_observed, stamp, pair.camera, *pair.images, observed))
        if surface_due:
            thread = decode_image(observed.mask_left) > 0
            if occluders is not None:
                thread |= instruments_in(decode_image(occluders.left), thread.shape)
            yield Later(
                SURFACE, begun(tissue_surface, stamp, pair.camera, *pair.images, thread, observed.disparities_px)
            )

    def _is_watched(self, last: ThreadObservations) -> bool:
        """Whether what a look at the whole would find is found beside following."""
        followed = not self.config.matching and last.segmenter in FOLLOWED
        return followed and may_be_watched(self.config.segmenter, last)

    def _observe(self, stamp: FrameStamp, pair: RectifiedPair, now_due: Due | None) -> ThreadObservations:
        last = self._last
        if last is None:
            return self._looked(stamp, pair, None)
        near = pair.in_line(right_eye_of(last))
        if not self.config.matching and last.segmenter in FOLLOWED:
            beside = begun_beside(now_due, pair, last, self.config.segmenter)
            if (followed := self._followed(stamp, near, last, now_due)) is not None:
                observed = watched(followed.observed, followed.coverage, last, beside)
                return observed or self._looked(stamp, pair, right_eye_of(last))
        looked = look_near(near.images, last, stamp.sequence, self._segmenters)
        seen = right_eye_of(last), last.disparities_px
        observed = self._observed(stamp, near, looked, *seen, now_due) if looked else None
        if observed is None or observed.status is not Status.OK:
            return self._looked(stamp, pair, right_eye_of(last))
        return replace(
            observed,
            frames_since_look=last.frames_since_look + 1,
            judged_sequence=last.judged_sequence,
            glanced_sequence=last.glanced_sequence,
            glances=last.glances,
        )

    def _looked(self, stamp: FrameStamp, pair: RectifiedPair, before: RightEye | None) -> ThreadObservations:
        """What the whole of both images shows, the pair judged and its right eye put in line anew."""
        whole = judge_whole(pair.images, pair.raw, pair.camera, before)
        everything = look_everywhere(
            whole.images, stamp.sequence, self.config.segmenter, self._prompt_px, self._segmenters
        )
        if everything.judgements is None:
            everything = replace(everything, judgements=whole.alignment)
        known_px = None if self._last is None else self._last.disparities_px
        seen = whole.right_eye, known_px if whole.disparities_px is None else whole.disparities_px
        observed = self._observed(stamp, replace(pair, images=whole.images), everything, *seen)
        judgements = (*whole.offset, *observed.judgements, *whole.pictures)
        return replace(observed, judgements=judgements)

    def _followed(
        self, stamp: FrameStamp, pair: RectifiedPair, last: ThreadObservations, now_due: Due | None
    ) -> FollowedPair | None:
        """The thread followed from the last observations, and told apart; None where it is to be looked for."""
        if self._is_lost(last):
            return None
        between = FRAMES_BETWEEN_LOOKS_WATCHED if self._is_watched(last) else FRAMES_BETWEEN_LOOKS
        found = follow_pair(stamp, pair.camera, pair.images, last, between, self._curve(stamp, pair))
        if found is None:
            return None
        return replace(found, observed=told_apart(found.observed, pair.images, last, None, now_due is Due.OCCLUDERS))

    def _is_lost(self, last: ThreadObservations) -> bool:
        """Whether the curve was lost or begun anew in a frame since which thread has not been looked for."""
        thread, looked = self._thread, last.segmented_sequence
        if thread is None or thread.track is None or looked is None or thread.stamp.sequence <= looked:
            return False
        return thread.track.step in (TrackStep.RESTARTED, TrackStep.LOST)

    def _curve(self, stamp: FrameStamp, pair: RectifiedPair) -> ThreadReconstruction | None:
        """The newest curve; None where it is too old, of another camera, or lost."""
        thread = self._thread
        if thread is None or thread.status is not Status.OK or thread.camera != pair.camera:
            return None
        since_ns = stamp.capture_left_ns - thread.stamp.capture_left_ns
        return thread if 0 < since_ns <= LATEST_CURVE_NS else None

    def _observed(
        self,
        stamp: FrameStamp,
        pair: RectifiedPair,
        looked: Looked,
        right_eye: RightEye | None,
        disparities_px: Float64[np.ndarray, "2"] | None,
        now_due: Due | None = None,
    ) -> ThreadObservations:
        observed = observe(
            stamp,
            pair.camera,
            *pair.images,
            *looked.coverage,
            looked.segmenter,
            looked.judgements,
            matching=self.config.matching,
            disparities_px=disparities_px,
        )
        observed = replace(
            observed,
            right_eye=right_eye,
            rows_moved_up=whole_rows(right_eye),
            looked_sequence=looked.looked_sequence,
            is_bright=looked.is_bright,
            prompt_px=looked.prompt_px,
        )
        return told_apart(observed, pair.images, self._last, looked.score, now_due is Due.OCCLUDERS)

    def _rectified(self, frame: StereoFrame, calibration: StereoCalibration) -> RectifiedPair | str:
        """The rectified pair, or why there is none."""
        if reason := mismatch(frame, calibration, self._calibration_id):
            return reason
        try:
            raw = decoded_pair(frame)
            self._rectification = self._rectification or rectification(calibration)
        except (ImageDataError, RectificationError) as error:
            return str(error)
        return rectified_pair(raw, self._rectification)

    def _prompted(self, prompt: Prompt) -> CommandAnswer:
        """Whether something like thread lies near the prompt in the last frame; it is meant from the next one on."""
        pair = None
        if self._frame is not None and self._calibration is not None:
            pair = self._rectified(self._frame, self._calibration)
        if prompt.pixel is not None and (refusal := _refusal(prompt.pixel, pair, self.config.segmenter)):
            return refused(prompt.header.id, *refusal)
        self._last, self._prompt_px = None, prompt.pixel
        return accepted(prompt.header.id)


def _refusal(pixel: Pixel, pair: RectifiedPair | str | None, segmenter: str | None) -> tuple[str, str] | None:
    """Why a prompt is refused, with a code: nothing like thread lies near it in the last frame.

    Args:
        pair: the last frame; why it cannot be used, or None before the first.
        segmenter: as configured; None where it is chosen.
    """
    if pair is None:
        return "no_frame", "there is no frame yet to find thread in; start the camera"
    if isinstance(pair, str):
        return "unusable_frame", f"the last frame cannot be used: {pair}"
    height, width = pair.images[0].shape[:2]
    u, v = pixel
    if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
        return "outside", f"({u:.0f}, {v:.0f}) lies outside the left image of {width}x{height} pixels"
    # the answer cannot wait for such a network; where it finds nothing, the next observations say so
    if segmenter != PROMPTABLE and not look_everywhere(pair.images, 0, segmenter, pixel).coverage[0].any():
        reason = f"nothing like thread lies within {reach_px(width):.0f} px of ({u:.0f}, {v:.0f}) in the left image"
        return "no_thread", reason
    return None
