"""The JSON that `suturegrasp reconstruct` writes. Fields are only ever added."""

import json
from pathlib import Path
from typing import Any

from agents.cli.reconstruct.pipeline import PipelineResult
from agents.reconstruction.method_names import MATCHING_METHODS
from schemas.messages import Judgement, Status, ThreadReconstruction
from shared.arc_length import length
from shared.calibration.uncertainty import ERRORS
from shared.units import unit_name

BEGINNING = b'{\n "status": '


def result_document(result: PipelineResult, judgements: tuple[Judgement, ...]) -> dict[str, Any]:
    """The result as plain values, with what is doubtful about the calibration; lengths are in its unit."""
    thread, observations = result.reconstruction, result.observations
    return {
        "status": thread.status.name.lower(),
        "reason": thread.reason or None,
        "unit": unit_name(thread.camera.metres_per_unit),
        "frame": "left rectified camera",
        "degree": thread.degree,
        "knots": thread.knots.tolist(),
        "control_points": thread.control_points_camera.tolist(),
        "confidence": {"s": thread.confidence_s.tolist(), "value": thread.confidence.tolist()},
        "posterior": _posterior(thread),
        "crossings": [
            {
                "s": [crossing.s_first, crossing.s_second],
                "left_px": crossing.point_px.tolist(),
                "over": crossing.over.name.lower(),
                "depth_apart": crossing.depth_apart,
            }
            for crossing in thread.crossings
        ],
        "unseen": thread.unseen.tolist(),
        "course": None
        if thread.course is None
        else {
            "joins": thread.course.joins.tolist(),
            "probability": thread.course.probability.tolist(),
            "other": thread.course.other.tolist(),
        },
        "observations": observed_points(result),
        "timings_ms": {step: round(ms, 3) for step, ms in result.timings_ms.items()},
        "length": _length(thread),
        "method": thread.method,
        "segmenter": observations.segmenter,
        "other_threads_px": thread.other_threads_px.tolist(),
        "hidden": None if thread.hidden is None else thread.hidden.tolist(),
        "ends_hidden": None if thread.ends_hidden is None else thread.ends_hidden.tolist(),
        "left_over": None
        if thread.left_over_px is None
        else {"share": thread.left_over_share, "left_px": thread.left_over_px.tolist()},
        "score": observations.candidates[0].score if observations.candidates else None,
        "other_threads": [
            {
                "score": other.score,
                "width_px": other.width_px,
                "left_px": other.left_px.tolist(),
                "right_px": other.right_px.tolist(),
            }
            for other in thread.other_threads
        ],
        "camera": _camera(thread),
        "judgements": [
            {"code": j.code, "severity": j.severity.name.lower(), "finding": j.finding, "remedy": j.remedy}
            for j in (*judgements, *observations.judgements)
        ],
    }


def observed_points(result: PipelineResult) -> int:
    """How many points of the thread its method started from: matched and clustered ones, or both centrelines'."""
    observations = result.observations
    if result.reconstruction.method in MATCHING_METHODS:
        return len(observations.points_camera)
    return len(observations.centrelines_left.point_px) + len(observations.centrelines_right.point_px)


def result_text(result: PipelineResult, judgements: tuple[Judgement, ...]) -> str:
    """The document as it stands in the file."""
    return json.dumps(result_document(result, judgements), indent=1, allow_nan=False) + "\n"


def is_result(path: Path) -> bool:
    """Whether a file was written by an earlier run."""
    try:
        with path.open("rb") as file:
            return file.read(len(BEGINNING)) == BEGINNING
    except OSError:
        return False


def _posterior(thread: ThreadReconstruction) -> dict[str, Any] | None:
    if len(thread.posterior_s) == 0:
        return None
    told: dict[str, Any] = {"s": thread.posterior_s.tolist(), "covariance": thread.posterior_covariance.tolist()}
    if thread.calibration_covariance is not None:
        told["calibration"] = {"errors": list(ERRORS), "covariance": thread.calibration_covariance.tolist()}
    return told


def _length(thread: ThreadReconstruction) -> float | None:
    if thread.status is not Status.OK:
        return None
    return length(thread.knots, thread.control_points_camera, thread.degree)


def _camera(thread: ThreadReconstruction) -> dict[str, float]:
    camera = thread.camera
    return {
        "width": camera.image_width,
        "height": camera.image_height,
        "fx_px": camera.fx_px,
        "fy_px": camera.fy_px,
        "cx_px": camera.cx_px,
        "cy_px": camera.cy_px,
        "baseline": camera.baseline,
    }
