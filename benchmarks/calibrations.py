"""Whether posteriors hold under calibrations that are wrong by as much as they say.

    .venv/bin/python -m benchmarks.calibrations --data ../shared/data

Every render whose thread is in view, from its true masks, with calibrations drawn from the covariance of one whose file
states none (--calibrations of them for each). Of places along the curve it counts how many lie within the 95 % ellipse
across the thread: as the camera frame has them, by the whole covariance; and as a robot has them whose hand-eye
transform was found through the same camera, by the posterior, which leaves out what that takes back.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import tyro
from jaxtyping import Float64

from agents.reconstruction.methods import METHODS
from benchmarks.measures import BELIEVED_PLACES, covariance_at
from benchmarks.scenes import CLEAR, CROSSING, reconstructed, scenes
from schemas.messages import RectifiedStereo, Status, ThreadObservations
from shared.arc_length import even_parameters
from shared.calibration.uncertainty import ERRORS, USUAL, bending, displacements, field_of, usual_covariance
from shared.curve_distance import normal_errors
from shared.rigid_transforms import exp_so3
from shared.splines import evaluate

METHOD = "refined"


@dataclass(frozen=True)
class Options:
    """Which scenes, and how many calibrations of each."""

    data: Path = Path("../shared/data")
    """Folder of scenes."""
    calibrations: int = 50
    """Drawn for each scene."""
    seed: int = 1
    only: str = ""
    """Scenes whose name contains this."""


def main() -> None:
    """Run the benchmark from the command line."""
    options = tyro.cli(Options, description=__doc__)
    cv2.setNumThreads(1)
    rng = np.random.default_rng(options.seed)
    shares: list[tuple[float, float, float]] = []
    print(f"{'scene':40} ok of {options.calibrations}   frame   robot   pixels alone")
    for name, group, load in scenes(options.data):
        if group not in (CLEAR, CROSSING) or options.only not in name:
            continue
        scene = load()
        seen = reconstructed(scene, scene.masks, method=METHOD).observations
        judged = (covered(seen, scene.threads[0].points, errors) for errors in drawn_errors(rng, options.calibrations))
        found = [share for share in judged if share is not None]
        shares += found
        _tell(name, found)
    _tell("all, within the 95 % ellipse", shares)


def _tell(name: str, shares: list[tuple[float, float, float]]) -> None:
    mean = np.mean(shares, axis=0) if shares else np.full(3, np.nan)
    print(f"{name:40} {len(shares):5}   " + "   ".join(f"{100 * share:5.1f}" for share in mean), flush=True)


def drawn_errors(rng: np.random.Generator, count: int) -> Float64[np.ndarray, "n 8"]:
    """Of calibrations whose files state none."""
    return rng.normal(size=(count, len(ERRORS))) * USUAL


def covered(
    seen: ThreadObservations, truth: Float64[np.ndarray, "m 3"], errors: Float64[np.ndarray, "8"]
) -> tuple[float, float, float] | None:
    """The share of places within the ellipse by each covariance, None where there is no curve."""
    of_calibration = usual_covariance()
    thread = METHODS[METHOD](replace(wrongly(seen, errors), calibration_covariance=of_calibration))
    if thread.status is not Status.OK:
        return None
    spline = thread.knots, thread.control_points_camera, thread.degree
    s = even_parameters(*spline, BELIEVED_PLACES)
    points, tangents = evaluate(*spline, s), evaluate(*spline, s, 1)
    posterior = covariance_at(thread, s)
    camera, depth = thread.camera, float(np.median(points[:, 2]))
    bent, whole = bending(camera, points, depth), displacements(camera, points)
    alone = posterior - bent @ of_calibration @ bent.transpose(0, 2, 1)
    in_frame = alone + whole @ of_calibration @ whole.transpose(0, 2, 1)
    R, t = hand_eye(seen.camera, errors, depth)
    by_robot = points @ R.T + t, tangents @ R.T
    judged = (points, tangents, in_frame), (*by_robot, posterior), (points, tangents, alone)
    return tuple(float(normal_errors(*one, truth).inside.mean()) for one in judged)  # pyright: ignore[reportReturnType]


def wrongly(observations: ThreadObservations, errors: Float64[np.ndarray, "8"]) -> ThreadObservations:
    """What was seen, by a camera that is not as its calibration says."""
    camera, amount = observations.camera, _named(errors)
    focal, middle = np.array((camera.fx_px, camera.fy_px)), np.array((camera.cx_px, camera.cy_px))
    ray = (observations.centrelines_right.point_px - middle) / focal
    point_px = middle + focal * _turned(ray, amount)
    enlarged = 1.0 + amount["focal"]
    other = replace(
        camera,
        fx_px=camera.fx_px * enlarged,
        fy_px=camera.fy_px * enlarged,
        cx_px=camera.cx_px + camera.fx_px * amount["cx"],
        cy_px=camera.cy_px + camera.fy_px * amount["cy"],
        baseline=camera.baseline * (1.0 + amount["baseline"]),
    )
    right = replace(observations.centrelines_right, point_px=point_px)
    return replace(observations, camera=other, centrelines_right=right)


def _named(errors: Float64[np.ndarray, "8"]) -> dict[str, float]:
    return {name: float(error) for name, error in zip(ERRORS, errors, strict=True)}


def _turned(ray: Float64[np.ndarray, "n 2"], amount: Mapping[str, float]) -> Float64[np.ndarray, "n 2"]:
    turn = exp_so3(np.array([amount["pitch"], amount["vergence"], amount["roll"]]))
    seen = np.column_stack((ray, np.ones(len(ray)))) @ turn.T
    return seen[:, :2] / seen[:, 2:] * (1.0 + amount["focal_apart"])


def hand_eye(
    camera: RectifiedStereo, errors: Float64[np.ndarray, "8"], depth: float
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]:
    """The rigid transform that takes a field as it is measured with a wrong calibration to where it is (Kabsch)."""
    true = field_of(camera, depth)
    amount = _named(errors)
    left = true[:, :2] / true[:, 2:]
    right = _turned((true - (camera.baseline, 0.0, 0.0))[:, :2] / true[:, 2:], amount)
    centre, enlarged = np.array((amount["cx"], amount["cy"])), 1.0 + amount["focal"]
    left, right = (left - centre) / enlarged, (right[:, 0] - centre[0]) / enlarged
    z = camera.baseline * (1.0 + amount["baseline"]) / (left[:, 0] - right)
    measured = np.column_stack((left * z[:, None], z))
    a, b = measured.mean(axis=0), true.mean(axis=0)
    U, _, Vt = np.linalg.svd((measured - a).T @ (true - b))
    R = Vt.T @ np.diag((1.0, 1.0, np.linalg.det(Vt.T @ U.T))) @ U.T
    return R, b - R @ a


if __name__ == "__main__":
    main()
