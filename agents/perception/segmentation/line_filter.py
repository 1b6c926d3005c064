"""Oriented line filters: a second derivative across a line, a long Gaussian along it, at every angle at once.

They are applied as products of spectra. The two polarities, what is darker and what is brighter than its surroundings,
are the real and the imaginary part of one complex image, and pass through together since the filters are real. Every
filter is even in both directions at once, so its spectrum is real too.
"""

import functools

import cv2
import numpy as np
import scipy.fft
from jaxtyping import Float32

ACROSS_PX, ALONG_PX = 1.1, 3.0
"""Standard deviations of the oriented filter: it answers best to a line 2.2 px wide, and well from 1 to 4."""
ORIENTATIONS = 12
RADIUS_PX = round(2.5 * ALONG_PX)


def line_responses(
    one: Float32[np.ndarray, "h w"], other: Float32[np.ndarray, "h w"]
) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """How much each pixel of two contrasts looks like part of a line, in their grey levels, by the best filter."""
    height, width = one.shape
    shape = tuple(scipy.fft.next_fast_len(side + 2 * RADIUS_PX) for side in (height, width))
    padded = np.zeros(shape, np.complex64)
    inner = padded[: height + 2 * RADIUS_PX, : width + 2 * RADIUS_PX]
    inner.real, inner.imag = _with_border(one), _with_border(other)
    spectrum = scipy.fft.fft2(padded, overwrite_x=True)
    strongest = np.zeros(shape, np.complex64)
    for filter_spectrum in _filter_spectra(*shape):
        answer = np.asarray(scipy.fft.ifft2(spectrum * filter_spectrum, overwrite_x=True))
        # real and imaginary parts lie side by side, and each has a maximum of its own
        np.maximum(strongest.view(np.float32), answer.view(np.float32), out=strongest.view(np.float32))
    kept = strongest[RADIUS_PX : RADIUS_PX + height, RADIUS_PX : RADIUS_PX + width]
    return np.ascontiguousarray(kept.real), np.ascontiguousarray(kept.imag)


def _with_border(contrast: np.ndarray) -> np.ndarray:
    return cv2.copyMakeBorder(contrast, RADIUS_PX, RADIUS_PX, RADIUS_PX, RADIUS_PX, cv2.BORDER_REFLECT)


def oriented_kernels() -> list[Float32[np.ndarray, "k k"]]:
    """Second derivative across, Gaussian along; each sums to 0 and its magnitudes to 2."""
    y, x = np.mgrid[-RADIUS_PX : RADIUS_PX + 1, -RADIUS_PX : RADIUS_PX + 1].astype(np.float32)
    kernels: list[np.ndarray] = []
    for angle in np.arange(ORIENTATIONS) * (np.pi / ORIENTATIONS):
        u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        kernel = (1 - (v / ACROSS_PX) ** 2) * np.exp(-0.5 * (v / ACROSS_PX) ** 2 - 0.5 * (u / ALONG_PX) ** 2)
        kernel -= kernel.mean()
        kernels.append((2 * kernel / np.abs(kernel).sum()).astype(np.float32))
    return kernels


@functools.lru_cache(maxsize=8)
def _filter_spectra(height: int, width: int) -> list[Float32[np.ndarray, "h w"]]:
    """The spectrum of each filter at this size, its middle at the origin."""
    spectra: list[np.ndarray] = []
    for kernel in oriented_kernels():
        at_origin = np.zeros((height, width), np.float32)
        at_origin[: kernel.shape[0], : kernel.shape[1]] = kernel
        at_origin = np.roll(at_origin, (-RADIUS_PX, -RADIUS_PX), axis=(0, 1))
        spectra.append(np.ascontiguousarray(np.asarray(scipy.fft.fft2(at_origin)).real))
    return spectra
