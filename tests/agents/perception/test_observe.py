"""Every reason to fail, provoked; masks and images of any kind, which never raise; and faults told by masks alone."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.perception.judging.alignment import judge
from agents.perception.judging.correspondence import Correspondence, correspondence_of_masks, correspondence_of_texture
from agents.perception.observe import LARGEST_SEGMENTED_SHARE, observe
from agents.perception.paper.matched import LEAST_OBSERVATIONS
from schemas.messages import FrameStamp, RectifiedStereo, Severity, Status, ThreadObservations
from shared.camera import project
from shared.images import decode_image
from shared.rendering.render import make_scene
from shared.splines import evaluate
from tests.agents.perception.pictures import rendered

WIDTH, HEIGHT = 160, 90
CAMERA = RectifiedStereo(WIDTH, HEIGHT, 170.0, 170.0, 79.5, 44.5, 5.5, 1e-3)
STAMP = FrameStamp(3, 10, 11, "made up")
GREY = np.full((HEIGHT, WIDTH, 3), 180, np.uint8)
NOTHING = np.zeros((HEIGHT, WIDTH), np.uint8)
UPRIGHT = slice(10, 80), slice(60, 62)
ALL_ROWS = slice(0, HEIGHT), slice(0, round(1.5 * LARGEST_SEGMENTED_SHARE * WIDTH))


def seen(coverage_left, coverage_right, left=GREY, right=GREY, camera=CAMERA) -> ThreadObservations:
    return observe(STAMP, camera, left, right, coverage_left, coverage_right, "by hand")


def box(rows, columns):
    mask = NOTHING.copy()
    mask[rows, columns] = 255
    return mask


@pytest.mark.slow
def test_a_rendered_thread_is_observed_along_its_length_near_its_true_depth():
    camera, pair = rendered("easy", 12)
    result = seen(pair.coverage_left, pair.coverage_right, pair.left_bgr, pair.right_bgr, camera)
    assert (result.status, result.reason, result.judgements) == (Status.OK, "", ())
    thread = make_scene("easy", "tissue", 12).thread
    truth = evaluate(thread.knots, thread.control_points, thread.degree, np.linspace(0, 1, 1000))
    (truth_px, truth_right_px), (found_px, found_right_px) = (
        project(camera, truth),
        project(camera, result.points_camera),
    )
    apart = np.linalg.norm(found_px[:, None] - truth_px, axis=2)
    nearest = apart.argmin(axis=1)
    assert apart.min(axis=1).max() < 3.0
    # disparities are whole pixels, and a cluster is their mean
    of_truth = (truth_px - truth_right_px)[nearest, 0]
    assert np.abs((found_px - found_right_px)[:, 0] - of_truth).mean() < 1.0
    order = nearest if nearest[0] < nearest[-1] else nearest[::-1]
    assert (np.diff(order) > -15).all()
    assert found_px[0, 0] <= found_px[-1, 0]


def test_a_uniform_vertical_thread_is_observed_at_its_disparity_and_its_masks_travel_along():
    mask = box(*UPRIGHT)
    result = seen(mask, np.roll(mask, -6, axis=1))
    assert result.status is Status.OK
    np.testing.assert_allclose(result.points_camera[:, 2], 170.0 * 5.5 / 6)
    assert result.inlier.all()
    assert len(result.gaps) == 0
    np.testing.assert_array_equal(decode_image(result.mask_left), mask)
    assert (result.stamp, result.camera, result.segmenter) == (STAMP, CAMERA, "by hand")


def test_a_piece_apart_is_named_as_a_gap():
    mask = box(slice(5, 40), slice(60, 62)) | box(slice(50, 85), slice(60, 62))
    result = seen(mask, np.roll(mask, -6, axis=1))
    assert len(result.gaps) == 1
    rows = project(CAMERA, result.points_camera)[0][:, 1]
    assert rows[result.gaps[0]] < 40 <= 49 < rows[result.gaps[0] + 1]


@pytest.mark.parametrize(
    ("left", "right", "words"),
    [
        ((0, 0), UPRIGHT, ["no thread was found in the left image", "'by hand'"]),
        (UPRIGHT, (0, 0), ["no thread was found in the right image"]),
        (ALL_ROWS, UPRIGHT, ["of the left image is thread"]),
        (UPRIGHT, ALL_ROWS, ["of the right image is thread"]),
        (UPRIGHT, (slice(10, 80), slice(69, 71)), ["left and right look exchanged", "exchange --left and --right"]),
        (
            (slice(5, 30), slice(60, 62)),
            (slice(60, 85), slice(50, 52)),
            ["1 to 20 px", "check that both show the same"],
        ),
        ((slice(40, 42), 60), (slice(40, 42), 54), ["only 2 observations", f"at least {LEAST_OBSERVATIONS}"]),
        # along the rows
        ((slice(44, 46), slice(40, 130)), (slice(44, 46), slice(34, 124)), ["clearly better than its second best"]),
    ],
)
def test_masks_of_which_nothing_can_be_observed_fail_with_reason_and_remedy(left, right, words):
    mask_left, mask_right = (NOTHING if where == (0, 0) else box(*where) for where in (left, right))
    result = seen(mask_left, mask_right)
    assert result.status is Status.FAILED
    assert len(result.points_camera) == len(result.half_size_px) == len(result.gaps) == 0
    assert all(word in result.reason for word in words), result.reason


def scribble(rng):
    mask = NOTHING.copy()
    points = rng.integers(0, (WIDTH, HEIGHT), (rng.integers(2, 12), 2)).astype(np.int32)
    cv2.polylines(mask, [points], False, 255, int(rng.integers(1, 4)))
    return mask


MASKS = {
    "empty": lambda _: NOTHING,
    "full": lambda _: np.full_like(NOTHING, 255),
    "pixel": lambda rng: box(int(rng.integers(HEIGHT)), int(rng.integers(WIDTH))),
    "scatter": lambda rng: ((rng.random(NOTHING.shape) < rng.uniform(0.0005, 0.05)) * 255).astype(np.uint8),
    "noise": lambda rng: rng.integers(0, 256, NOTHING.shape, dtype=np.uint8),
    "scribble": scribble,
}
IMAGES = {
    "noise": lambda rng: rng.integers(0, 256, GREY.shape, dtype=np.uint8),
    "white": lambda _: np.full_like(GREY, 255),
    "gradient": lambda _: np.broadcast_to(np.arange(WIDTH, dtype=np.uint8)[None, :, None], GREY.shape).copy(),
}
kinds_of_mask, kinds_of_image = st.sampled_from(sorted(MASKS)), st.sampled_from(sorted(IMAGES))


@settings(max_examples=40)
@given(
    masks=st.tuples(kinds_of_mask, kinds_of_mask),
    images=st.tuples(kinds_of_image, kinds_of_image),
    shift=st.integers(-3, 25),
    alike=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_anything_ends_as_a_status(masks, images, shift, alike, seed):
    rng = np.random.default_rng(seed)
    left, right = (IMAGES[kind](rng) for kind in images)
    mask_left = MASKS[masks[0]](rng)
    mask_right = np.roll(mask_left, -shift, axis=1) if alike else MASKS[masks[1]](rng)
    result = seen(mask_left, mask_right, left, np.roll(left, -shift, axis=1) if alike else right)
    # that arrays are finite, points in front of the camera and gaps within is checked by the message itself
    assert (result.status is Status.OK) == (result.reason == "") == (len(result.points_camera) >= LEAST_OBSERVATIONS)
    assert (result.points_camera[:, 2] <= 170.0 * 5.5 / 1.0 + 1e-6).all()
    assert (result.points_camera[:, 2] >= 170.0 * 5.5 / 20.0 - 1e-6).all()


def wavy_mask(right_px=0, down_px=0):
    mask = np.zeros((270, 480), np.uint8)
    u = np.linspace(150, 400, 100)
    points = np.column_stack((u + right_px, 140 + 80 * np.sin(u / 60) + down_px))
    cv2.polylines(mask, [np.round(points).astype(np.int32)], False, 255, 4)
    return mask > 0


@pytest.mark.parametrize(
    ("disparity", "rows", "found"),
    [
        (20, 0, {}),
        (35, 2, {"row_residual": Severity.WARNING}),
        (20, -2, {"row_residual": Severity.WARNING}),
        (12, -7, {"row_residual": Severity.FAULT}),
        (-18, 0, {"left_right_swapped": Severity.FAULT}),
    ],
)
def test_shifts_of_masks_are_measured_and_judged_by_their_size(disparity, rows, found):
    correspondence = correspondence_of_masks(wavy_mask(), wavy_mask(-disparity, -rows))
    assert correspondence.disparity_px == pytest.approx(disparity, abs=4.0)
    assert correspondence.row_residual_px == pytest.approx(rows, abs=0.5)
    findings = judge(correspondence, (270, 480))
    assert {finding.code: finding.severity for finding in findings} == found
    said = "exchange --left and --right" if disparity < 0 else f"{abs(rows)}.0 px apart in rows"
    assert all(said in f"{finding.finding}; {finding.remedy}" for finding in findings)


def test_what_is_empty_plain_covered_by_thread_or_of_other_things_does_not_correspond():
    empty, other = np.zeros((270, 480), bool), np.zeros((270, 480), bool)
    other[250:254, 60:300] = True
    for pair in ((empty, wavy_mask()), (wavy_mask(), empty), (empty, empty), (wavy_mask(), other)):
        assert correspondence_of_masks(*pair) == Correspondence(None, None)
    one, another = (
        cv2.GaussianBlur(np.random.default_rng(seed).integers(0, 255, (270, 480, 3), np.uint8), (0, 0), 1.0)
        for seed in (1, 2)
    )
    assert correspondence_of_texture(one, another, empty, empty) is None
    assert correspondence_of_texture(one, np.roll(one, -20, axis=1), ~empty, ~empty) is None
    for shape in ((270, 480), (1, 1), (1, 300), (63, 200)):
        plain, nothing = np.full((*shape, 3), 200, np.uint8), np.zeros(shape, bool)
        assert correspondence_of_texture(plain, plain, nothing, nothing) is None
