"""The course of a thread through pieces in any order and direction, how sure it is, and what both images show of it."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from agents.reconstruction.refined.alignment import align
from agents.reconstruction.refined.course import BothImages, likeliest_course
from agents.reconstruction.refined.method import course_of
from agents.reconstruction.refined.paths import Scores, chain_of, ends_of, likeliest_path, log_total, pieces_of, score
from agents.reconstruction.refined.sightings import LEVEL_PX
from schemas.messages import SURE, ImageEncoding, Occluder, Occluders
from shared.camera import project
from shared.disparities import disparities
from shared.images import encode_image
from tests.agents.reconstruction.threads import CAMERA, lines_of, observed_lines, see, waving, winding

SIZE, REACH = (960, 540), disparities(960)


def all_paths(count):
    for size in range(1, count + 1):
        for order in itertools.permutations(range(count), size):
            for directions in itertools.product((False, True), repeat=size):
                yield list(zip(order, directions, strict=True))


def drawn_scores(count, seed, missing):
    rng = np.random.default_rng(seed)
    join = rng.normal(0, 2, (2 * count, 2 * count))
    join += join.T
    join[(gone := rng.random(join.shape) < missing) | gone.T] = -np.inf
    return Scores(join, rng.normal(0, 2, count), rng.normal(0, 2, 2 * count))


@given(count=st.integers(1, 4), seed=st.integers(0, 10_000), missing=st.sampled_from((0.0, 0.5, 1.0)))
def test_no_path_is_likelier_and_all_together_are_summed(count, seed, missing):
    scores, through = drawn_scores(count, seed, missing), seed % count
    every = {tuple(path): score(path, scores) for path in all_paths(count)}
    likeliest = likeliest_path(scores)
    assert score(likeliest, scores) == pytest.approx(max(every.values()))
    of_piece = [value for path, value in every.items() if through in [p for p, _ in path]]
    assert score(likeliest_path(scores, through), scores) == pytest.approx(max(of_piece))
    assert log_total(scores, through) == pytest.approx(np.logaddexp.reduce(of_piece))
    for join in ends_of(likeliest):
        others = ends_of(path) if (path := likeliest_path(scores.without_join(*join))) else []
        assert not {join, join[::-1]} & set(others)


def aligned(left, right):
    chain = chain_of(left, pieces_of(left))
    found = align(chain, right, REACH)
    assert found is not None
    return chain, found


def largest_error(curve, chain, found, which=slice(None)):
    """Of the disparities, in their own deviations, against those of the nearest places of the thread."""
    px = np.column_stack([np.interp(found.along_px, chain.along_px, chain.point_px[:, k]) for k in (0, 1)])
    left, right = project(CAMERA, curve(np.linspace(0, 1, 10001)))
    off_px = found.disparity_px - (left - right)[cKDTree(left).query(px)[1], 0]
    return np.abs(off_px / np.sqrt(found.variance_px2))[which].max()


@pytest.mark.parametrize("curve", [winding, waving])
def test_matches_have_the_disparity_of_the_thread_whatever_the_right_pieces_and_what_lies_beside_them(curve):
    left, right = see(curve, 0), see(curve, 1)
    chain, found = aligned(left, right)
    assert found.share > 0.95
    assert (np.diff(found.along_px) > 0).all()
    assert largest_error(curve, chain, found) < 1.0
    cuts = [piece[3:-3][:: 1 - 2 * (k % 2)] for k, piece in enumerate(np.array_split(right.point_px, 5))]
    chain, found = aligned(left, lines_of(*(cuts[k] for k in (3, 0, 4, 2, 1))))
    assert found.share > 0.9
    assert largest_error(curve, chain, found) < 1.0
    both = lines_of(right.point_px + np.array([14.0, 40.0]), right.point_px)
    chain, found = aligned(left, both)
    taken = both.piece[found.right_index.astype(int)] == 1
    assert taken.mean() > 0.95
    assert largest_error(curve, chain, found, taken) < 1.0


@pytest.mark.slow
def test_a_thread_that_winds_over_the_whole_image_is_aligned_in_bounded_memory():
    legs = [[(u, 20), (u, 520)][:: 1 - 2 * (k % 2)] for k, u in enumerate(range(60, 940, 24))]
    left = lines_of(np.array(legs, np.float64).reshape(-1, 2))
    chain, found = aligned(left, lines_of(left.point_px - [40.0, 0.0]))
    # every leg looks like the next one, so disparities may be off by whole legs
    assert len(found.along_px) <= 1000
    assert found.share > 0.5
    assert chain.along_px[-1] > 15_000


def found_in(*pieces, right=None, occluders=None):
    """The course through pieces at one depth."""
    right = lines_of(*(piece - np.array([55.0, 0.0]) for piece in pieces)) if right is None else right
    found = likeliest_course(BothImages(lines_of(*pieces), right, REACH, SIZE, occluders))
    assert found is not None
    return found


def visited(chain):
    """The pieces in the order of the chain, from that end at which the smaller number stands."""
    order = chain.piece[np.flatnonzero(np.diff(chain.piece, prepend=-1))].tolist()
    return min(order, order[::-1])


def loop(t):
    """A strand that crosses itself at t = -1 and t = 1, straight on both times."""
    return np.column_stack((480 + 130 * (t**2 - 1), 270 + 130 * t * (t**2 - 1)))


@given(order=st.permutations([0, 1, 2]), turned=st.tuples(*[st.booleans()] * 3))
def test_a_crossing_is_passed_straight_on_and_for_certain(order, turned):
    stretches = [loop(np.linspace(*ends, 400)) for ends in ((-1.5, -1.02), (-0.98, 0.98), (1.02, 1.5))]
    found = found_in(*(stretches[k][:: -1 if back else 1] for k, back in zip(order, turned, strict=True)))
    t = np.linspace(-1.5, 1.5, 6001)
    apart, nearest = cKDTree(loop(t)).query(found.chain.point_px)
    assert np.max(apart) < 0.2
    assert (np.diff(t[nearest]) > 0).mean() in (0.0, 1.0)
    assert len(set(found.chain.piece.tolist())) == 3
    assert found.probability.min() > SURE


def test_where_two_courses_are_as_likely_none_is_certain_and_both_are_told():
    # two strands go behind a tool, so inclined that parallel and crossed they bend as much; beyond it they are one loop
    gap, apart = np.array([160.0, 0.0]), np.array([0.0, 40.0])
    inclined = np.arctan2(apart[1], gap[0]) * np.sqrt(3) / (1 + np.sqrt(3))
    down, up = (np.array([np.cos(inclined), side * np.sin(inclined)]) for side in (1, -1))
    t, corner = np.linspace(0.0, 1.0, 250)[:, None], np.array([400.0, 250.0])
    above, below = corner - 250 * t * down, corner + apart - 250 * t * up
    far = corner + gap, corner + gap + 180 * up, corner + gap + apart + 180 * down, corner + gap + apart
    bend = sum(k * (1 - t) ** (3 - i) * t**i * far[i] for i, k in enumerate((1, 3, 3, 1)))
    occluders = np.zeros((135, 240), np.uint8)
    occluders[40:95, 100:140] = 1
    found = found_in(above, bend, below, occluders=occluders)
    assert visited(found.chain) == [0, 1, 2]
    assert 0.3 < found.probability.min() < 0.7
    changes = np.flatnonzero(np.diff(found.chain.piece)) + 1
    here = [(int(piece[0]), int(piece[-1])) for piece in np.split(found.chain.index, changes)]
    other = [tuple(piece) for piece in found.other.tolist()]
    # the next likeliest goes round the other way
    assert {tuple(sorted(piece)) for piece in other} == {tuple(sorted(piece)) for piece in here}
    assert other not in (here, [(b, a) for a, b in here[::-1]])


def test_kinks_and_long_gaps_are_followed_and_clutter_is_left_out():
    t, corner = np.linspace(0, 1, 100)[:, None], np.array([400.0, 300.0])
    assert visited(found_in(corner + t * [-200, 30], corner + [1, 1] + t * [40, -120]).chain) == [0, 1]
    first, last = (
        np.column_stack((480 + 200 * np.cos(angle), 270 + 200 * np.sin(angle)))
        for angle in (np.linspace(0.0, 1.2, 300), np.linspace(1.9, 3.0, 300))
    )
    found = found_in(first, np.column_stack((np.full(100, 484.0), np.linspace(430, 480, 100))), last)
    assert visited(found.chain) == [0, 2]
    assert np.diff(found.chain.along_px).max() == pytest.approx(2 * 200 * np.sin(0.35), rel=0.02)
    thread, rng = see(waving, 0).point_px, np.random.default_rng(3)
    clutter = [np.array([place, place + rng.normal(0, 6, 2)]) for place in rng.uniform(40, 500, (12, 2))]
    pieces = [piece for piece in clutter if np.linalg.norm(thread - piece.mean(axis=0), axis=1).min() > 40]
    assert visited(found_in(*pieces, thread, right=see(waving, 1)).chain) == [len(pieces)]
    specks = lines_of(*(np.array([[k, 100.0], [k + 1.0, 100.0]]) for k in range(100, 400, 30)))
    assert likeliest_course(BothImages(specks, specks, REACH, SIZE)) is None


def hoop(t):
    """Most of a circle, a little askew, in millimetres."""
    angle = np.radians(20.0 + 292.0 * t)
    return np.column_stack((10 * np.cos(angle), 10 * np.sin(angle), 95 + 1.5 * np.cos(angle)))


def hoop_seen(eye, *degrees):
    """Stretches of the hoop, from and to angles."""
    return see(hoop, eye, [((low - 20.0) / 292.0, (high - 20.0) / 292.0) for low, high in degrees])


@pytest.mark.parametrize("gap_ends", [270, 300])
def test_an_end_behind_a_tool_belongs_to_the_thread_or_is_said_to_be_undecided(gap_ends):
    # what both images hide, each at other places of the thread; a speck far behind the tool may be something else
    left = hoop_seen(0, (20, 190), (gap_ends, 312))
    right = hoop_seen(1, (20, 184), (gap_ends - 6, 312))
    hidden_px, _ = project(CAMERA, hoop((np.linspace(192, gap_ends - 2, 200) - 20) / 292.0))
    tool = np.zeros((135, 240), np.uint8)
    u, v = np.rint(hidden_px.T / 4).astype(int)
    tool[v.min() : v.max() + 1, u.min() : u.max() + 1] = Occluder.TOOL.value
    image = encode_image(tool, ImageEncoding.PNG)
    course = course_of(observed_lines(left, right, occluders=Occluders(image, image, 7)))
    whole, sure = set(course.left.piece.tolist()) == {0, 1}, course.likeliest.probability.min() > SURE
    assert (whole and sure) if gap_ends == 270 else (whole or not sure)


def hook(t):
    """Across the rows, then round a bend along them to the end, where depth still changes; in millimetres."""
    down, along = np.minimum(t / 0.5, 1.0), np.maximum(t - 0.5, 0.0) / 0.5
    return np.column_stack((-15 + 3 * down + 26 * along, -14 + 24 * down + 0.5 * along**2, 95 - 3 * along))


@pytest.mark.parametrize(("lower_px", "shown"), [(0.0, (0.97, 1.03)), (3 * LEVEL_PX, (0.2, 0.5))])
def test_past_a_gap_both_eyes_show_thread_along_the_rows_from_its_end_on_as_far_as_the_rows_agree(lower_px, shown):
    """A stretch about the bend is hidden, and the flat piece of the right image lies so much lower at the gap."""
    left, right = (see(hook, eye, ((0.0, 0.42), (0.56, 1.0))) for eye in (0, 1))
    flat = right.piece == 1
    right.point_px.flags.writeable = True
    right.point_px[flat, 1] += np.linspace(lower_px, 0.0, int(flat.sum()))
    course = course_of(observed_lines(left, right))
    ends = course.left.along_px[course.left.piece == 1][[0, -1]] / course.left.along_px[-1]
    own, cut = sorted(ends, key=lambda s: min(s, 1.0 - s))
    matched = dict(zip(course.aligned.along_px, course.aligned.right_index, strict=True))
    assert matched[own * course.left.along_px[-1]] == len(right.piece) - 1
    s = np.sort(course.sight.s[course.sight.eye == 1])
    s = s[(s >= min(ends) - 0.02) & (s <= max(ends) + 0.02)]
    assert shown[0] < np.abs(s - own).max() / abs(cut - own) < shown[1]
    assert np.diff(s).max() < 0.02
