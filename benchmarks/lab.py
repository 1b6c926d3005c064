"""What is made of path-traced scenes of a lab, by their truth: which curves are right, and which wrong though ok.

    suturegrasp scenes render --config easy medium needle rod several --background pad phantom --with meshes \
        --meshes ../shared/data/instruments --count 2 --seed 100 --samples 40 --output DIR
    .venv/bin/python -m benchmarks.lab --scenes DIR [--pictures out/lab]

Right: in both eyes at least 90 % of the curve lies within 14 px (of 1280) of one true thread, and at least 70 % of what
both eyes see of that thread is followed, as for the pads (benchmarks/real_images.py). Wrong though ok: whatever else is
ok. Thread and needle are counted by pixels, as for the frames there.
"""

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro
from jaxtyping import Bool, Float64, UInt8
from rich.progress import track
from rich.table import Table
from scipy.spatial import cKDTree

from agents.camera.image_files import read_pair
from agents.cli.reconstruct.pipeline import reconstruct_pair
from agents.reconstruction.method_names import DEFAULT_METHOD
from benchmarks.real_images import CURVE_RIGHT, ON_THREAD, THREAD_FOLLOWED, projected
from benchmarks.tables import CONSOLE
from schemas.messages import Status, StereoCalibration
from shared.calibration.uncertainty import ERRORS

Points = Float64[np.ndarray, "n 2"]


@dataclass(frozen=True)
class Options:
    """What is judged."""

    scenes: Path
    """Folder of rendered scenes, with NAME.json each."""
    segmenter: str | None = None
    """Default: what suits each picture."""
    json: Path | None = None
    """Write everything there."""
    pictures: Path | None = None
    """Write pictures of the curves over the left images into this folder."""


def main() -> None:
    """Judge and print."""
    options = tyro.cli(Options)
    paths = sorted(options.scenes.glob("*.json"))
    if not paths:
        raise SystemExit(f"{options.scenes} holds no NAME.json; render scenes into it with suturegrasp scenes render")
    rows = [judged(path, options) for path in track(paths, "scenes", transient=True)]
    table = Table(*rows[0], title="scenes of a lab", title_justify="left")
    for row in rows:
        table.add_row(*(f"{value:.1f}" if isinstance(value, float) else str(value) for value in row.values()))
    CONSOLE.print(table)
    CONSOLE.print(dict(Counter(row["verdict"] for row in rows)))
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


def judged(path: Path, options: Options) -> dict[str, Any]:
    """One scene; a row of a table."""
    about = json.loads(path.read_text())
    images = read_pair(*(path.with_name(f"{path.stem}_{eye}.png") for eye in ("left", "right")))
    calibration = _calibration(about)
    result = reconstruct_pair(
        images, calibration, masks=None, segmenter=options.segmenter, method=DEFAULT_METHOD
    ).reconstruction
    row: dict[str, Any] = {"scene": path.stem, "status": result.status.name.lower()}
    threads = _threads(path, about)
    if result.status is not Status.OK:
        _draw(options, path.stem, images[0], None)
        verdict = "none there" if not threads else "refused"
        return row | {"on thread %": "", "followed %": "", "verdict": verdict, "why": result.reason[:90]}
    curves, width = projected(result, calibration), images[0].shape[1]
    each = [_shares(curves, thread, calibration, ON_THREAD * width) for thread in threads]
    on, followed = max(each, key=min, default=(0.0, 0.0))
    right = on >= CURVE_RIGHT and followed >= THREAD_FOLLOWED
    _draw(options, path.stem, images[0], curves[0])
    shares = {"on thread %": 100 * on, "followed %": 100 * followed}
    return row | shares | {"verdict": "right" if right else "wrong though ok", "why": ""}


def _threads(path: Path, about: dict[str, Any]) -> list[tuple[Float64[np.ndarray, "n 3"], Bool[np.ndarray, "n"]]]:
    """Each true thread, in the left camera, and which of its points both eyes see."""
    names = [path.stem, *(f"{path.stem}_thread{k + 2}" for k in range(len(about["other_threads"])))]
    tables = [np.load(path.with_name(f"{name}.npy")) for name in names] if about["threads"] else []
    return [(table[:, :3].astype(np.float64), (table[:, 4] > 0) & (table[:, 5] > 0)) for table in tables]


def _shares(
    curves: tuple[Points, Points],
    thread: tuple[Float64[np.ndarray, "n 3"], Bool[np.ndarray, "n"]],
    calibration: StereoCalibration,
    within_px: float,
) -> tuple[float, float]:
    """How much of a curve lies on a thread, hidden or not, and of what both eyes see of it on the curve.

    In the eye that shows less of it.
    """
    points, both = thread
    true = _seen(points, calibration)
    on = min(_near(curve, line, within_px) for curve, line in zip(curves, true, strict=True))
    followed = min(_near(line[both], curve, within_px) for curve, line in zip(curves, true, strict=True))
    return on, followed


def _near(points: Points, others: Points, within_px: float) -> float:
    if len(points) == 0 or len(others) == 0:
        return 0.0
    return float(np.mean(np.asarray(cKDTree(others).query(points)[0]) <= within_px))


def _seen(points: Float64[np.ndarray, "n 3"], calibration: StereoCalibration) -> list[Points]:
    """Where both raw images show points of the left camera."""
    T = calibration.T_right_left
    eyes = (
        (calibration.K_left, calibration.distortion_left, np.eye(4)),
        (
            calibration.K_right,
            calibration.distortion_right,
            T,
        ),
    )
    return [
        cv2.projectPoints(points, cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3], K, np.asarray(distortion))[0][:, 0]
        for K, distortion, pose in eyes
        if len(points)
    ] or [np.zeros((0, 2))] * 2


def _calibration(about: dict[str, Any]) -> StereoCalibration:
    K, turn, shift = np.array(about["K"]), np.eye(3), np.array([-about["baseline_mm"], 0.0, 0.0])
    none = np.zeros(5)
    if "K_right" in about:
        turn, shift = np.array(about["R_right_left"]), np.array(about["t_right_left_mm"]).ravel()
    T_right_left = np.eye(4)
    T_right_left[:3, :3], T_right_left[:3, 3] = turn, shift
    return StereoCalibration(
        image_width=about["width"],
        image_height=about["height"],
        K_left=K,
        K_right=np.array(about.get("K_right", K)),
        distortion_left=np.array(about.get("distortion_left", none), np.float64),
        distortion_right=np.array(about.get("distortion_right", none), np.float64),
        T_right_left=T_right_left,
        metres_per_unit=1e-3,
        covariance=np.zeros((len(ERRORS), len(ERRORS))),
    )


def _draw(options: Options, name: str, image: UInt8[np.ndarray, "h w 3"], curve: Points | None) -> None:
    if options.pictures is None:
        return
    drawn = image.copy()
    if curve is not None:
        cv2.polylines(drawn, [np.rint(curve).astype(np.int32)[:, None]], False, (255, 0, 255), 2, cv2.LINE_AA)
    options.pictures.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(options.pictures / f"{name}.jpg"), drawn)


if __name__ == "__main__":
    main()
