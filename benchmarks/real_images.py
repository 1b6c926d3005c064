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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import tyro

from agents.camera.image_files import read_image, read_pair
from agents.cli.reconstruct.pipeline import Pair
from agents.perception.centrelines import thread_centrelines
from agents.perception.segmentation.choice import SEGMENTERS, suitable_segmenter
from benchmarks.curve_verdicts import REFUSED, BothEyes, curve_of, near, verdict
from benchmarks.pictures import GREEN, MAGENTA, Image, Points, dotted, save
from benchmarks.scenes import Scene, reconstructed
from benchmarks.tables import Row, print_rows, share, write_json
from schemas.messages import Status, StereoCalibration
from shared.calibration.reader import read_calibration

WIDTHS = 1280, 540
RECALL_WITHIN, PRECISION_WITHIN = 6 / 1000, 8 / 1000
"""Of the image's width."""
THREAD_RADIUS = 2 / 1280
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
    options = tyro.cli(Options, description=__doc__)
    stereo = options.data / "real_stereo"
    pads, flesh, frames = (
        [path for path in sorted(folder.glob(names)) if options.only in path.stem]
        for folder, names in ((stereo, "pad_*.json"), (stereo, "flesh_*_left.png"), (FRAMES, "*.json"))
    )
    if not pads and not flesh and not frames:
        raise SystemExit(f"nothing under {options.data} has a name that contains {options.only!r}")
    found = {
        "pads": [pad(path, width, options) for path in pads for width in WIDTHS],
        "flesh": [without_thread(path, options) for path in flesh],
        "frames": [frame(path, options) for path in frames],
    }
    print_rows("pads", found["pads"])
    print_rows("flesh", found["flesh"])
    if counted := found["frames"]:
        counted.append({name: "all" if name == "frame" else sum(row[name] for row in counted) for name in counted[0]})
        print_rows("frames", [_with_shares(row) for row in counted])
    write_json(options.json, found)


def pad(path: Path, width: int, options: Options) -> Row:
    """A pair of the pads at a width; a row of a table."""
    drawn = json.loads(path.read_text())
    images = read_pair(*(path.parent / drawn[f"{eye}_image"] for eye in ("left", "right")))
    scale = width / images[0].shape[1]
    images = _resized(images[0], scale), _resized(images[1], scale)
    calibration = _scaled(_pad_calibration(path.parent), scale)
    thread: BothEyes = _along(drawn["left"], scale), _along(drawn["right"], scale)
    scene = Scene("pad", f"{path.stem}_{width}", images, calibration, _masks(thread, images))
    result = reconstructed(scene, scene.masks if options.masks else None, options.segmenter).reconstruction
    row: Row = {"pair": path.stem, "width": width, "status": result.status.name.lower()}
    curve, ok = (np.zeros((0, 2)), np.zeros((0, 2))), result.status is Status.OK
    if ok:
        curve = curve_of(result, calibration)
    if options.pictures is not None:
        of_eyes = zip(images, thread, curve, strict=True)
        drawings = [dotted(image, (true, GREEN), (found, MAGENTA)) for image, true, found in of_eyes]
        save(options.pictures / f"{scene.name}.jpg", *drawings)
    if not ok:
        return row | {"on thread %": None, "followed %": None, "verdict": REFUSED, "why": result.reason}
    return row | verdict(curve, [(thread, thread)], width) | {"why": ""}


def _masks(thread: BothEyes, images: Pair) -> Pair:
    """The drawn thread of both eyes, as wide as it is."""
    drawn: list[Image] = []
    for places, image in zip(thread, images, strict=True):
        mask = np.zeros(image.shape[:2], np.uint8)
        for u, v in np.rint(places).astype(int).tolist():
            cv2.circle(mask, (u, v), max(1, round(THREAD_RADIUS * image.shape[1])), 255, -1)
        drawn.append(mask)
    return drawn[0], drawn[1]


def without_thread(path: Path, options: Options) -> Row:
    """A pair of flesh without thread; a row of a table."""
    images, name = read_pair(path, path.with_name(path.name.replace("left", "right"))), path.stem.removesuffix("_left")
    scene = Scene("flesh", name, images, _pad_calibration(path.parent))
    result = reconstructed(scene, segmenter=options.segmenter).reconstruction
    return {"pair": name, "false thread": result.status is Status.OK, "why": result.reason}


def frame(path: Path, options: Options) -> Row:
    """One frame: how long each part is, and how much of it was found; a row of a table."""
    drawn = json.loads(path.read_text())
    image = read_image(options.data / "suturebot_frames" / drawn["left_image"])
    mask = np.asarray(SEGMENTERS[options.segmenter or suitable_segmenter(image)](image) >= 128)
    found = thread_centrelines(image, np.where(mask, 255, 0).astype(np.uint8)).point_px
    thread, needle, unsure = (_along(drawn[part], 1.0) for part in ("left", "needle_left", "unsure"))
    recall_px, precision_px = (within * image.shape[1] for within in (RECALL_WITHIN, PRECISION_WITHIN))
    certain = found[~near(found, unsure, precision_px)]
    steel = np.zeros(mask.shape, np.uint8)
    cv2.fillPoly(steel, [np.rint(outline).astype(np.int32) for outline in drawn["instruments"]], 1)
    for line in (*drawn["left"], *drawn["needle_left"], *drawn["unsure"]):
        cv2.polylines(steel, [np.rint(line).astype(np.int32)], isClosed=False, color=0, thickness=17)
    steel[:, : RIMS[0]] = steel[:, RIMS[1] :] = 0
    if options.pictures is not None:
        picture = image.copy()
        picture[mask] = MAGENTA
        save(options.pictures / f"{path.stem}.jpg", image, dotted(picture, (thread, GREEN)))
    return {
        "frame": path.stem.removeprefix("frame_"),
        "thread": len(thread),
        "seen": int(near(thread, found, recall_px).sum()),
        "found": len(certain),
        "right": int(near(certain, thread, precision_px).sum()),
        "needle": len(needle),
        "as thread": int(near(needle, found, recall_px).sum()),
        "steel": int(steel.sum()),
        "steel as thread": int((mask & (steel > 0)).sum()),
    }


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


def _with_shares(row: Row) -> Row:
    return {
        "frame": row["frame"],
        "recall": share(row["seen"], row["thread"]),
        "precision": share(row["right"], row["found"]),
        "needle as thread": share(row["as thread"], row["needle"]),
        "instrument as thread": share(row["steel as thread"], row["steel"]),
    }


if __name__ == "__main__":
    main()
