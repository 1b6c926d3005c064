"""Observations that hold none, because a frame or its calibration cannot be used."""

import numpy as np
from jaxtyping import Float64

from schemas.messages import (
    ImageEncoding,
    Judgement,
    RectifiedStereo,
    Severity,
    Status,
    StereoCalibration,
    StereoFrame,
    ThreadObservations,
)
from shared.images import encode_image
from shared.rectification import rectified_camera

LARGEST_IMAGE_PIXELS = 1 << 26


def unusable(
    frame: StereoFrame, camera: RectifiedStereo, reason: str, prompt_px: Float64[np.ndarray, "2"] | None
) -> ThreadObservations:
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
        prompt_px=prompt_px,
    )


def nominal_camera(calibration: StereoCalibration) -> RectifiedStereo:
    """What the rectified camera would be, were the images rectified: for messages about those that cannot be."""
    baseline = float(np.linalg.norm(calibration.T_right_left[:3, 3]))
    return rectified_camera(calibration, calibration.K_left, baseline)
