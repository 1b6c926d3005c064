"""Frames in turn: pictures that stand still, and eyes that are late."""

import cv2
import numpy as np
import pytest

from agents.perception.judging.sequence import about_sequence
from schemas.messages import FrameStamp, Severity

MS = 1_000_000


def moving(count, late_right=0, seed=0):
    """A camera that sways unsteadily over a ground, its right eye some frames late."""
    rng = np.random.default_rng(seed)
    ground = cv2.GaussianBlur(rng.integers(0, 255, (240, 420, 3), np.uint8), (0, 0), 3)
    ground = cv2.normalize(ground, np.zeros_like(ground), 0, 255, cv2.NORM_MINMAX)
    step = rng.choice((0, 1, 2, 5, 9, 14), count + 8)
    at = 60 + np.abs(np.cumsum(step * rng.choice((-1, 1), count + 8))) % 100
    noise = [rng.normal(0, 1, (90, 160, 3)) for _ in range(2)]

    def eye(right, k):
        window = ground[60:150, at[k] + right : at[k] + right + 160]
        return np.clip(window + np.roll(noise[right > 0], k, axis=1), 0, 255).astype(np.uint8)

    return [(eye(0, k + 4), eye(20, k + 4 - late_right)) for k in range(count)]


def stamps(count, apart_ms=0):
    return [FrameStamp(k, 33 * MS * k, 33 * MS * k + apart_ms * MS, "") for k in range(count)]


def answers(pairs, **how):
    frozen, together = about_sequence(pairs, stamps(len(pairs), **how))
    return frozen, together


def test_eyes_that_move_together_are_well_and_few_frames_tell_nothing():
    for answer in answers(moving(40)):
        assert answer.is_known
        assert answer.wrong is None
    assert not any(answer.is_known for answer in answers(moving(3)))


@pytest.mark.parametrize(("late", "eye"), [(2, "right"), (-1, "left")])
def test_an_eye_that_is_late_is_found_by_what_moves(late, eye):
    _, together = answers(moving(40, late))
    assert together.wrong is not None
    assert (together.wrong.code, together.wrong.severity) == ("unsynchronised", Severity.FAULT)
    assert f"the {eye} eye is {abs(late)} frame" in together.found


def test_nothing_is_said_of_lateness_while_nothing_moves():
    still = moving(1)[0]
    rng = np.random.default_rng(0)
    pairs = [tuple(cv2.add(i, rng.integers(0, 3, i.shape, np.uint8)) for i in still) for _ in range(20)]
    frozen, together = answers(pairs)
    assert frozen.wrong is None
    assert together.found.startswith("unknown, for hardly anything moved")


def test_stamps_further_apart_than_a_frame_are_a_fault():
    _, together = answers(moving(12), apart_ms=50)
    assert together.wrong is not None and "50 ms apart" in together.found


@pytest.mark.parametrize(("eyes", "severity"), [((1,), Severity.FAULT), ((0, 1), Severity.WARNING)])
def test_an_eye_that_stands_still_is_found(eyes, severity):
    pairs = moving(20)
    held = [
        tuple(pairs[8][eye] if eye in eyes and k > 8 else pair[eye] for eye in (0, 1)) for k, pair in enumerate(pairs)
    ]
    frozen, _ = answers(held)
    assert frozen.wrong is not None
    assert (frozen.wrong.code, frozen.wrong.severity) == ("frozen", severity)
    assert "12 frames" in frozen.found
    # pictures that come twice now and then are no standstill
    doubled = [pair for pair in pairs[:12] for _ in range(3)]
    assert answers(doubled)[0].wrong is None
