"""How well segmenters find real threads over rendered tissue: the published real pairs, laid over the rendered fields.

    .venv/bin/python -m benchmarks.perception_real --data ../shared/data

The published images hold nothing but thread, on white. What is darker than white is laid, with its own colours, over a
field that the same camera sees behind the thread, so that tissue and thread have the disparities of one scene. There is
no true centreline: what perception finds in the composite is compared with the middle of the coverage that was laid,
within 2 px as in `benchmarks.perception`. Pictures go to out/ and are never committed: they show the published images.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from rich.console import Console
from rich.table import Table

from agents.cli.reconstruct.pipeline import reconstruct_pair
from agents.perception.centrelines import thread_centrelines
from agents.perception.segmenter_names import NETWORK
from agents.reconstruction.method_names import DEFAULT_METHOD
from benchmarks.centreline_share import shares
from benchmarks.perception_pictures import drawn_over
from benchmarks.scenes import GREY_REAL, REAL, Pair, Scene, scenes
from benchmarks.segmenters import COMPARED, ON_TISSUE
from schemas.messages import RectifiedStereo, Status
from shared.rectification import rectification
from shared.scene.rendered_fields import FIELDS, rendered_backdrop
from shared.scene.sensor import Sensor, expose, grain

BEHIND = 1.03
"""How far away the tissue is in the middle, as a multiple of the distance of the farthest thread."""
SEEN = Sensor(blur_px=0.0)
"""The published images are blurred already; field and thread get the noise of one sensor."""

Counts = dict[str, int]


def main() -> None:
    """Run it from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--segmenters", nargs="+", choices=ON_TISSUE, default=[NETWORK])
    parser.add_argument("--only", default="", help="run only pairs whose name contains this")
    parser.add_argument("--json", type=Path, default=Path("out/perception_real.json"))
    parser.add_argument("--pictures", type=Path, default=Path("out/perception_real"), help="never to be committed")
    parser.add_argument("--blue", action="store_true", help="exchange red and blue of the thread, which is red")
    arguments = parser.parse_args()
    chosen = [load() for name, group, load in scenes(arguments.data) if group == REAL and arguments.only in name]
    if not chosen:
        parser.error(f"no pair under {arguments.data}/ucsd_thread/real has a name that contains {arguments.only!r}")
    measured: dict[str, dict[str, Counts]] = {name: {} for name in arguments.segmenters}
    for scene in chosen:
        for field in range(1, 1 + len(list(FIELDS.iterdir()))):
            images, cover = laid_over(scene, field, arguments.blue)
            for segmenter, rows in measured.items():
                picture = arguments.pictures / f"{segmenter} {scene.name} {field}.jpg"
                rows[f"{scene.name} over field {field}"] = counts_of(scene, images, cover, segmenter, picture)
    for segmenter, rows in measured.items():
        print_counts(Console(width=120), segmenter, rows)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps(measured, indent=1) + "\n")


def laid_over(scene: Scene, field: int, blue: bool) -> tuple[Pair, Pair]:
    """Both composites, and the coverage by thread that was laid, 0 to 255."""
    threads = [image[..., ::-1].copy() if blue else image for image in scene.images]
    camera = rectification(scene.calibration).camera
    backdrop = rendered_backdrop(_looking_ahead(camera), BEHIND * _farthest_mm(scene), field)
    pairs = [
        over(image, behind, grain(image.shape[:2], 2 * field + eye))
        for eye, (image, behind) in enumerate(zip(threads, (backdrop.left_bgr, backdrop.right_bgr), strict=True))
    ]
    (left, cover_left), (right, cover_right) = pairs
    return (left, right), (cover_left, cover_right)


def over(
    image: UInt8[np.ndarray, "h w 3"], behind: UInt8[np.ndarray, "h w 3"], deviates: np.ndarray
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w"]]:
    """Thread from a white ground over another one, and its coverage.

    Coverage is one where the image is darker than GREY_REAL, softened by half a pixel, since the published images cut
    the thread out along whole pixels.
    """
    thread = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) < GREY_REAL).astype(np.uint8)
    cover = cv2.GaussianBlur(255 * thread, (3, 3), 0.5)
    share = cover[..., None] / 255.0
    # where a pixel is mixed, the thread's own colour is that of the thread beside it, not of the white ground
    own = cv2.erode(image, np.ones((3, 3), np.uint8))
    mixed = np.where(thread[..., None] > 0, image, own)
    laid = np.clip(np.rint(share * mixed + (1.0 - share) * behind), 0, 255).astype(np.uint8)
    return expose(laid, SEEN, deviates), cover


def counts_of(scene: Scene, images: Pair, cover: Pair, segmenter: str, picture: Path) -> Counts:
    """Places laid and found, given and right, over both images; writes the picture."""
    result = reconstruct_pair(
        images, scene.calibration, masks=None, segmenter=segmenter, method=DEFAULT_METHOD, segmenters=COMPARED
    )
    seen = result.observations
    counts: Counts = {"found": 0, "true": 0, "right": 0, "given": 0}
    drawn: list[np.ndarray] = []
    for image, mask, lines in zip(images, cover, (seen.centrelines_left, seen.centrelines_right), strict=True):
        laid = thread_centrelines(image, mask).point_px
        of_eye = shares(lines, laid, np.ones(len(laid), bool))
        counts = {name: number + getattr(of_eye, name) for name, number in counts.items()}
        drawn.append(drawn_over(image, lines, laid, np.ones(len(laid), bool)))
    picture.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(picture), np.hstack(drawn))
    return counts


def print_counts(console: Console, segmenter: str, rows: dict[str, Counts]) -> None:
    """A row for each pair over each field, and one for all of them."""
    table = Table(title=f"{segmenter}, centrelines within 2 px", title_justify="left")
    for column in ("pair", "recall", "precision"):
        table.add_column(column, justify="left" if column == "pair" else "right")
    every = {name: sum(row[name] for row in rows.values()) for name in ("found", "true", "right", "given")}
    for name, row in (*rows.items(), ("all", every)):
        found, right = row["found"] / max(row["true"], 1), row["right"] / max(row["given"], 1)
        table.add_row(name, f"{found:.1%}", f"{right:.1%}")
    console.print(table)


def _farthest_mm(scene: Scene) -> float:
    """How far away the thread is where it is farthest, by the masks; a few control points may be astray."""
    curve = reconstruct_pair(scene.images, scene.calibration, masks=scene.masks, segmenter=None, method=DEFAULT_METHOD)
    assert curve.reconstruction.status is Status.OK, curve.reconstruction.reason
    return float(np.percentile(curve.reconstruction.control_points_camera[:, 2], 95))


def _looking_ahead(camera: RectifiedStereo) -> RectifiedStereo:
    """The same camera with its axis in the middle, which sees the same disparities at other places of the field."""
    middle = 0.5 * (camera.image_width - 1), 0.5 * (camera.image_height - 1)
    return replace(camera, cx_px=middle[0], cy_px=middle[1], metres_per_unit=1e-3)


if __name__ == "__main__":
    main()
