"""Pictures by themselves and frames in turn: softened by a lens or a motion, standing still, late."""

import cv2
import numpy as np
import pytest

from agents.perception.judging.picture import DIRECTIONS_DEG, about_sharpness, softness_px
from agents.perception.judging.sequence import about_sequence
from schemas.messages import FrameStamp, Severity

HEIGHT, WIDTH = 540, 960


def noisy(image, deviation=1.5, seed=0):
    noise = np.random.default_rng(seed).normal(0, deviation, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def discs(px=0.0):
    """A ground of edges in all directions, out of focus by so much."""
    rng = np.random.default_rng(1)
    image = np.full((HEIGHT, WIDTH), 90.0, np.float32)
    for centre in rng.integers(0, (WIDTH, HEIGHT), (70, 2)):
        cv2.circle(image, centre.tolist(), int(rng.integers(20, 40)), float(rng.integers(150, 230)), -1, cv2.LINE_AA)
    return cv2.GaussianBlur(image, (0, 0), px) if px else image


def smeared(image, length_px, degrees):
    kernel = np.zeros((2 * length_px + 1,) * 2, np.float32)
    half = 0.5 * length_px * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    ends = np.rint(length_px + np.stack((-half, half))).astype(int)
    cv2.line(kernel, ends[0].tolist(), ends[1].tolist(), 1.0)
    return cv2.filter2D(image, -1, kernel / kernel.sum())


@pytest.mark.parametrize(
    ("degrees", "length_px", "way"),
    [(0, 13, "left to right"), (45, 17, "down to the right"), (90, 13, "up and down"), (135, 17, "down to the left")],
)
def test_a_smear_is_soft_along_itself_and_sharp_across_and_its_way_is_named(degrees, length_px, way):
    image = smeared(discs(), length_px, degrees)
    soft = np.array(softness_px(noisy(image, 0.5)), np.float64)
    number = DIRECTIONS_DEG.index(degrees)
    assert int(np.argmax(soft)) == number
    assert soft[number] > 2 * soft[(number + 2) % 4]
    answer = about_sharpness(noisy(image), noisy(image, 1.4))
    assert answer.wrong is not None and answer.wrong.code == "smeared"
    assert f"smeared {way}:" in answer.found


def test_one_eye_out_of_focus_is_named_and_one_smeared_alone_is_no_motion():
    sharp, soft = noisy(discs(0.5)), noisy(discs(2.5))
    for pair, eye in (((soft, sharp), "left"), ((sharp, soft), "right")):
        answer = about_sharpness(*pair)
        assert answer.wrong is not None and answer.wrong.code == "blurred"
        assert f"the {eye} image" in answer.found
    answer = about_sharpness(noisy(smeared(discs(), 13, 0)), sharp)
    assert answer.wrong is None and not answer.is_known


MS = 1_000_000


def moving(count, late_right=0):
    """A camera that sways unsteadily over a ground, its right eye some frames late."""
    rng = np.random.default_rng(0)
    ground = cv2.GaussianBlur(rng.integers(0, 255, (240, 420, 3), np.uint8), (0, 0), 3)
    ground = cv2.normalize(ground, np.zeros_like(ground), 0, 255, cv2.NORM_MINMAX)
    step = rng.choice((0, 1, 2, 5, 9, 14), count + 8)
    at = 60 + np.abs(np.cumsum(step * rng.choice((-1, 1), count + 8))) % 100
    noise = [rng.normal(0, 1, (90, 160, 3)) for _ in range(2)]

    def eye(right, k):
        window = ground[60:150, at[k] + right : at[k] + right + 160]
        return np.clip(window + np.roll(noise[right > 0], k, axis=1), 0, 255).astype(np.uint8)

    return [(eye(0, k + 4), eye(20, k + 4 - late_right)) for k in range(count)]


def answers(pairs, apart_ms=0):
    """Whether pictures stand still, and whether the eyes go together."""
    times = [33 * MS * k for k in range(len(pairs))]
    return about_sequence(pairs, [FrameStamp(k, at, at + apart_ms * MS, "") for k, at in enumerate(times)])


def test_eyes_that_move_together_are_well_and_few_frames_tell_nothing():
    assert all(answer.is_known and answer.wrong is None for answer in answers(moving(40)))
    assert not any(answer.is_known for answer in answers(moving(3)))


@pytest.mark.parametrize(("late", "eye"), [(2, "right"), (-1, "left")])
def test_an_eye_that_is_late_is_found_by_what_moves(late, eye):
    _, together = answers(moving(40, late))
    assert together.wrong is not None
    assert (together.wrong.code, together.wrong.severity) == ("unsynchronised", Severity.FAULT)
    assert f"the {eye} eye is {abs(late)} frame" in together.found


def test_nothing_is_said_of_lateness_while_nothing_moves():
    rng = np.random.default_rng(0)
    still = moving(1)[0]
    frozen, together = answers(
        [tuple(cv2.add(i, rng.integers(0, 3, i.shape, np.uint8)) for i in still) for _ in range(20)]
    )
    assert frozen.wrong is None
    assert together.found.startswith("unknown, for hardly anything moved")


def test_stamps_further_apart_than_a_frame_are_a_fault():
    _, together = answers(moving(12), apart_ms=50)
    assert together.wrong is not None and "50 ms apart" in together.found


@pytest.mark.parametrize(("eyes", "severity"), [((1,), Severity.FAULT), ((0, 1), Severity.WARNING)])
def test_an_eye_that_stands_still_is_found(eyes, severity):
    pairs = moving(20)
    frozen, _ = answers([tuple(pairs[min(k, 8) if eye in eyes else k][eye] for eye in (0, 1)) for k in range(20)])
    assert frozen.wrong is not None
    assert (frozen.wrong.code, frozen.wrong.severity) == ("frozen", severity)
    assert "12 frames" in frozen.found
    # pictures that come twice now and then are no standstill
    assert answers([pair for pair in pairs[:12] for _ in range(3)])[0].wrong is None
