"""Whether posteriors hold under calibrations that are wrong by as much as they say.

    .venv/bin/python -m benchmarks.calibrations --data ../shared/data

Every render whose thread is in view, from its true masks, with calibrations drawn from the covariance of one whose file
states none (--calibrations of them for each). Of places along the curve it counts how many lie within the 95 % ellipse
across the thread: as the camera frame has them, by the whole covariance; and as a robot has them whose hand-eye
transform was found through the same camera, by the posterior, which leaves out what that takes back.
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64

from agents.cli.reconstruct.pipeline import reconstruct_pair
from agents.reconstruction.methods import METHODS
from benchmarks.measures import BELIEVED_PLACES, covariance_at
from benchmarks.scenes import CLEAR, CROSSING, scenes
from schemas.messages import RectifiedStereo, Status, ThreadObservations
from shared.arc_length import even_parameters
from shared.calibration.uncertainty import ERRORS, USUAL, bending, displacements, field_of, usual_covariance
from shared.curve_distance import normal_errors
from shared.rigid_transforms import exp_so3
from shared.splines import evaluate

METHOD = "refined"


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of scenes")
    parser.add_argument("--calibrations", type=int, default=50, help="drawn for each scene")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="run only scenes whose name contains this")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    rng = np.random.default_rng(arguments.seed)
    shares: list[tuple[float, float, float]] = []
    print(f"{'scene':40} ok of {arguments.calibrations}   frame   robot   pixels alone")
    for name, group, load in scenes(arguments.data):
        if group not in (CLEAR, CROSSING) or arguments.only not in name:
            continue
        scene = load()
        drawn = drawn_errors(rng, arguments.calibrations)
        assert scene.truth is not None
        seen = reconstruct_pair(scene.images, scene.calibration, masks=scene.masks, segmenter=None, method=METHOD)
        judged = (covered(seen.observations, scene.truth, errors) for errors in drawn)
        found = [share for share in judged if share is not None]
        shares += found
        mean = np.mean(found, axis=0) if found else np.full(3, np.nan)
        print(f"{name:40} {len(found):5}   " + "   ".join(f"{100 * share:5.1f}" for share in mean), flush=True)
    print(
        f"{'all, within the 95 % ellipse':40} {len(shares):5}   "
        + "   ".join(f"{100 * s:5.1f}" for s in np.mean(shares, 0))
    )


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
