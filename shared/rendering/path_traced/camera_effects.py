"""From traced light to what an endoscope's camera puts out: optics, exposure, noise, tone curve, compression."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

GAMMA = 1.0 / 2.2
BRIGHT = 0.9
KNEE = 0.8


@dataclass(frozen=True)
class Effects:
    """How the camera sees: lengths in px of an image 960 wide, noise in linear light; 0 leaves an effect out."""

    exposure: float = 0.22
    blur_px: float = 0.6
    bloom: float = 0.02
    veil: float = 0.005
    vignette: float = 0.25
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    shot_noise: float = 5e-4
    read_noise: float = 4e-3
    sharpening: float = 0.3
    jpeg_quality: int = 0
    smoke: float = 0.0
    motion_px: tuple[float, float] = (0.0, 0.0)
    interlace_px: float = 0.0


def drawn_effects(rng: np.random.Generator, wide: bool = False) -> Effects:
    """A camera as they are; `wide` draws rarer ones too, for training."""
    return Effects(
        exposure=float(rng.uniform(0.10, 0.34) if wide else rng.uniform(0.18, 0.27)),
        blur_px=float(rng.uniform(0.35, 1.6 if wide else 1.0)),
        bloom=float(rng.uniform(0.005, 0.08 if wide else 0.035)),
        veil=float(rng.uniform(0.0, 0.05 if wide else 0.02)),
        vignette=float(rng.uniform(0.05, 0.6 if wide else 0.4)),
        white_balance=(
            float(rng.normal(1.0, 0.08 if wide else 0.025)),
            1.0,
            float(rng.normal(0.97, 0.1 if wide else 0.03)),
        ),
        shot_noise=float(np.exp(rng.uniform(np.log(2e-4), np.log(4e-3 if wide else 1.1e-3)))),
        read_noise=float(rng.uniform(0.002, 0.014 if wide else 0.006)),
        sharpening=float(rng.uniform(0.0, 1.2 if wide else 0.6)),
        jpeg_quality=int(rng.choice((0, 0, *range(50 if wide else 80, 96, 3)))),
    )


def developed(
    light: Float32[np.ndarray, "h w 3"], effects: Effects, gain: float, rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """The image, blue first, of traced light, red first; `gain` is the same for both eyes of a pair."""
    image = np.minimum(light * np.float32(gain), 6.0)
    scale = image.shape[1] / 960.0
    glow = cv2.GaussianBlur(np.maximum(image - BRIGHT, 0.0), (0, 0), 4.0 * scale)
    glow += 0.5 * cv2.GaussianBlur(glow, (0, 0), 14.0 * scale)
    image = image + 8.0 * effects.bloom * glow
    image = cv2.GaussianBlur(image, (0, 0), max(effects.blur_px * scale, 0.05))
    image = _moved(image, effects, scale)
    image = _smoky(image, effects, rng)
    image = image * (1.0 - effects.veil) + effects.veil * image.mean(axis=(0, 1))
    image *= _vignette(image.shape[:2], effects.vignette)[..., None]
    image *= np.array(effects.white_balance, dtype=np.float32)
    deviation = np.sqrt(effects.read_noise**2 + effects.shot_noise * np.maximum(image, 0.0))
    image = image + deviation * rng.standard_normal(image.shape, dtype=np.float32)
    shown = toned(image)
    shown = shown + effects.sharpening * (shown - cv2.GaussianBlur(shown, (0, 0), 1.2 * scale))
    levels = np.clip(np.rint(255.0 * shown[..., ::-1]), 0, 255).astype(np.uint8)
    return _compressed(np.ascontiguousarray(levels), effects.jpeg_quality)


def gain_for(light: Float32[np.ndarray, "h w 3"], effects: Effects) -> float:
    """What brings the middle of the left image to the exposure that the effects ask for."""
    return effects.exposure / max(float(np.median(light.mean(axis=2))), 1e-4)


def gain_by_middle(light: Float32[np.ndarray, "h w 3"], effects: Effects) -> float:
    """The same for light that falls off to black: by the brighter half of the image's middle."""
    rows, columns = light.shape[:2]
    middle = light[rows // 4 : rows - rows // 4, columns // 4 : columns - columns // 4].mean(axis=2)
    return effects.exposure / max(float(np.quantile(middle, 0.6)), 1e-4)


def toned(light: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    """Display values, 0 to 1: a gamma curve whose highlights roll off."""
    value = np.power(np.maximum(light, 0.0), GAMMA)
    rolled = KNEE + (1.0 - KNEE) * np.tanh((value - KNEE) / (1.0 - KNEE))
    return np.where(value > KNEE, rolled, value).astype(np.float32)


def _vignette(shape: tuple[int, int], strength: float) -> Float32[np.ndarray, "h w"]:
    y = np.linspace(-1.0, 1.0, shape[0], dtype=np.float32)[:, None]
    x = np.linspace(-1.0, 1.0, shape[1], dtype=np.float32)
    return 1.0 - np.float32(0.5 * strength) * (x * x + y * y)


def _moved(image: Float32[np.ndarray, "h w 3"], effects: Effects, scale: float) -> Float32[np.ndarray, "h w 3"]:
    """Blur along the way that the image moves while the shutter is open; odd rows half a motion later, even before."""
    du, dv = (scale * part for part in effects.motion_px)
    steps = int(np.ceil(2.0 * np.hypot(du, dv)))
    if steps > 1:
        offsets = np.linspace(-0.5, 0.5, steps)
        image = sum((_shifted(image, du * t, dv * t) for t in offsets), np.zeros_like(image)) / np.float32(steps)
    if effects.interlace_px:
        half = 0.5 * scale * effects.interlace_px
        even, odd = _shifted(image, -half, 0.0), _shifted(image, half, 0.0)
        image = even.copy()
        image[1::2] = odd[1::2]
    return image


def _shifted(image: Float32[np.ndarray, "h w 3"], du: float, dv: float) -> Float32[np.ndarray, "h w 3"]:
    move = np.array([[1.0, 0.0, du], [0.0, 1.0, dv]])
    return cv2.warpAffine(image, move, image.shape[1::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _smoky(
    image: Float32[np.ndarray, "h w 3"], effects: Effects, rng: np.random.Generator
) -> Float32[np.ndarray, "h w 3"]:
    """Wisps that hide part of the light and scatter their own."""
    if not effects.smoke:
        return image
    density = np.zeros(image.shape[:2], dtype=np.float32)
    for octave in range(4):
        cells = rng.uniform(0.0, 1.0, (3 * 2**octave + 2, 5 * 2**octave + 2)).astype(np.float32)
        density += 0.6**octave * cv2.resize(cells, image.shape[1::-1], interpolation=cv2.INTER_CUBIC)
    density = (density - density.min()) / max(float(np.ptp(density)), 1e-6)
    cover = np.clip(effects.smoke * density**1.5, 0.0, 0.95)[..., None]
    return (image * (1.0 - cover) + cover * np.float32(1.3 * effects.exposure)).astype(np.float32)


def _compressed(levels: UInt8[np.ndarray, "h w 3"], quality: int) -> UInt8[np.ndarray, "h w 3"]:
    if not quality:
        return levels
    _, data = cv2.imencode(".jpg", levels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
