"""Reconstructions as rows of tables: the curve as a whole, and places along it with what is known of each."""

import numpy as np
from jaxtyping import Float64

from agents.inspection.export_columns import AXES, Block, Column, number, seconds, whole
from schemas.messages import Status, ThreadReconstruction
from shared.along_thread import confidence_at, unseen_at
from shared.arc_length import length, parameters_at
from shared.camera import project
from shared.splines import evaluate

UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def frame_row(thread: ThreadReconstruction, published_ns: int, zero_ns: int) -> Block:
    """One reconstruction as a whole."""
    unit, factor = length_unit(thread)
    ok = thread.status is Status.OK
    total = length(thread.knots, thread.control_points_camera, thread.degree) * factor if ok else np.nan
    stamp = thread.stamp
    return {
        "frame": whole(stamp.sequence),
        "capture_left_ns": whole(stamp.capture_left_ns),
        "capture_right_ns": whole(stamp.capture_right_ns),
        "published_ns": whole(published_ns),
        "t_s": seconds(stamp.capture_left_ns, zero_ns),
        "status": [thread.status.name.lower()],
        "reason": [thread.reason],
        "method": [thread.method],
        "track": [thread.track.step.name.lower() if thread.track else ""],
        f"length_{unit}": number(total),
        "confidence_mean": number(float(thread.confidence.mean()) if len(thread.confidence) else None),
        "unseen_share": number(float(unseen_at(thread, np.linspace(0, 1, 1001)).mean()) if ok else None),
        "crossings": whole(len(thread.crossings)),
    }


def curve_rows(thread: ThreadReconstruction, zero_ns: int, points: int) -> Block:
    """A curve at places evenly spaced along it, with the covariance of each place."""
    unit, factor = length_unit(thread)
    knots, control_points, degree = thread.knots, thread.control_points_camera, thread.degree
    s = np.linspace(0.0, 1.0, points)
    at = parameters_at(knots, control_points, degree, s * length(knots, control_points, degree))
    curve = evaluate(knots, control_points, degree, at)
    covariance = _interpolated(thread.posterior_s, thread.posterior_covariance, at) * factor**2
    with np.errstate(all="ignore"):
        left_px = project(thread.camera, curve)[0]
    rows: dict[str, Column] = {
        "frame": np.full(points, thread.stamp.sequence),
        "t_s": np.full(points, (thread.stamp.capture_left_ns - zero_ns) * 1e-9),
        "s": s,
    }
    rows |= {f"{axis}_camera_{unit}": curve[:, i] * factor for i, axis in enumerate(AXES)}
    rows |= {"u_left_px": left_px[:, 0], "v_left_px": left_px[:, 1], "confidence": confidence_at(thread, s)}
    rows |= {"seen": (~unseen_at(thread, s)).astype(np.int64), f"deviation_{unit}": _largest_deviation(covariance)}
    return rows | {f"covariance_{AXES[i]}{AXES[j]}_{unit}2": covariance[:, i, j] for i, j in UPPER}


def length_unit(thread: ThreadReconstruction) -> tuple[str, float]:
    """The suffix of lengths and what they are multiplied with: metres where the calibration tells its unit."""
    metres = thread.camera.metres_per_unit
    return ("unit", 1.0) if metres is None else ("m", metres)


def _interpolated(
    at: Float64[np.ndarray, "q"], covariance: Float64[np.ndarray, "q 3 3"], s: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "n 3 3"]:
    """Covariances between those that are told, entry by entry; NaN where none is."""
    if not len(at):
        return np.full((len(s), 3, 3), np.nan)
    after = np.clip(np.searchsorted(at, s), 1, max(1, len(at) - 1))
    before, after = after - 1, np.minimum(after, len(at) - 1)
    span = at[after] - at[before]
    share = np.clip(np.divide(s - at[before], span, out=np.zeros_like(s), where=span > 0), 0.0, 1.0)[:, None, None]
    return (1 - share) * covariance[before] + share * covariance[after]


def _largest_deviation(covariance: Float64[np.ndarray, "n 3 3"]) -> Float64[np.ndarray, "n"]:
    variance = np.linalg.eigvalsh(np.nan_to_num(covariance))[:, -1]
    return np.where(np.isfinite(covariance[:, 0, 0]), np.sqrt(np.maximum(variance, 0.0)), np.nan)
