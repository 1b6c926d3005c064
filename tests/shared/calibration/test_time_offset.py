"""How late a camera is, of drawn videos in which something textured moves as the tool of an arm does."""

import cv2
import numpy as np
import pytest

from shared.calibration.time_offset import ToolMotion, _evenly, time_offset, windows_of

SECONDS, HZ, MARGIN_S = 15.0, 30.0, 5.0
FOCAL_PX, DEPTH_M = 500.0, 0.1


class Moves:
    """A tool that goes from place to place, rests now and then, and turns a little."""

    def __init__(self, seed):
        rng, count = np.random.default_rng(seed), 40
        self._at_s = np.cumsum(rng.uniform(0.6, 1.8, count)) - 3 * MARGIN_S / 2
        self._places = np.column_stack((*rng.uniform(-0.02, 0.02, (2, count)), rng.uniform(-0.4, 0.4, count)))
        for i in np.flatnonzero(rng.random(count - 1) < 0.25):
            self._places[i + 1] = self._places[i]

    def at(self, time_s):
        """x, y and the angle, with a smooth beginning and end of each way."""
        i = np.clip(np.searchsorted(self._at_s, time_s) - 1, 0, len(self._at_s) - 2)
        share = np.clip((time_s - self._at_s[i]) / (self._at_s[i + 1] - self._at_s[i]), 0, 1)
        return self._places[i] + (10 * share**3 - 15 * share**4 + 6 * share**5)[..., None] * (
            self._places[i + 1] - self._places[i]
        )

    def poses(self, time_s):
        x, y, angle = self.at(time_s).T
        T = np.tile(np.eye(4), (len(x), 1, 1))
        T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
        T[:, 0, 3], T[:, 1, 3] = x, y
        return T


def video(moves, seed):
    """Frames with their times: a textured tool over textured ground, with noise."""
    rng = np.random.default_rng(seed)
    ground = cv2.GaussianBlur(rng.integers(40, 216, (270, 480)).astype(np.uint8), (0, 0), 4)
    tool = cv2.GaussianBlur(rng.integers(0, 255, (140, 50)).astype(np.uint8), (0, 0), 1.5)
    scale = FOCAL_PX / DEPTH_M
    grains = [rng.normal(0, 2, ground.shape) for _ in range(8)]
    for number, at_s in enumerate(np.arange(0, SECONDS, 1 / HZ)):
        x, y, angle = moves.at(np.array([at_s]))[0]
        turn = cv2.getRotationMatrix2D((25, 70), float(np.degrees(angle)), 1.0)
        turn[:, 2] += (240 + scale * x - 25, 135 + scale * y - 70)
        image = cv2.warpAffine(tool, turn, (480, 270), ground.copy(), borderMode=cv2.BORDER_TRANSPARENT)
        yield at_s, np.clip(image + grains[number % 8], 0, 255).astype(np.uint8)


def measured(moves, delay_s, jitter_s=0.0, seed=0):
    """The arm's states, whose clock is early by the delay."""
    true_s = np.arange(-MARGIN_S, SECONDS + MARGIN_S, 0.01)
    stamps = np.sort(true_s - delay_s + np.random.default_rng(seed).normal(0, jitter_s, len(true_s)))
    return ToolMotion(stamps, moves.poses(true_s), np.zeros(len(true_s)))


@pytest.mark.parametrize(("seed", "delay_s"), [(1, 0.0), (2, 2.4), (3, -1.7)])
def test_where_the_tool_moves_the_offset_is_found_within_ten_milliseconds_and_its_interval_holds_it(seed, delay_s):
    moves = Moves(seed)
    found = time_offset(list(windows_of(video(moves, seed))), measured(moves, delay_s, 0.002))
    assert found is not None
    assert found.delay_s == pytest.approx(delay_s, abs=0.01)
    low_s, high_s = found.interval_s
    assert low_s <= delay_s <= high_s
    assert high_s - low_s < 0.1


@pytest.mark.slow
def test_a_tool_that_stands_or_moves_otherwise_than_what_is_seen_tells_nothing():
    moves = Moves(1)
    windows = list(windows_of(video(moves, 1)))
    stands = measured(moves, 0.0)
    stands.T_base_tool[:] = stands.T_base_tool[0]
    assert time_offset(windows, stands) is None
    assert time_offset(windows, measured(Moves(9), 0.0)) is None
    assert time_offset([], measured(moves, 0.0)) is None


def test_a_video_that_changes_its_size_or_whose_clock_is_set_begins_anew():
    frames = [(at_s, image) for at_s, image in video(Moves(1), 1)][:120]
    half = [(at_s, image[:, :, None].repeat(3, axis=2) if at_s < 2 else image[:200]) for at_s, image in frames]
    for odd in (half, [*frames[:60], *((at_s - 100, image) for at_s, image in frames[60:])]):
        assert all((np.diff(one.time_s) > 0).all() for one in windows_of(odd))


def test_stamps_that_jitter_are_taken_to_be_even_and_a_pause_stays_a_pause():
    even_s = np.concatenate((np.arange(0, 3, 0.1), np.arange(3, 6, 0.01)))
    stamps = np.sort(even_s + np.random.default_rng(1).normal(0, 0.002, len(even_s)))
    off_s = np.abs(_evenly(stamps) - even_s)
    assert off_s[60:].max() < 0.0015
    assert off_s.max() < 0.01
