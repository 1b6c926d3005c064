"""Pictures of a calibration's report: corners with their residuals, where corners were seen, and rectified rows."""

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from schemas.messages import StereoCalibration
from shared.calibration.estimation.checking import rectifying
from shared.calibration.estimation.coverage import LEAST_IN_CELL

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
    R_l, R_r, P_l, P_r = rectifying(calibration)
    size = calibration.image_width, calibration.image_height
    both: list[Picture] = []
    for image, K, distortion, R, P in (
        (left, calibration.K_left, calibration.distortion_left, R_l, P_l),
        (right, calibration.K_right, calibration.distortion_right, R_r, P_r),
    ):
        coefficients = np.array(distortion) if len(distortion) else np.zeros(5)
        maps = cv2.initUndistortRectifyMap(np.array(K), coefficients, R, P, size, cv2.CV_32FC1)
        both.append(_scaled(cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR))[0])
    drawn = np.hstack(both)
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
