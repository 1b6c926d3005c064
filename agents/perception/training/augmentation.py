"""Variations of a view that keep what is thread: place, size and turn; light and colour; lens, motion and sensor.

About half of the crops are only mirrored and turned by right angles, so that their coverage stays as sharp as rendered.
"""

import cv2
import numpy as np
from jaxtyping import UInt8

from agents.perception.training.clutter import Coverage, Image, with_glints, with_smoke, with_tools, with_vessels
from agents.perception.training.dyeing import with_other_dye

RESAMPLED_SHARE = 0.55
DYED_SHARE = 0.45
SCALE = 0.6, 1.7
"""Of a resampled crop: the same thread is nearer or farther, or the camera has more or fewer pixels."""


def varied(image: Image, coverage: Coverage, rng: np.random.Generator) -> tuple[Image, Coverage]:
    """A square view and its coverage, varied in everything but their size and place."""
    image, coverage = _mirrored(image, coverage, rng)
    if rng.uniform() < DYED_SHARE:
        image = with_other_dye(image, coverage, rng)
    if rng.uniform() < 0.25:
        image = with_vessels(image, coverage, rng)
    if rng.uniform() < 0.25:
        image = with_glints(image, coverage, rng)
    if rng.uniform() < 0.25:
        image, coverage = with_tools(image, coverage, rng)
    image = _recoloured(image, rng)
    if rng.uniform() < 0.1:
        image = with_smoke(image, rng)
    if rng.uniform() < 0.06:
        image, coverage = _interlaced(image, coverage, rng)
    return _seen_by_sensor(image, rng), coverage


def crop_of(
    image: Image, coverage: Coverage, centre: np.ndarray, side: int, rng: np.random.Generator
) -> tuple[Image, Coverage]:
    """A square around a pixel (x, y), turned and scaled at random in part of the cases; mirrored at the border."""
    resampled = rng.uniform() < RESAMPLED_SHARE
    scale = float(np.exp(rng.uniform(*np.log(SCALE)))) if resampled else 1.0
    turn = rng.uniform(0, 2 * np.pi) if resampled else 0.0
    if scale < 0.8:
        # what is drawn smaller is averaged first
        sigma = 0.35 / scale
        image, coverage = cv2.GaussianBlur(image, (0, 0), sigma), cv2.GaussianBlur(coverage, (0, 0), sigma)
    towards = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) / scale
    middle = np.full(2, (side - 1) / 2)
    at = centre if resampled else np.rint(centre + 0.5) - 0.5
    move = np.column_stack((towards, at - towards @ middle))
    how = (cv2.INTER_LINEAR if resampled else cv2.INTER_NEAREST) | cv2.WARP_INVERSE_MAP
    seen, covered = (
        cv2.warpAffine(part, move, (side, side), flags=how, borderMode=cv2.BORDER_REFLECT_101)
        for part in (image, coverage)
    )
    return np.asarray(seen, np.uint8), np.asarray(covered, np.uint8)


def _mirrored(image: Image, coverage: Coverage, rng: np.random.Generator) -> tuple[Image, Coverage]:
    quarter_turns, flipped = int(rng.integers(4)), rng.uniform() < 0.5
    turned = (np.rot90(part, quarter_turns) for part in (image, coverage))
    seen, covered = (np.ascontiguousarray(part[:, ::-1] if flipped else part) for part in turned)
    return seen, covered


def _recoloured(image: Image, rng: np.random.Generator) -> Image:
    """Another lamp, white balance, exposure and tone curve; another hue of everything; colours stronger or weaker."""
    if rng.uniform() < 0.5:
        hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV).astype(np.float32)
        hsv[..., 0] = np.mod(hsv[..., 0] + rng.normal(0, 8), 180)
        hsv[..., 1] = np.clip(hsv[..., 1] * np.exp(rng.normal(0, 0.35)), 0, 255)
        image = cv2.cvtColor(hsv.astype(np.uint8), cv2.COLOR_HSV2BGR)
    if rng.uniform() < 0.05:
        image = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    level = np.arange(256, dtype=np.float32) / 255
    gain = np.exp(rng.normal(0, 0.12, 3) + rng.normal(0, 0.15))
    gamma, lift = np.exp(rng.normal(0, 0.22)), rng.uniform(-0.04, 0.06)
    curves = np.clip(gain * level[:, None] ** gamma + lift, 0, 1)
    return np.asarray(cv2.LUT(image, np.rint(255 * curves).astype(np.uint8).reshape(256, 1, 3)), np.uint8)


def _interlaced(image: Image, coverage: Coverage, rng: np.random.Generator) -> tuple[Image, Coverage]:
    """Odd rows seen a little later than even ones."""
    shift = int(rng.integers(1, 4))
    image, coverage = image.copy(), coverage.copy()
    for part in (image, coverage):
        part[1::2] = np.roll(part[1::2], shift, axis=1)
    return image, coverage


def _seen_by_sensor(image: Image, rng: np.random.Generator) -> Image:
    """Out of focus or moved, noisy, sharpened and compressed, each at times."""
    if rng.uniform() < 0.5:
        image = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.3, 1.4)))
    if rng.uniform() < 0.08:
        image = _moved(image, rng)
    if rng.uniform() < 0.6:
        image = _noisy(image, rng)
    if rng.uniform() < 0.2:
        amount = rng.uniform(0.2, 1.0)
        image = cv2.addWeighted(image, 1 + amount, cv2.GaussianBlur(image, (0, 0), 1.2), -amount, 0)
    if rng.uniform() < 0.4:
        packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(40, 96))])[1]
        image = np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR))
    return np.asarray(image, np.uint8)


def _moved(image: Image, rng: np.random.Generator) -> Image:
    length, turn = int(rng.integers(3, 9)) | 1, rng.uniform(0, np.pi)
    kernel = np.zeros((length, length), np.float32)
    reach = (length // 2) * np.array([np.cos(turn), np.sin(turn)])
    ends = [tuple(np.rint(length // 2 + sign * reach).astype(int).tolist()) for sign in (-1, 1)]
    cv2.line(kernel, ends[0], ends[1], 1.0)
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), np.uint8)


def _noisy(image: Image, rng: np.random.Generator) -> UInt8[np.ndarray, "h w 3"]:
    read, shot = rng.uniform(0, 6), rng.uniform(0, 9)
    deviation = np.sqrt(read**2 + shot**2 * image.astype(np.float32) / 255)
    grain = rng.standard_normal(image.shape, np.float32)
    if rng.uniform() < 0.3:
        # video smooths its noise
        grain = cv2.GaussianBlur(grain, (0, 0), 0.7) * 1.8
    return np.clip(image + deviation * grain + 0.5, 0, 255).astype(np.uint8)
