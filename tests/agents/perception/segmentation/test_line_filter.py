"""The line filters on lines of known direction, and against OpenCV's own convolution."""

import cv2
import numpy as np
import pytest

from agents.perception.segmentation.line_filter import line_response, line_responses, oriented_kernels


def test_the_response_to_a_line_is_greatest_on_it_whatever_its_direction():
    for degrees in np.arange(0, 180, 10.0):
        direction = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
        v, u = np.mgrid[:61, :61] - 30.0
        across = u * direction[1] - v * direction[0]
        contrast = (50 * np.exp(-0.5 * across**2)).astype(np.float32)
        response, of_nothing = line_responses(contrast, np.zeros_like(contrast))
        middle = np.s_[15:46, 15:46]
        on, beside = np.abs(across[middle]) < 0.5, np.abs(across[middle]) > 3
        assert response[middle][on].min() > 20
        assert response[middle][beside].max() < 0.25 * response[middle][on].min()
        assert of_nothing.max() < 1e-3


@pytest.mark.parametrize("shape", [(1, 1), (3, 40), (61, 83), (270, 480)])
def test_both_responses_are_those_of_convolutions_one_by_one(shape):
    contrasts = np.random.default_rng(1).uniform(0, 60, (2, *shape)).astype(np.float32)
    for contrast, response in zip(contrasts, line_responses(*contrasts), strict=True):
        answers = [cv2.filter2D(contrast, cv2.CV_32F, k, borderType=cv2.BORDER_REFLECT) for k in oriented_kernels()]
        np.testing.assert_allclose(response, np.maximum(np.max(answers, axis=0), 0.0), atol=1e-3)
        np.testing.assert_allclose(line_response(contrast), response, atol=1e-4)
