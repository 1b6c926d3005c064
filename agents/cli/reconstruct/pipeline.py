"""One stereo pair through perception and reconstruction in this process, without a router."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, UInt8

from agents.perception.instances import as_sent, told_apart
from agents.perception.judging.answers import judgements
from agents.perception.judging.picture import about_exposure
from agents.perception.judging.whole import judge_whole
from agents.perception.observe import observe
from agents.perception.search import look_everywhere
from agents.perception.segmentation.choice import SEGMENTERS, Segmenter
from agents.perception.segmenter_names import GIVEN_MASKS
from agents.reconstruction.method_names import MATCHING_METHODS
from agents.reconstruction.methods import METHODS
from schemas.messages import FrameStamp, StereoCalibration, ThreadObservations, ThreadReconstruction
from shared.calibration.uncertainty import covariance_of
from shared.clock import Stopwatch
from shared.rectification import rectification, rectify_image, rectify_mask
from shared.right_eye import in_line, whole_rows

STEPS = ("rectify", "segment", "match", "reconstruct")

Pair = tuple[UInt8[np.ndarray, "h w *c"], UInt8[np.ndarray, "h w *c"]]


@dataclass(frozen=True)
class PipelineResult:
    """What each stage made of one stereo pair.

    Fields:
        images: the rectified pair.
        timings_ms: per step; 0 where a step was skipped.
    """

    images: Pair
    observations: ThreadObservations
    reconstruction: ThreadReconstruction
    timings_ms: dict[str, float]


def reconstruct_pair(
    images: Pair,
    calibration: StereoCalibration,
    *,
    masks: Pair | None,
    segmenter: str | None,
    method: str,
    segmenters: Mapping[str, Segmenter] = SEGMENTERS,
    prompt_px: Float64[np.ndarray, "2"] | None = None,
) -> PipelineResult:
    """The thread in one stereo pair.

    Args:
        images: left and right as the camera gave them, blue first.
        calibration: of the camera that took them.
        masks: coverage by thread, 0 to 255, of the images as they are; None to segment.
        segmenter: name of a segmenter; None for the one that suits the left image. Given masks need none.
        method: name of a reconstruction method.
        segmenters: by name.
        prompt_px: u and v of a pixel of the rectified left image, on the thread that is meant; any is, if it is None.

    Raises:
        RectificationError: where the calibration cannot be rectified.
    """
    watch = Stopwatch(*STEPS)
    with watch.step("rectify"):
        to_rectified = rectification(calibration)
        left = rectify_image(images[0], to_rectified.map_left)
        right = rectify_image(images[1], to_rectified.map_right)
        if masks is not None:
            masks = rectify_mask(masks[0], to_rectified.map_left), rectify_mask(masks[1], to_rectified.map_right)
        whole = judge_whole((left, right), images, to_rectified.camera)
        left, right = whole.images
        if masks is not None:
            masks = masks[0], in_line(masks[1], whole.right_eye, to_rectified.camera, linear=True)
    judged, score = whole.alignment, None
    if masks is not None:
        segmenter = GIVEN_MASKS
    else:
        with watch.step("segment"):
            looked = look_everywhere((left, right), 0, segmenter, prompt_px, segmenters)
        masks, segmenter, score = looked.coverage, looked.segmenter, looked.score
        judged = judged if looked.judgements is None else looked.judgements
    with watch.step("match"):
        stamp = FrameStamp(sequence=0, capture_left_ns=0, capture_right_ns=0, calibration_id="")
        observations = observe(
            stamp,
            to_rectified.camera,
            left,
            right,
            *masks,
            segmenter,
            judged,
            matching=method in MATCHING_METHODS,
            disparities_px=whole.disparities_px,
        )
        observations = told_apart(replace(observations, prompt_px=prompt_px), (left, right), last=None, score=score)
        found = (
            *whole.offset,
            *observations.judgements,
            *whole.pictures,
            *judgements([about_exposure(left, right)]),
        )
        eye = whole.right_eye
        observations = replace(as_sent(observations), judgements=found, right_eye=eye, rows_moved_up=whole_rows(eye))
        observations = replace(observations, calibration_covariance=covariance_of(calibration))
    with watch.step("reconstruct"):
        reconstruction = METHODS[method](observations)
    return PipelineResult((left, right), observations, reconstruction, watch.ms)
