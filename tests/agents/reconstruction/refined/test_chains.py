"""The thread's course through one image, from pieces that are given in any order and direction."""

import numpy as np
import pytest

from agents.reconstruction.refined.chains import chains

WIDTH = 960


def loop(t):
    """A strand that crosses itself at t = -1 and t = 1, straight on both times."""
    return np.column_stack((480 + 130 * (t**2 - 1), 270 + 130 * t * (t**2 - 1)))


def visited(chain):
    """The pieces in the order of the chain, from that end at which the smaller number stands."""
    changes = np.flatnonzero(np.diff(chain.piece, prepend=-1))
    order = chain.piece[changes].tolist()
    return min(order, order[::-1])


@pytest.mark.parametrize("seed", range(2))
def test_a_straight_crossing_is_passed_straight_on(make_lines, seed):
    rng = np.random.default_rng(seed)
    stretches = [(-1.5, -1.02), (-0.98, 0.98), (1.02, 1.5)]
    pieces = [
        loop(np.linspace(stretches[k][0], stretches[k][1], 400))[:: rng.choice((-1, 1))] for k in rng.permutation(3)
    ]
    (chain, *_) = chains(make_lines(*pieces), WIDTH)
    t = np.linspace(-1.5, 1.5, 6001)
    apart = np.linalg.norm(loop(t)[:, None] - chain.point_px[None], axis=2)
    assert apart.min(axis=0).max() < 0.2
    assert (np.diff(t[apart.argmin(axis=0)]) > 0).mean() in (0.0, 1.0)
    assert len(set(chain.piece.tolist())) == 3


def test_a_piece_that_two_strands_share_is_passed_twice(make_lines):
    along = np.linspace(0, 1, 200)[:, None]
    angle = np.linspace(np.arcsin(18 / 120), 2 * np.pi - np.arcsin(18 / 120), 400)
    before = np.column_stack((150 + 147 * along, 230 - 29 * np.sin(along * np.pi / 2)))
    shared = np.array([[300.0, 200.0], [330.0, 200.0]])
    around = np.column_stack((315 + 120 * np.sin(angle), 120 + 80 * np.cos(angle)))
    after = before[::-1] * [-1, 1] + [630, 0]
    (chain, *_) = chains(make_lines(before, shared, around, after), WIDTH)
    assert visited(chain) == [0, 1, 2, 1, 3]


def test_a_kink_where_ends_touch_is_followed(make_lines):
    t = np.linspace(0, 1, 100)[:, None]
    corner = np.array([400.0, 300.0])
    thread, needle = corner + t * [-200, 30], corner + [1, 1] + t * [40, -120]
    (chain, *rest) = chains(make_lines(thread, needle), WIDTH)
    assert visited(chain) == [0, 1]
    assert not rest


def test_a_long_gap_is_bridged_to_what_continues_the_bend(make_lines):
    def arc(low, high):
        angle = np.linspace(low, high, 300)
        return np.column_stack((480 + 200 * np.cos(angle), 270 + 200 * np.sin(angle)))

    stray = np.column_stack((np.full(100, 484.0), np.linspace(430, 480, 100)))
    (chain, *rest) = chains(make_lines(arc(0.0, 1.2), stray, arc(1.9, 3.0)), WIDTH)
    assert visited(chain) == [0, 2]
    assert [visited(other) for other in rest] == [[1]]
    assert np.diff(chain.along_px).max() == pytest.approx(2 * 200 * np.sin(0.35), rel=0.02)
    assert chain.seen_px == pytest.approx(200 * 2.3, rel=0.01)


def test_clutter_beside_the_thread_and_pieces_without_a_direction_are_left_out(make_lines, threads, see):
    thread = see(threads["waving"], 0).point_px
    rng = np.random.default_rng(3)
    clutter = [np.array([place, place + rng.normal(0, 6, 2)]) for place in rng.uniform(40, 500, (12, 2))]
    pieces = [piece for piece in clutter if np.linalg.norm(thread - piece.mean(axis=0), axis=1).min() > 40]
    assert len(pieces) > 4
    (chain, *_) = chains(make_lines(*pieces, thread), WIDTH)
    assert visited(chain) == [len(pieces)]
    specks = [np.array([[k, 100.0], [k + 1.0, 100.0]]) for k in range(100, 400, 30)]
    assert chains(make_lines(*specks), WIDTH) == []
