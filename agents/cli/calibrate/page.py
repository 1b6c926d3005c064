"""The report of a calibration: one HTML page with its pictures beside it.

The pictures show corners with their residuals, where corners were seen, and rectified rows.
"""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from agents.camera.image_files import read_pair, read_side_by_side
from agents.cli.calibrate.views import Seen
from schemas.messages import StereoCalibration
from shared.calibration.estimation.board import Board
from shared.calibration.estimation.checking import Checked
from shared.calibration.estimation.coverage import LEAST_IN_CELL, coverage, lacking
from shared.calibration.estimation.estimate import Estimate, rms
from shared.html_page import figure, page, paragraph, table
from shared.rectification import rectification, rectify_image
from shared.units import unit_name

WIDTH_PX = 760
"""Of one eye's picture."""
LARGER = 40.0
"""How many times longer residuals are drawn than they are."""
ROWS = 18
CORNER, ARROW, ROW, LACKING, SEEN = (80, 220, 80), (60, 60, 255), (80, 220, 255), (60, 60, 220), (255, 180, 60)

Picture = UInt8[np.ndarray, "h w 3"]


def with_residuals(
    image: UInt8[np.ndarray, "h w *c"], px: Float64[np.ndarray, "n 2"], residual_px: Float64[np.ndarray, "n 2"]
) -> Picture:
    """An image with the corners found in it, and by how much each is off, enlarged."""
    drawn, share = _scaled(image)
    for at, off in zip(px, residual_px, strict=True):
        begin, end = at * share, at * share + off * LARGER * share
        cv2.circle(drawn, _pixel(begin), 3, CORNER, 1, cv2.LINE_AA)
        cv2.arrowedLine(drawn, _pixel(begin), _pixel(end), ARROW, 1, cv2.LINE_AA, tipLength=0.25)
    return drawn


def where_seen(
    image: UInt8[np.ndarray, "h w *c"], places: Float64[np.ndarray, "n 2"], cells: Int64[np.ndarray, "r c"]
) -> Picture:
    """All corners of all views in one image, with the parts that have too few of them in red."""
    drawn, share = _scaled(image // 3)
    height, width = drawn.shape[:2]
    rows, columns = cells.shape
    for row, column in np.argwhere(cells < LEAST_IN_CELL):
        corner = column * width // columns, row * height // rows
        opposite = (column + 1) * width // columns - 1, (row + 1) * height // rows - 1
        cv2.rectangle(drawn, corner, opposite, LACKING, 2)
    for at in places * share:
        cv2.circle(drawn, _pixel(at), 2, SEEN, -1, cv2.LINE_AA)
    return drawn


def rectified_rows(
    left: UInt8[np.ndarray, "h w *c"], right: UInt8[np.ndarray, "h w *c"], calibration: StereoCalibration
) -> Picture:
    """Both images rectified, side by side, with rows drawn through them: the same things must lie on each."""
    ready = rectification(calibration)
    both = rectify_image(left, ready.map_left), rectify_image(right, ready.map_right)
    drawn = np.hstack([_scaled(image)[0] for image in both])
    for v in np.linspace(0, drawn.shape[0] - 1, ROWS + 2)[1:-1].astype(int).tolist():
        cv2.line(drawn, (0, v), (drawn.shape[1] - 1, v), ROW, 1)
    return drawn


def _scaled(image: UInt8[np.ndarray, "h w *c"]) -> tuple[Picture, float]:
    colour = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
    share = WIDTH_PX / image.shape[1]
    size = WIDTH_PX, max(1, round(share * image.shape[0]))
    return np.asarray(cv2.resize(colour, size, interpolation=cv2.INTER_AREA), np.uint8).copy(), share


def _pixel(at: Float64[np.ndarray, "2"]) -> tuple[int, int]:
    # what is far out of the picture is drawn at its border
    u, v = np.clip(np.rint(at), -20_000, 20_000).astype(int).tolist()
    return u, v


RECTIFIED_VIEWS = 2
PICTURES_BESIDE = "script-src 'none'; style-src 'unsafe-inline'"
"""The page's policy: its pictures are files beside it, which browsers do not take for its own."""

Row = tuple[str, ...]


def write_report(folder: Path, board: Board, seen: Seen, estimate: Estimate, apart: tuple[Checked, ...]) -> Path:
    """Write the page and its pictures; the path of the page."""
    pictures = folder / "pictures"
    pictures.mkdir(exist_ok=True)
    drawn = dict(_pictures(board, seen, estimate))
    for name, (picture, _) in drawn.items():
        (pictures / name).write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    captions = {name: caption for name, (_, caption) in drawn.items()}
    path = folder / "report.html"
    parts = page("Stereo calibration", _parts(board, seen, estimate, apart, captions), policy=PICTURES_BESIDE)
    path.write_text("".join(parts), encoding="utf-8")
    return path


def _parts(
    board: Board, seen: Seen, estimate: Estimate, apart: tuple[Checked, ...], captions: dict[str, str]
) -> Iterator[str]:
    yield table(("", " left", " right"), _cameras(estimate))
    yield table(("from left to right", " ", " ", " "), _between(estimate))
    missing = lacking(coverage(estimate.views, board, seen.image_size))
    yield "<h2>What the views lack</h2>"
    yield from map(paragraph, missing or ["Nothing."])
    yield "<h2>Views</h2><p>Residuals are root mean squares. Held out: of a calibration made without that view.</p>"
    heads = ("view", " corners", " left, px", " right, px", " held out, px", " rows apart, px", " squares")
    yield table(heads, _views(estimate, apart))
    for name, px in estimate.left_out:
        yield paragraph(f"Left out, for it contradicts the others by {px:.2f} px: {name}")
    for no_view in seen.none:
        yield paragraph(f"Not used: {no_view.name}: {no_view.reason}")
    yield "<h2>Pictures</h2>"
    for name, caption in captions.items():
        yield figure(f'<img src="pictures/{name}" alt="">', caption)


def _cameras(estimate: Estimate) -> Iterator[Row]:
    c = estimate.calibration
    for name, at in (("fx, px", (0, 0)), ("fy, px", (1, 1)), ("cx, px", (0, 2)), ("cy, px", (1, 2))):
        yield name, f"{c.K_left[at]:.3f}", f"{c.K_right[at]:.3f}"
    for name, left, right in zip(("k1", "k2", "p1", "p2", "k3"), c.distortion_left, c.distortion_right, strict=False):
        yield name, f"{left:.5f}", f"{right:.5f}"


def _between(estimate: Estimate) -> Iterator[Row]:
    T = estimate.calibration.T_right_left
    unit = unit_name(estimate.calibration.metres_per_unit) or "units"
    yield f"translation, {unit}", *(f"{value:.4f}" for value in T[:3, 3])
    for row in T[:3, :3]:
        yield "rotation", *(f"{value:.6f}" for value in row)


def _views(estimate: Estimate, apart: tuple[Checked, ...]) -> Iterator[Row]:
    held = {one.view.name: one for one in apart}
    for view, left, right in zip(estimate.views, estimate.residual_left_px, estimate.residual_right_px, strict=True):
        one = held.get(view.name)
        told = ("", "", "")
        if one is not None:
            told = f"{one.rms_px:.2f}", f"{np.median(np.abs(one.rows_px)):.2f}", f"{one.size - 1:+.2%}"
        yield view.name, str(len(view.number)), f"{rms(left):.2f}", f"{rms(right):.2f}", *told


def _pictures(board: Board, seen: Seen, estimate: Estimate) -> Iterator[tuple[str, tuple[np.ndarray, str]]]:
    covered = coverage(estimate.views, board, seen.image_size)
    for index, view in enumerate(estimate.views):
        left, right = _images(seen, view.name)
        if index == 0:
            places = [np.concatenate([getattr(v, eye) for v in estimate.views]) for eye in ("left", "right")]
            both = where_seen(left, places[0], covered.left), where_seen(right, places[1], covered.right)
            yield "coverage.png", (np.hstack(both), "All corners of all views; red parts of an image have too few")
        if index < RECTIFIED_VIEWS:
            rows = rectified_rows(left, right, estimate.calibration)
            yield f"rectified{index}.png", (rows, f"{view.name}, rectified: what is on a row must stay on it")
    for index, view in enumerate(estimate.views):
        left, right = _images(seen, view.name)
        both = (
            with_residuals(left, view.left, estimate.residual_left_px[index]),
            with_residuals(right, view.right, estimate.residual_right_px[index]),
        )
        yield (
            f"view{index:02d}.png",
            (np.hstack(both), f"{view.name}: corners, and residuals {LARGER:.0f} times enlarged"),
        )


def _images(seen: Seen, name: str) -> tuple[np.ndarray, np.ndarray]:
    first, second = seen.files[name]
    return read_side_by_side(first) if second is None else read_pair(first, second)
