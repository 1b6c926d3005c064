"""`suturegrasp reconstruct`: a stereo pair from files becomes a thread in 3D, without a router."""

import cv2
import numpy as np

from agents.camera.image_files import read_given, read_mask
from agents.cli.reconstruct.options import TOO_LARGE, Reconstruct, check
from agents.cli.reconstruct.pipeline import Pair, PipelineResult, reconstruct_pair
from agents.cli.reconstruct.result_file import observed_points, result_text
from agents.cli.whole_file import whole_file
from agents.perception.prompt import reach_px
from agents.perception.segmentation.choice import segmenters_with
from agents.perception.segmentation.promptable_model import PromptableFiles
from agents.perception.segmenter_names import PROMPTABLE
from agents.viewer.picture import draw_picture
from schemas.messages import Judgement, Severity, Status
from shared.arc_length import length
from shared.calibration import CalibrationError, ReadCalibration, read_calibration
from shared.images import decode_image
from shared.terminal import UsageError, complain, say, warn
from shared.units import unit_name

EXIT_OK, EXIT_FAILED = 0, 3


def run(options: Reconstruct) -> int:
    """Reconstruct as the options say and return the exit status; the one line about a failure goes to stderr."""
    check(options)
    images = read_given(options.left, options.right, options.stereo)
    read = _read_calibration(options, images)
    masks = _read_masks(options, images)
    pixel = _pixel(options, images)
    try:
        result = reconstruct_pair(
            images,
            read.calibration,
            masks=masks,
            segmenter=options.segmenter,
            method=options.method,
            segmenters=segmenters_with(_promptable_files(options)),
            prompt_px=None if pixel is None else np.array(pixel),
        )
    except MemoryError:
        raise UsageError(TOO_LARGE) from None
    _write(options, result, read.judgements)
    if result.reconstruction.status is not Status.OK:
        return complain(_why_none(result, pixel), EXIT_FAILED)
    for judgement in (*read.judgements, *result.observations.judgements):
        if judgement.severity is not Severity.NOTE:
            warn(_finding_and_remedy(judgement))
    # whoever has the result written to standard output wants nothing else there
    if options.output.is_file():
        say(_summary(options, result))
        if further := _further(result):
            say(further)
    return EXIT_OK


def _pixel(options: Reconstruct, images: Pair) -> tuple[float, float] | None:
    pixel = options.pixel
    height, width = images[0].shape[:2]
    if pixel is not None and not (0 <= pixel[0] <= width - 1 and 0 <= pixel[1] <= height - 1):
        raise UsageError(f"--pixel {pixel[0]:g} {pixel[1]:g} lies outside the left image of {width}x{height} pixels")
    return pixel


def _why_none(result: PipelineResult, pixel: tuple[float, float] | None) -> str:
    """The reason of the reconstruction; where a pixel was named that lies beside all thread, that."""
    if (
        pixel is None
        or result.observations.segmenter == PROMPTABLE
        or decode_image(result.observations.mask_left).any()
    ):
        return result.reconstruction.reason
    reach = reach_px(result.images[0].shape[1])
    return f"nothing like thread lies within {reach:.0f} px of ({pixel[0]:.0f}, {pixel[1]:.0f}) in the left image"


def _read_calibration(options: Reconstruct, images: Pair) -> ReadCalibration:
    height, width = images[0].shape[:2]
    read = read_calibration(options.calibration, unit=options.unit, image_size=(width, height))
    for judgement in read.judgements:
        if judgement.severity is Severity.FAULT:
            paths = " and ".join(map(str, options.calibration))
            raise CalibrationError(f"{paths}: {_finding_and_remedy(judgement)}")
    return read


def _read_masks(options: Reconstruct, images: Pair) -> Pair | None:
    if options.left_mask is None or options.right_mask is None:
        return None
    height, width = images[0].shape[:2]
    left = read_mask(options.left_mask, "the left mask", width, height)
    return left, read_mask(options.right_mask, "the right mask", width, height)


def _promptable_files(options: Reconstruct) -> PromptableFiles | None:
    """Where the network lies, where its segmenter is to be used."""
    if options.segmenter != PROMPTABLE or options.promptable_encoder is None or options.promptable_decoder is None:
        return None
    hashes = options.promptable_encoder_sha256, options.promptable_decoder_sha256
    return PromptableFiles(options.promptable_encoder, options.promptable_decoder, *hashes)


def _write(options: Reconstruct, result: PipelineResult, judgements: tuple[Judgement, ...]) -> None:
    with whole_file(options.output) as path:
        path.write_text(result_text(result, judgements), encoding="utf-8")
    shown = (*result.images, result.observations, result.reconstruction)
    if options.picture is not None:
        encoded = cv2.imencode(options.picture.suffix, draw_picture(*shown))[1]
        with whole_file(options.picture) as path:
            path.write_bytes(encoded.tobytes())
    if options.rrd is not None:
        # the viewer's mapping loads Rerun, which takes longer than a reconstruction
        from agents.viewer.rrd import write_rrd

        with whole_file(options.rrd) as path:
            write_rrd(path, *shown)


def _finding_and_remedy(judgement: Judgement) -> str:
    return f"{judgement.finding.rstrip('.')}; {judgement.remedy[:1].lower()}{judgement.remedy[1:].rstrip('.')}"


def _further(result: PipelineResult) -> str:
    """That other threads were seen, and how to mean one of them; empty where there are none."""
    others = result.reconstruction.other_threads
    if not others:
        return ""
    middles = (other.left_px[len(other.left_px) // 2] for other in others)
    places = ", ".join(
        f"--pixel {u:.0f} {v:.0f} (score {o.score:.2f})" for o, (u, v) in zip(others, middles, strict=True)
    )
    count = "1 further thread was" if len(others) == 1 else f"{len(others)} further threads were"
    return f"{count} seen; choose with {places}"


def _summary(options: Reconstruct, result: PipelineResult) -> str:
    thread = result.reconstruction
    unit = unit_name(thread.camera.metres_per_unit)
    long = length(thread.knots, thread.control_points_camera, thread.degree)
    took = sum(result.timings_ms.values())
    return (
        f"thread of {long:.4g} {unit or 'units (of unknown size; --unit says it)'} from "
        f"{observed_points(result)} points, mean confidence {thread.confidence.mean():.2f}, "
        f"in {took:.0f} ms: {', '.join(map(str, options.outputs.values()))}"
    )
