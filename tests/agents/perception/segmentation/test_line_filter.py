"""The line filters on lines of known direction, and against OpenCV's own convolution."""

import cv2
import numpy as np
import pytest

from agents.perception.segmentation.line_filter import (
    ACROSS_PX,
    ALONG_PX,
    ORIENTATIONS,
    RADIUS_PX,
    across_lines,
    line_response,
    oriented_kernels,
    rough_line_response,
)


def test_the_response_to_a_line_is_greatest_on_it_whatever_its_direction():
    for degrees in np.arange(0, 180, 10.0):
        direction = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
        v, u = np.mgrid[:61, :61] - 30.0
        across = u * direction[1] - v * direction[0]
        contrast = (50 * np.exp(-0.5 * across**2)).astype(np.float32)
        response = line_response(contrast)
        middle = np.s_[15:46, 15:46]
        on, beside = np.abs(across[middle]) < 0.5, np.abs(across[middle]) > 3
        assert response[middle][on].min() > 20
        assert response[middle][beside].max() < 0.25 * response[middle][on].min()
    assert line_response(np.full((61, 61), 50, np.float32)).max() < 1e-3


@pytest.mark.parametrize("shape", [(1, 1), (3, 40), (61, 83), (270, 480)])
def test_the_response_is_that_of_the_whole_filters_one_by_one(shape):
    contrast = np.random.default_rng(1).uniform(0, 60, shape).astype(np.float32)
    answers = [cv2.filter2D(contrast, cv2.CV_32F, k, borderType=cv2.BORDER_REFLECT) for k in oriented_kernels()]
    np.testing.assert_allclose(line_response(contrast), np.maximum(np.max(answers, axis=0), 0.0), atol=1e-3)


@pytest.mark.parametrize("shape", [(60, 82), (62, 80)])
def test_half_the_size_responds_about_as_the_whole_does_to_lines_of_any_direction(shape):
    v, u = np.mgrid[: shape[0], : shape[1]] - np.array([30.0, 40.0])[:, None, None]
    for degrees in np.arange(0, 180, 10.0):
        across = u * np.sin(np.radians(degrees)) - v * np.cos(np.radians(degrees))
        contrast = (50 * np.exp(-0.5 * across**2)).astype(np.float32)
        whole = line_response(contrast).reshape(shape[0] // 2, 2, shape[1] // 2, 2).max(axis=(1, 3))
        rough = rough_line_response(cv2.resize(contrast, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
        assert rough.shape == whole.shape
        assert np.corrcoef(rough.ravel(), whole.ravel())[0, 1] > 0.9
        assert rough.max() == pytest.approx(whole.max(), rel=0.35)


def test_each_filter_is_a_second_derivative_across_a_longer_gaussian():
    y, x = np.mgrid[-RADIUS_PX : RADIUS_PX + 1, -RADIUS_PX : RADIUS_PX + 1]
    for kernel, angle in zip(oriented_kernels(), np.arange(ORIENTATIONS) * np.pi / ORIENTATIONS, strict=True):
        u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        ideal = (1 - (v / ACROSS_PX) ** 2) * np.exp(-0.5 * (v / ACROSS_PX) ** 2 - 0.5 * (u / ALONG_PX) ** 2)
        ideal *= 2 / np.abs(ideal).sum()
        assert kernel.sum() == pytest.approx(0.0, abs=1e-5)
        assert (kernel * ideal).sum() > 0.98 * np.linalg.norm(kernel) * np.linalg.norm(ideal)


def test_a_part_of_a_contrast_far_from_its_border_has_the_response_of_the_whole():
    contrast = np.random.default_rng(2).uniform(0, 60, (90, 120)).astype(np.float32)
    part = line_response(np.ascontiguousarray(contrast[10:80, 5:100]))
    inner = np.s_[RADIUS_PX:-RADIUS_PX, RADIUS_PX:-RADIUS_PX]
    np.testing.assert_allclose(part[inner], line_response(contrast)[10:80, 5:100][inner], atol=1e-4)


@pytest.mark.parametrize("degrees", range(0, 180, 15))
@pytest.mark.parametrize("sign", [1, -1])
def test_the_direction_across_a_line_is_at_a_right_angle_to_it(degrees, sign):
    direction = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    v, u = np.mgrid[:61, :81] - np.array([30.0, 40.0])[:, None, None]
    across = u * direction[1] - v * direction[0]
    contrast = (60 + sign * 50 * np.exp(-0.5 * across**2)).astype(np.float32)
    inside = (np.abs(across) < 1) & (np.hypot(u, v) < 20)
    found = across_lines(contrast, np.flatnonzero(inside))
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-5)
    assert np.abs(found @ direction).max() < 0.05


def test_the_direction_across_nothing_is_asked_of_no_pixel():
    assert across_lines(np.zeros((9, 9), np.float32), np.zeros(0, np.int64)).shape == (0, 2)
