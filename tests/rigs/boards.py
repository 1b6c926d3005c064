"""Images of a calibration board through a known stereo camera, lens and all, with a sensor's blur and noise.

Each pixel is traced back to the board's plane, twice as many each way as the image has: edges are as soft as a pixel.
"""

from functools import cache

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from schemas.messages import StereoCalibration
from shared.calibration.estimation.board import Board
from shared.rigid_transforms import exp_so3, transform

FINER = 2
TEXTURE_PX = 48
"""Of a square of the board's picture."""
MARGIN_SQUARES = 1.0
GROUND, BOARD_LEVELS = 90.0, (45.0, 205.0)
BLUR_PX, NOISE = 0.7, 2.0

Pair = tuple[UInt8[np.ndarray, "h w"], UInt8[np.ndarray, "h w"]]


def endoscope(width: int = 960, height: int = 540) -> StereoCalibration:
    """A plausible stereo endoscope in millimetres, with nothing symmetric about it."""
    share = width / 960
    scale = np.array([[share], [share], [1.0]])
    return StereoCalibration(
        image_width=width,
        image_height=height,
        K_left=scale * np.array([[811.5, 0, 438.7], [0, 812.25, 288.1], [0, 0, 1]]),
        K_right=scale * np.array([[810.1, 0, 509.7], [0, 810.6, 283.6], [0, 0, 1]]),
        distortion_left=np.array([-0.33, 0.14, -0.0017, 0.001, 0.0]),
        distortion_right=np.array([-0.31, 0.12, -0.0016, 0.0004, 0.0]),
        T_right_left=transform(exp_so3(np.array([0.005, -0.018, 0.003])), np.array([-5.6, 0.06, -0.14])),
        metres_per_unit=1e-3,
    )


def picture(board: Board) -> UInt8[np.ndarray, "h w"]:
    """The board as it is printed, with a white margin."""
    size = board.columns * TEXTURE_PX, board.rows * TEXTURE_PX
    if board.marker is None:
        colours = np.add.outer(np.arange(board.rows), np.arange(board.columns)) % 2
        squares = np.kron(255 * colours, np.ones((TEXTURE_PX, TEXTURE_PX))).astype(np.uint8)
    else:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        pattern = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, dictionary)
        squares = np.asarray(pattern.generateImage(size))
    margin = round(MARGIN_SQUARES * TEXTURE_PX)
    return np.pad(squares, margin, constant_values=255)


def standings(count: int, board: Board, seed: int, away: float = 75.0) -> list[Float64[np.ndarray, "4 4"]]:
    """How a person holds a board before an endoscope: T_left_board, everywhere in view, tilted, near and far."""
    rng = np.random.default_rng(seed)
    middle = np.array([board.columns, board.rows, 0.0]) * board.square / 2
    found: list[Float64[np.ndarray, "4 4"]] = []
    for _ in range(count):
        R = exp_so3(np.append(rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.4, 0.4)))
        z = away * rng.uniform(0.75, 1.35)
        at = np.array([rng.uniform(-0.24, 0.24) * z + 2.8, rng.uniform(-0.14, 0.14) * z, z])
        found.append(transform(R, at - R @ middle))
    return found


def rendered(calibration: StereoCalibration, board: Board, T_left_board: np.ndarray, seed: int) -> Pair:
    """What both eyes see of a board."""
    c, printed, rng = calibration, picture(board), np.random.default_rng(seed)
    left, right = (
        _seen(c, K, distortion, board, printed, T)
        for K, distortion, T in (
            (c.K_left, c.distortion_left, T_left_board),
            (c.K_right, c.distortion_right, c.T_right_left @ T_left_board),
        )
    )
    return _sensed(left, rng), _sensed(right, rng)


def _seen(
    calibration: StereoCalibration,
    K: np.ndarray,
    distortion: np.ndarray,
    board: Board,
    printed: np.ndarray,
    T: np.ndarray,
) -> np.ndarray:
    width, height = FINER * calibration.image_width, FINER * calibration.image_height
    # a ray meets the plane z = 0 of the board where (r1 r2 t) (x, y, 1) is along it
    to_board = np.linalg.inv(np.column_stack((T[:3, 0], T[:3, 1], T[:3, 3])))
    met = _rays(width, height, K.tobytes(), distortion.tobytes()) @ to_board.T
    on_board = (met[:, :2] / met[:, 2:]).reshape(height, width, 2)
    # far from the board all is ground, and no float is too large
    at = np.clip((on_board / board.square + MARGIN_SQUARES) * TEXTURE_PX - 0.5, -1e4, 1e4).astype(np.float32)
    low, high = BOARD_LEVELS
    levels = (low + (high - low) / 255 * printed).astype(np.float32)
    seen = cv2.remap(
        levels, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(GROUND,)
    )
    return cv2.resize(seen, (calibration.image_width, calibration.image_height), interpolation=cv2.INTER_AREA)


@cache
def _rays(width: int, height: int, K: bytes, distortion: bytes) -> Float64[np.ndarray, "p 3"]:
    """The direction of every traced pixel of a camera, which all its images share."""
    v, u = np.mgrid[:height, :width].astype(np.float64)
    px = (np.stack((u, v), axis=-1) + 0.5) / FINER - 0.5
    at = cv2.undistortPoints(
        px.reshape(-1, 1, 2), np.frombuffer(K).reshape(3, 3).copy(), np.frombuffer(distortion).copy()
    )
    return np.column_stack((np.asarray(at).reshape(-1, 2), np.ones(width * height)))


def _sensed(image: np.ndarray, rng: np.random.Generator) -> UInt8[np.ndarray, "h w"]:
    blurred = cv2.GaussianBlur(image, (0, 0), BLUR_PX)
    return np.clip(np.rint(blurred + rng.normal(0, NOISE, image.shape)), 0, 255).astype(np.uint8)
