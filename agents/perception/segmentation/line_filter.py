"""Oriented line filters: a second derivative across a line, a long Gaussian along it, at every angle at once.

They are applied as products of spectra. The two polarities, what is darker and what is brighter than its surroundings,
are the real and the imaginary part of one complex image, and pass through together since the filters are real. Every
filter stays the same when it is turned half round, so its spectrum is real too.
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
STEP_PX = 32
"""Of the sizes in which spectra are made."""


def line_responses(
    one: Float32[np.ndarray, "h w"], other: Float32[np.ndarray, "h w"]
) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """How much each pixel of two contrasts looks like part of a line, in their grey levels, by the best filter."""
    shape = _padded_shape(one)
    padded = np.zeros(shape, np.complex64)
    _inner(padded, one)[:] = _with_border(one) + np.complex64(1j) * _with_border(other)
    spectrum = scipy.fft.fft2(padded, overwrite_x=True)
    strongest = np.zeros(shape, np.complex64)
    for filter_spectrum in _filter_spectra(*shape):
        answer = np.asarray(scipy.fft.ifft2(spectrum * filter_spectrum, overwrite_x=True))
        # real and imaginary parts lie side by side, and each has a maximum of its own
        np.maximum(strongest.view(np.float32), answer.view(np.float32), out=strongest.view(np.float32))
    return _without_border(np.real(strongest), one), _without_border(np.imag(strongest), one)


def line_response(contrast: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """The same of one contrast alone, in half the time."""
    shape = _padded_shape(contrast)
    padded = np.zeros(shape, np.float32)
    _inner(padded, contrast)[:] = _with_border(contrast)
    spectrum = np.asarray(scipy.fft.rfft2(padded))
    strongest = np.zeros(shape, np.float32)
    for filter_spectrum in _filter_spectra(*shape):
        half = spectrum * filter_spectrum[:, : spectrum.shape[1]]
        np.maximum(strongest, np.asarray(scipy.fft.irfft2(half, s=shape, overwrite_x=True)), out=strongest)
    return _without_border(strongest, contrast)


def _padded_shape(contrast: np.ndarray) -> tuple[int, int]:
    # few sizes, so that the filters' spectra need not be made anew whenever the part looked at grows by a pixel
    height, width = (STEP_PX * -(-(side + 2 * RADIUS_PX) // STEP_PX) for side in contrast.shape)
    return height, width


def _inner(padded: np.ndarray, contrast: np.ndarray) -> np.ndarray:
    return padded[: contrast.shape[0] + 2 * RADIUS_PX, : contrast.shape[1] + 2 * RADIUS_PX]


def _without_border(padded: np.ndarray, contrast: np.ndarray) -> np.ndarray:
    height, width = contrast.shape
    return np.ascontiguousarray(padded[RADIUS_PX : RADIUS_PX + height, RADIUS_PX : RADIUS_PX + width])


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


@functools.lru_cache(maxsize=16)
def _filter_spectra(height: int, width: int) -> list[Float32[np.ndarray, "h w"]]:
    """The spectrum of each filter at this size, its middle at the origin."""
    spectra: list[np.ndarray] = []
    for kernel in oriented_kernels():
        at_origin = np.zeros((height, width), np.float32)
        at_origin[: kernel.shape[0], : kernel.shape[1]] = kernel
        at_origin = np.roll(at_origin, (-RADIUS_PX, -RADIUS_PX), axis=(0, 1))
        spectra.append(np.ascontiguousarray(np.asarray(scipy.fft.fft2(at_origin)).real))
    return spectra
