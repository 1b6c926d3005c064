"""What goes wrong with stereo pairs, done to images as the camera gives them, from what hardly shows to what must."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

Pair = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Damage:
    """Something that goes wrong with pairs, at one size.

    Fields:
        codes: any of these is a right answer.
        do: what it makes of a pair, given a pair of another scene besides.
    """

    name: str
    size: str
    codes: frozenset[str]
    do: Callable[[Pair, Pair], Pair]


def moved(image: np.ndarray, M: np.ndarray) -> np.ndarray:
    """The image under an affine map, black beyond its borders."""
    return cv2.warpAffine(image, M, image.shape[1::-1], flags=cv2.INTER_CUBIC)


def shifted(image: np.ndarray, right_px: float, down_px: float) -> np.ndarray:
    """Moved by so much."""
    return moved(image, np.array([[1.0, 0.0, right_px], [0.0, 1.0, down_px]]))


def turned(image: np.ndarray, degrees: float, larger: float = 1.0) -> np.ndarray:
    """Turned clockwise about its middle, and magnified."""
    height, width = image.shape[:2]
    return moved(image, cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), -degrees, larger))


def noisy(image: np.ndarray) -> np.ndarray:
    """With noise of 2 grey levels, which a sensor adds after whatever blurs."""
    return np.asarray(cv2.add(image, _noise(image.shape), dtype=cv2.CV_8U))


@lru_cache(maxsize=4)
def _noise(shape: tuple[int, ...]) -> np.ndarray:
    return 2.0 * np.random.default_rng(0).standard_normal(shape, dtype=np.float32)


def out_of_focus(image: np.ndarray, px: float) -> np.ndarray:
    """Blurred, by a standard deviation for an image 960 px wide."""
    return noisy(cv2.GaussianBlur(image, (0, 0), px * image.shape[1] / 960))


def smeared(image: np.ndarray, px: int, degrees: float = 0.0) -> np.ndarray:
    """Moved while it was exposed, by so much in an image 960 px wide, at an angle from right to down."""
    length = max(1, round(px * image.shape[1] / 960))
    along = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    kernel = np.zeros((2 * length + 1,) * 2, np.float32)
    u, v = np.rint(length + np.linspace(-0.5, 0.5, 8 * length)[:, None] * (length - 1) * along).astype(int).T
    np.add.at(kernel, (v, u), 1.0)
    return noisy(cv2.filter2D(image, -1, kernel / kernel.sum()))


def woven(image: np.ndarray, px: int) -> np.ndarray:
    """Every other row of a moment when all lay further right."""
    rows = image.copy()
    rows[1::2] = np.roll(image, px, axis=1)[1::2]
    return rows


def brightened(image: np.ndarray, gain: float) -> np.ndarray:
    """As with so many times the light."""
    return noisy(np.clip(image.astype(np.float32) * gain, 0, 255).astype(np.uint8))


def of_right(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Pair, Pair], Pair]:
    """What befalls the right eye alone."""
    return lambda pair, _: (pair[0], change(pair[1]))


def of_both(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Pair, Pair], Pair]:
    """What befalls both eyes."""
    return lambda pair, _: (change(pair[0]), change(pair[1]))


def cropped(image: np.ndarray, share: float) -> np.ndarray:
    """A share cut off each side, without scaling."""
    dv, du = (round(share * side) for side in image.shape[:2])
    return np.ascontiguousarray(image[dv : image.shape[0] - dv, du : image.shape[1] - du])


def damages() -> Iterator[Damage]:
    """What is tried, from what hardly shows to what must."""
    rows = frozenset(("row_residual", "row_offset"))
    for px in (1.5, 2, 4, 10, 40):
        yield Damage("right eye lower", f"{px:g} px", rows, of_right(lambda i, px=px: shifted(i, 0, px)))
    turn = frozenset(("rotated", "row_residual"))
    for degrees in (0.2, 0.5, 2, 10, 180):
        yield Damage("right eye turned", f"{degrees:g} deg", turn, of_right(lambda i, d=degrees: turned(i, d)))
    sizes = frozenset(("sizes_differ",))
    for larger in (1.005, 1.01, 1.03, 1.2):
        yield Damage("right eye larger", f"{larger - 1:.1%}", sizes, of_right(lambda i, m=larger: turned(i, 0, m)))
    swapped = frozenset(("left_right_swapped", "mirrored", "rotated"))
    yield Damage("exchanged", "", swapped, lambda pair, _: (pair[1], pair[0]))
    yield Damage("both mirrored", "", swapped, of_both(lambda i: np.ascontiguousarray(i[:, ::-1])))
    yield Damage("both upside down", "", swapped, of_both(lambda i: np.ascontiguousarray(i[::-1, ::-1])))
    yield Damage("right eye mirrored", "", frozenset(("mirrored",)), of_right(lambda i: i[:, ::-1].copy()))
    yield Damage("right eye flipped", "", frozenset(("mirrored",)), of_right(lambda i: i[::-1].copy()))
    yield Damage("one image twice", "", frozenset(("no_disparity",)), lambda pair, _: (pair[0], pair[0]))
    yield Damage("right eye of another scene", "", frozenset(("nothing_corresponds",)), lambda p, q: (p[0], q[1]))
    yield Damage("both moved apart", "15 %", frozenset(("disparity_range", "distance_implausible")), _apart)
    for share in (0.05, 0.2):
        size = frozenset(("size",))
        yield Damage("both cropped", f"{share:.0%}", size, of_both(lambda i, s=share: cropped(i, s)))
    yield Damage("both scaled", "50 %", frozenset(("size",)), of_both(lambda i: cv2.resize(i, None, fx=0.5, fy=0.5)))
    for gain in (0.25, 0.1):
        dark = frozenset(("too_dark", "no_picture"))
        yield Damage("both too dark", f"x {gain:g}", dark, of_both(lambda i, g=gain: brightened(i, g)))
    for gain in (2, 4):
        yield Damage(
            "both too bright", f"x {gain}", frozenset(("too_bright",)), of_both(lambda i, g=gain: brightened(i, g))
        )
    differ = frozenset(("exposures_differ", "too_dark"))
    yield Damage("right eye darker", "x 0.5", differ, of_right(lambda i: brightened(i, 0.5)))
    yield Damage("right eye black", "", frozenset(("no_picture",)), of_right(np.zeros_like))
    for px in (1.5, 2, 3, 5):
        yield Damage(
            "both out of focus", f"{px:g} px", frozenset(("blurred",)), of_both(lambda i, p=px: out_of_focus(i, p))
        )
    yield Damage("right eye out of focus", "3 px", frozenset(("blurred",)), of_right(lambda i: out_of_focus(i, 3)))
    codes = frozenset(("smeared", "blurred"))
    for px in (8, 15, 25):
        yield Damage("both smeared", f"{px} px", codes, of_both(lambda i, p=px: smeared(i, p)))
    for degrees in (45, 90):
        size = f"15 px, at {degrees} deg"
        yield Damage("both smeared", size, codes, of_both(lambda i, d=degrees: smeared(i, 15, d)))
    for px in (1, 2, 6):
        yield Damage("both interlaced", f"{px} px", frozenset(("interlaced",)), of_both(lambda i, p=px: woven(i, p)))


def _apart(pair: Pair, _: Pair) -> Pair:
    return shifted(pair[0], 0.075 * pair[0].shape[1], 0), shifted(pair[1], -0.075 * pair[1].shape[1], 0)
