"""Matches of hand-made threads with known disparity, and the cost against a slow loop."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.perception.paper import matching
from agents.perception.paper.matching import is_inlier, match_pixels, scaled_px, searched_disparities

WIDTH, HEIGHT = 160, 40
"""At this width the window's radius and the peak's half width are 1 px, and disparities go from 1 to 20."""
LARGEST = searched_disparities(WIDTH).stop - 1


def shifted_left(image, disparity):
    moved = np.zeros_like(image)
    moved[:, : image.shape[1] - disparity] = image[:, disparity:]
    return moved


def textured_thread(seed=0, columns=slice(60, 64)):
    """A vertical thread with a colour of its own at each pixel."""
    rng = np.random.default_rng(seed)
    image, mask = np.full((HEIGHT, WIDTH, 3), 200, np.uint8), np.zeros((HEIGHT, WIDTH), bool)
    mask[5:35, columns] = True
    image[mask] = rng.integers(0, 120, (int(mask.sum()), 3))
    return image, mask


def costs_by_the_book(left, right, segmented_left, segmented_right, pixel, disparity):
    """The sum over the window, term by term."""
    total, radius = 0.0, scaled_px(matching.WINDOW_RADIUS_PX, left.shape[1])
    for r in range(pixel[0] - radius, pixel[0] + radius + 1):
        for c in range(pixel[1] - radius, pixel[1] + radius + 1):
            if not (0 <= r < left.shape[0] and 0 <= c < left.shape[1] and segmented_left[r, c]):
                continue
            if c - disparity >= 0 and segmented_right[r, c - disparity]:
                total += float(((left[r, c].astype(float) - right[r, c - disparity]) ** 2).sum())
            else:
                total += matching.SQUARE_OFF_THREAD
    return total


@pytest.mark.parametrize("disparity", [1, 7, LARGEST])
def test_a_textured_thread_is_matched_at_its_disparity_everywhere(disparity):
    left, mask = textured_thread()
    matches = match_pixels(left, shifted_left(left, disparity), mask, shifted_left(mask, disparity))
    np.testing.assert_array_equal(matches.pixel, np.argwhere(mask))
    np.testing.assert_array_equal(matches.disparity_px, disparity)
    np.testing.assert_array_equal(matches.cost[:, 0], 0.0)
    assert is_inlier(matches.cost).all()


def test_what_has_no_candidate_has_no_match():
    left, mask = textured_thread(columns=slice(60, 61))
    for disparity in (0, LARGEST + 4):
        assert len(match_pixels(left, shifted_left(left, disparity), mask, shifted_left(mask, disparity)).pixel) == 0
    # a thread left of every candidate, and empty masks
    at_border, nothing = textured_thread(columns=slice(0, 2))[1], np.zeros_like(mask)
    for masks in ((at_border, mask), (nothing, mask), (mask, nothing), (nothing, nothing)):
        assert len(match_pixels(left, left, *masks).pixel) == 0


def test_costs_are_those_of_a_loop_over_windows():
    rng = np.random.default_rng(3)
    left, right = rng.integers(0, 256, (2, 12, WIDTH, 3), dtype=np.uint8)
    segmented_left, segmented_right = rng.random((2, 12, WIDTH)) < 0.15
    matches = match_pixels(left, right, segmented_left, segmented_right)
    assert len(matches.pixel) > 100
    for pixel, disparity, (best, second) in zip(
        matches.pixel[::9], matches.disparity_px[::9], matches.cost[::9], strict=True
    ):
        candidates = {
            d: costs_by_the_book(left, right, segmented_left, segmented_right, pixel, d)
            for d in range(1, min(LARGEST, int(pixel[1])) + 1)
        }
        of_segmented = {d: cost for d, cost in candidates.items() if segmented_right[pixel[0], pixel[1] - d]}
        assert best == pytest.approx(min(of_segmented.values()), rel=1e-6)
        assert of_segmented[int(disparity)] == pytest.approx(best, rel=1e-6)
        beyond_peak = [cost for d, cost in candidates.items() if abs(d - disparity) > 1]
        # where no window touches the right thread the cost is the greatest, never less than what the loop says
        assert second >= min(beyond_peak) * (1 - 1e-6)


@given(best=st.floats(1e-3, 1e7), ratio=st.floats(0.0, 50.0))
def test_the_metric_asks_for_a_second_peak_six_and_a_half_times_the_first(best, ratio):
    e1, e2, e3, e4 = 8.0, 5.0, 0.8, 0.9
    argument = e1 * ((best * ratio - best) / (e2 * best) - e3)
    printed = 1.0 / (1.0 + np.exp(-argument)) > e4
    limit = 1 + e2 * (e3 + np.log(e4 / (1 - e4)) / e1)
    assert limit == pytest.approx(6.4, abs=0.03)
    if abs(ratio - limit) > 1e-6:
        assert is_inlier(np.array([[best, best * ratio]]))[0] == printed == (ratio > limit)
    # a perfect match is kept only if nothing else is perfect
    assert is_inlier(np.array([[0.0, 10.0], [0.0, 0.0]])).tolist() == [True, False]


def test_sizes_and_searched_disparities_scale_with_the_width_from_the_papers_own():
    assert [scaled_px(2, w) for w in (640, 960, 1280, 1920, 100)] == [2, 3, 4, 6, 1]
    assert [searched_disparities(w).stop - 1 for w in (640, 960)] == [80, 120]
