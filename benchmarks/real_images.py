"""What perception makes of real pictures, by labels that were drawn by hand: pads, flesh without thread, video frames.

    .venv/bin/python -m benchmarks.real_images [--data ../shared/data] [--only pad] [--pictures out/real_images]

- pads: raw stereo pairs, at their own width and at 540 px. Right: at least 90 % of the curve lies within 14 px (of
  1280) of the drawn thread in both eyes, and at least 70 % of the drawn thread is followed. Wrong though ok: anything
  else that is ok.
- flesh: the same rig, no thread. Any curve is a false one.
- frames: one eye of a video, whatever is taken for thread. Recall within 6 px, precision within 8 px (of 1000) of the
  drawn thread; how much of the needle, and of the instruments' area, is taken for thread. The rims where instruments
  fade into black count for nothing (benchmarks/labels/README.md).

Pictures show the material itself, and are never to be committed.
"""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro
from jaxtyping import Bool, Float64, UInt8
from rich.table import Table
from scipy.spatial import cKDTree

from agents.cli.reconstruct.pipeline import Pair, reconstruct_pair
from agents.perception.centrelines import thread_centrelines
from agents.perception.segmentation.choice import SEGMENTERS, suitable_segmenter
from agents.reconstruction.method_names import DEFAULT_METHOD
from benchmarks.measures import sampled
from benchmarks.tables import CONSOLE
from schemas.messages import Status, StereoCalibration, ThreadReconstruction
from shared.calibration.reader import read_calibration

Image = UInt8[np.ndarray, "h w 3"]
Points = Float64[np.ndarray, "n 2"]
Segment = Callable[[Image], Bool[np.ndarray, "h w"]]
WIDTHS = 1280, 540
ON_THREAD, RECALL_WITHIN, PRECISION_WITHIN = 14 / 1280, 6 / 1000, 8 / 1000
"""Of the image's width."""
THREAD_RADIUS = 2 / 1280
CURVE_RIGHT, THREAD_FOLLOWED = 0.90, 0.70
RIMS = 100, 800
"""Columns of the frames between which outlines of instruments can be told."""
FRAMES = Path(__file__).parent / "labels" / "suturebot"
EVERY_PX = 0.5
PAD_SIZE = 1280, 960


@dataclass(frozen=True)
class Options:
    """What is judged."""

    data: Path = Path("../shared/data")
    only: str = ""
    """Names that contain this."""
    segmenter: str | None = None
    """Default: what suits each picture."""
    masks: bool = False
    """Give the drawn thread of the pads as masks, so that what comes after segmentation is judged alone."""
    json: Path | None = None
    """Write everything there."""
    pictures: Path | None = None
    """Write pictures of what was found over the material into this folder; never to be committed."""


def main() -> None:
    """Judge and print."""
    options = tyro.cli(Options)
    stereo = options.data / "real_stereo"
    pads = [
        (path, width) for path in sorted(stereo.glob("pad_*.json")) for width in WIDTHS if options.only in path.stem
    ]
    flesh = [path for path in sorted(stereo.glob("flesh_*_left.png")) if options.only in path.stem]
    frames = [path for path in sorted(FRAMES.glob("*.json")) if options.only in path.stem]
    if not pads and not flesh and not frames:
        raise SystemExit(f"nothing under {options.data} has a name that contains {options.only!r}")
    found = {
        "pads": [pad(path, width, options) for path, width in pads],
        "flesh": [without_thread(path, options) for path in flesh],
        "frames": [frame(path, options) for path in frames],
    }
    if found["frames"]:
        found["frames"].append(_pooled(found["frames"]))
    for name, rows in found.items():
        _print(name, rows)
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(found, indent=1) + "\n")


def pad(path: Path, width: int, options: Options) -> dict[str, Any]:
    """A pair of the pads at a width; a row of a table."""
    drawn = json.loads(path.read_text())
    pair = _pair(path.parent / drawn["left_image"], path.parent / drawn["right_image"])
    scale = width / pair[0].shape[1]
    calibration = _scaled(_pad_calibration(path.parent), scale)
    images = _resized(pair[0], scale), _resized(pair[1], scale)
    eyes = [_along(drawn[eye], scale) for eye in ("left", "right")]
    result = reconstruct_pair(
        images,
        calibration,
        masks=_masks(eyes, images) if options.masks else None,
        segmenter=options.segmenter,
        method=DEFAULT_METHOD,
    ).reconstruction
    row: dict[str, Any] = {"pair": path.stem, "width": width, "status": result.status.name.lower()}
    if result.status is not Status.OK:
        _draw(options, f"{path.stem}_{width}", images, eyes, None)
        return row | {"on thread %": None, "followed %": None, "verdict": "refused", "why": result.reason}
    curves = projected(result, calibration)
    within_px = ON_THREAD * width
    on = min(_share_near(curve, thread, within_px) for curve, thread in zip(curves, eyes, strict=True))
    followed = min(_share_near(thread, curve, within_px) for curve, thread in zip(curves, eyes, strict=True))
    right = on >= CURVE_RIGHT and followed >= THREAD_FOLLOWED
    _draw(options, f"{path.stem}_{width}", images, eyes, curves)
    shares = {"on thread %": 100 * on, "followed %": 100 * followed}
    return row | shares | {"verdict": "right" if right else "wrong though ok", "why": ""}


def _masks(eyes: Sequence[Points], images: Pair) -> Pair:
    """The drawn thread of both eyes, as wide as it is."""
    drawn: list[Image] = []
    for thread, image in zip(eyes, images, strict=True):
        mask = np.zeros(image.shape[:2], np.uint8)
        for u, v in np.rint(thread).astype(int).tolist():
            cv2.circle(mask, (u, v), max(1, round(THREAD_RADIUS * image.shape[1])), 255, -1)
        drawn.append(mask)
    return drawn[0], drawn[1]


def without_thread(path: Path, options: Options) -> dict[str, Any]:
    """A pair of flesh without thread; a row of a table."""
    images = _pair(path, path.with_name(path.name.replace("left", "right")))
    calibration = _pad_calibration(path.parent)
    result = reconstruct_pair(
        images, calibration, masks=None, segmenter=options.segmenter, method=DEFAULT_METHOD
    ).reconstruction
    return {"pair": path.stem.removesuffix("_left"), "false thread": result.status is Status.OK, "why": result.reason}


def frame(path: Path, options: Options) -> dict[str, Any]:
    """One frame: how long each part is, and how much of it was found; a row of a table."""
    drawn = json.loads(path.read_text())
    image = _image(options.data / "suturebot_frames" / drawn["left_image"])
    mask = _thread_in(image, options)
    found = thread_centrelines(image, np.where(mask, 255, 0).astype(np.uint8)).point_px
    thread, needle, unsure = (_along(drawn[part], 1.0) for part in ("left", "needle_left", "unsure"))
    width = image.shape[1]
    certain = found[~_near(found, unsure, PRECISION_WITHIN * width)]
    steel = np.zeros(mask.shape, np.uint8)
    cv2.fillPoly(steel, [np.rint(outline).astype(np.int32) for outline in drawn["instruments"]], 1)
    for line in (*drawn["left"], *drawn["needle_left"], *drawn["unsure"]):
        cv2.polylines(steel, [np.rint(line).astype(np.int32)], isClosed=False, color=0, thickness=17)
    steel[:, : RIMS[0]] = steel[:, RIMS[1] :] = 0
    right = _near(certain, thread, PRECISION_WITHIN * width)
    _draw_mask(options, path.stem, image, mask, thread)
    return {
        "frame": path.stem.removeprefix("frame_"),
        "thread": len(thread),
        "seen": int(_near(thread, found, RECALL_WITHIN * width).sum()),
        "found": len(certain),
        "right": int(right.sum()),
        "needle": len(needle),
        "as thread": int((_near(needle, found, RECALL_WITHIN * width)).sum()),
        "steel": int(steel.sum()),
        "steel as thread": int((mask & (steel > 0)).sum()),
    }


def projected(result: ThreadReconstruction, calibration: StereoCalibration) -> tuple[Points, Points]:
    """The curve in both raw images, px; the rectified left camera must not be turned against the raw one."""
    curve = sampled(result)
    seen = []
    for K, distortion, T in (
        (calibration.K_left, calibration.distortion_left, np.eye(4)),
        (calibration.K_right, calibration.distortion_right, calibration.T_right_left),
    ):
        turn, _ = cv2.Rodrigues(T[:3, :3])
        pixels, _ = cv2.projectPoints(curve, turn, T[:3, 3], K, distortion if len(distortion) else None)
        seen.append(pixels[:, 0].astype(np.float64))
    return seen[0], seen[1]


def _thread_in(image: Image, options: Options) -> Bool[np.ndarray, "h w"]:
    return np.asarray(SEGMENTERS[options.segmenter or suitable_segmenter(image)](image) >= 128)


def _pooled(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """All frames as one."""
    return {name: "all" if name == "frame" else sum(row[name] for row in rows) for name in rows[0]}


def _near(points: Points, others: Points, within_px: float) -> Bool[np.ndarray, "n"]:
    if len(points) == 0 or len(others) == 0:
        return np.zeros(len(points), bool)
    return np.asarray(cKDTree(others).query(points)[0] <= within_px)


def _share_near(points: Points, others: Points, within_px: float) -> float:
    return float(_near(points, others, within_px).mean()) if len(points) else 0.0


def _along(lines: Iterable[Sequence[Sequence[float]]], scale: float) -> Points:
    """Places along drawn lines, evenly by length."""
    places = [np.empty((0, 2))]
    for line in lines:
        points = scale * np.array(line, np.float64)
        steps = np.hypot(*np.diff(points, axis=0).T)
        at = np.concatenate(([0.0], np.cumsum(steps)))
        along = np.arange(0.0, at[-1], EVERY_PX)
        places.append(np.column_stack([np.interp(along, at, points[:, axis]) for axis in (0, 1)]))
    return np.concatenate(places)


def _image(path: Path) -> Image:
    image = cv2.imread(str(path))
    if image is None:
        raise SystemExit(f"{path} is no image, or is not there; --data says where the material lies")
    return np.asarray(image, np.uint8)


def _pair(left: Path, right: Path) -> Pair:
    return _image(left), _image(right)


def _resized(image: Image, scale: float) -> Image:
    if scale == 1.0:
        return image
    size = round(scale * image.shape[1]), round(scale * image.shape[0])
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _pad_calibration(folder: Path) -> StereoCalibration:
    return read_calibration(folder / "pad_calibration.yaml", unit="mm", image_size=PAD_SIZE).calibration


def _scaled(calibration: StereoCalibration, scale: float) -> StereoCalibration:
    """Of the same camera with smaller pictures; whole numbers are the middles of pixels."""
    smaller = np.array([[scale, 0, 0.5 * scale - 0.5], [0, scale, 0.5 * scale - 0.5], [0, 0, 1]])
    size = round(scale * calibration.image_width), round(scale * calibration.image_height)
    K = smaller @ calibration.K_left, smaller @ calibration.K_right
    return replace(calibration, image_width=size[0], image_height=size[1], K_left=K[0], K_right=K[1])


def _draw(
    options: Options, name: str, images: Pair, drawn: Sequence[Points], curves: tuple[Points, Points] | None
) -> None:
    if options.pictures is None:
        return
    seen = [image.copy() for image in images]
    for eye, picture in enumerate(seen):
        _dots(picture, drawn[eye], (0, 255, 0))
        if curves is not None:
            _dots(picture, curves[eye], (255, 0, 255))
    _write(options.pictures / f"{name}.jpg", np.hstack(seen))


def _draw_mask(options: Options, name: str, image: Image, mask: Bool[np.ndarray, "h w"], thread: Points) -> None:
    if options.pictures is not None:
        picture = image.copy()
        picture[mask] = (255, 0, 255)
        _dots(picture, thread, (0, 255, 0))
        _write(options.pictures / f"{name}.jpg", np.hstack((image, picture)))


def _dots(picture: Image, points: Points, colour: tuple[int, int, int]) -> None:
    at = np.rint(points).astype(int)
    inside = ((at >= 0) & (at < np.array(picture.shape[1::-1]))).all(axis=1)
    picture[at[inside, 1], at[inside, 0]] = colour


def _write(path: Path, picture: Image) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), picture)


def _print(name: str, rows: Sequence[dict[str, Any]]) -> None:
    if not rows:
        return
    shown = [_with_shares(row) for row in rows] if name == "frames" else rows
    table = Table(title=name, title_justify="left")
    for column in shown[0]:
        table.add_column(column, justify="left" if isinstance(shown[0][column], str) else "right")
    for row in shown:
        table.add_row(*(f"{value:.1f}" if isinstance(value, float) else str(value) for value in row.values()))
    CONSOLE.print(table)


def _with_shares(row: dict[str, Any]) -> dict[str, Any]:
    def share(part: str, whole: str) -> float | str:
        return 100 * row[part] / row[whole] if row[whole] else "-"

    return {
        "frame": row["frame"],
        "recall %": share("seen", "thread"),
        "precision %": share("right", "found"),
        "needle as thread %": share("as thread", "needle"),
        "instrument as thread %": share("steel as thread", "steel"),
    }


if __name__ == "__main__":
    main()
