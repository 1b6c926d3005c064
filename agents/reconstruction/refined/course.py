"""The thread's course: which pieces of the left centreline it passes, in which order, by what both images show.

A piece ends where the thread crosses itself, where something hides it, and where the thread itself ends. A course is a
path through pieces (`paths`); what is not on it is clutter or another thread. Its probability goes as exp of

    Σ pieces  w_l l  −  Σ joins  E(i, j)  +  Σ both ends  S(i).

For a join over a gap g, let a and b be the angles, in one sense of rotation, from the direction of the first end to the
way across, and from there to that of the second. The least bent curve between them (Hermite's cubic) has
∫κ² = 4 (a² − a b + b²) / g; an arc has a = b. With ρ(x; k) = −log(e⁻ˣ + e⁻ᵏ), which is x, and at most k,

    E = E₀ + ρ(B; k) + w_r ρ(B_right; k) + w_g g + ρ(D; k_d),        B = (a² − a b + b²) / (σ² + (κ₀ g)²),
    D = (δ_j − δ_i − g (m_i − m_j) / 2)² / (σ_d² + var_i + var_j + (c g)²),

δ and m being the disparity at an end and its slope outward, from the matches of that piece alone. k and w_g differ with
what is known to lie before the gap: hidden thread may bend and go far. Ends that touch have a k of their own. Where the
right image shows the thread going on, its bend does not count, and w_c is gained instead. An end scores less where
something may hide what follows (`hidden_ends`), and more where both images end in one place, by T: a cover at another
depth than the thread hides other places of it in the one image than in the other. With e = left − right end − (δ, 0),
t the direction outward, S the covariance of e for one place, and R for how far covered ends lie apart,

    T = log p(e | tip) / p(e | covered) = ½ log(1 + h) − ½ R² (tᵀS⁻¹e)² / (1 + h),   h = R² tᵀS⁻¹t.

The weights are the likeliest ones on drawn scenes whose course is known (`benchmarks/courses.py`), so that what is told
of a course, and of each of its joins, is a probability.
"""

import json
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from agents.reconstruction.refined.alignment import Alignment, align, reversed_along
from agents.reconstruction.refined.paths import (
    Chain,
    Scores,
    chain_of,
    direction_outward,
    ends_of,
    length_px,
    likeliest_path,
    log_total,
    pieces_of,
    score,
)
from schemas.messages import Centrelines
from shared.disparities import Disparities
from shared.occluded import hidden_ends, is_occluded

WEIGHTS = Path(__file__).with_name("course.json")
TANGENT_WIDTHS = 3.0
"""Widths of thread over which the direction of an end is measured: crossings bend the last pixels."""
SLOPE_WIDTHS, LEAST_SLOPE_PX = 6.0, 40.0
"""Over so much of a piece the disparity at its end and its slope are told."""
SLOPE_DEVIATION, LEAST_VARIANCE_PX2 = 0.25, 0.1
"""Of a disparity's slope before anything is seen, and of a matched disparity."""
TIP_DEVIATION_PX, APART_SHARE, MOST_EVIDENCE = 0.5, 0.01, 4.0
"""Of one place in both images; R, of the image's width; and what a ragged mask lets T say at most."""
BORDER_PX = 4.0
GAP_SHARES = np.linspace(0.05, 0.95, 19)
CERTAIN = 0.999
"""A course that is likelier needs no look at each of its joins, which takes as long as the course itself."""
MOST_PIECES = 11
"""The longest ones; time and memory grow as 2 to the power of their number."""


@dataclass(frozen=True)
class BothImages:
    """What is known before a course is sought.

    Fields:
        right: in the left image's rows.
        size_px: width and height of the images.
        occluders: what may hide thread in a copy of the left image; None where nobody knows.
    """

    left: Centrelines
    right: Centrelines
    reach: Disparities
    size_px: tuple[int, int]
    occluders: UInt8[np.ndarray, "r c"] | None = None

    @property
    def width_px(self) -> float:
        """Of the thread."""
        return float(np.median(self.left.width_px))


@dataclass(frozen=True)
class LikeliestCourse:
    """The likeliest course of the thread, and how likely it is.

    Fields:
        joins: indices of the left points that it joins, pair by pair; its own first and last end with themselves.
        probability: of each join, given that the longest piece of the course is on the thread.
        other: the first and last point of each of its pieces, in the order and direction in which the next likeliest
            course passes them: the likeliest one without the least likely join; none where this one is certain.
    """

    chain: Chain
    joins: Int64[np.ndarray, "k 2"]
    probability: Float64[np.ndarray, "k"]
    other: Int64[np.ndarray, "m 2"]


@dataclass(frozen=True)
class End:
    """What both images say of one end of a piece.

    Fields:
        outward: unit vector.
        disparity_px, slope, variance_px2: at the end, from the piece's own matches; not a number without any.
        right_px, right_outward: of the right piece that shows the same, where that one ends; not a number likewise.
        right_piece, right_index: number of that piece, and the last match on it.
        right_way: 1 where indices rise outward there, -1 where they fall, 0 where that is unknown.
        tip: T; 0 where the images do not tell.
    """

    point_px: Float64[np.ndarray, "2"]
    outward: Float64[np.ndarray, "2"]
    disparity_px: float = np.nan
    slope: float = 0.0
    variance_px2: float = np.nan
    right_px: Float64[np.ndarray, "2"] = field(default_factory=lambda: np.full(2, np.nan))
    right_outward: Float64[np.ndarray, "2"] = field(default_factory=lambda: np.full(2, np.nan))
    right_piece: int = -1
    right_index: float = np.nan
    right_way: float = 0.0
    tip: float = 0.0


@dataclass(frozen=True)
class Evidence:
    """What both images say of pieces and of all pairs of their ends; the weights make scores of it.

    Of several sets of pieces of one size, along further axes before these.

    Fields:
        length: of each piece; gap: between ends; both in hundredths of the image's width.
        touching: from 1 for ends in one place to 0 for those some widths apart.
        bend, right_bend: a² − a b + b²; right_gap as gap.
        apart_px, variance_px2: of disparities, against what both slopes tell.
        both_right: whether the right image shows both ends; goes_on: as one piece.
        covered: how much of the gap something hides; not a number where nobody knows.
        tip, hidden: of each end.
    """

    length: Float64[np.ndarray, "*n p"]
    gap: Float64[np.ndarray, "*n e e"]
    touching: Float64[np.ndarray, "*n e e"]
    bend: Float64[np.ndarray, "*n e e"]
    right_gap: Float64[np.ndarray, "*n e e"]
    right_bend: Float64[np.ndarray, "*n e e"]
    apart_px: Float64[np.ndarray, "*n e e"]
    variance_px2: Float64[np.ndarray, "*n e e"]
    both_right: Bool[np.ndarray, "*n e e"]
    goes_on: Bool[np.ndarray, "*n e e"]
    covered: Float64[np.ndarray, "*n e e"]
    tip: Float64[np.ndarray, "*n e"]
    hidden: Bool[np.ndarray, "*n e"]


def likeliest_course(shown: BothImages) -> LikeliestCourse | None:
    """The likeliest course of the longest thread that both images show; None where the left one shows no piece."""
    pieces = sorted(pieces_of(shown.left), key=lambda piece: -length_px(shown.left.point_px[piece]))[:MOST_PIECES]
    pieces.sort(key=lambda piece: int(piece[0]))
    if not pieces:
        return None
    scores = scores_of(evidence_of(shown, pieces), fitted_weights())
    path = likeliest_path(scores)
    longest = max((piece for piece, _ in path), key=lambda p: len(pieces[p]))
    joins, total = ends_of(path), log_total(scores, longest)
    other: list[tuple[int, bool]] = []
    # each join is at least as likely as all of them together
    probability = np.full(len(joins), min(1.0, float(2.0 * np.exp(score(path, scores) - total))))
    if probability[0] < CERTAIN:
        without = np.array([log_total(scores.without_join(*join), longest) for join in joins])
        probability = np.clip(-np.expm1(without - total), 0.0, 1.0)
        other = likeliest_path(scores.without_join(*joins[int(probability.argmin())]), longest)
    first_last = np.array([(piece[0], piece[-1]) for piece in pieces])
    on_path = {piece for piece, _ in path}
    return LikeliestCourse(
        chain_of(shown.left, [pieces[p][:: 1 if forward else -1] for p, forward in path]),
        first_last.ravel()[np.array(joins)],
        probability,
        np.array([first_last[p][:: 1 if forward else -1] for p, forward in other if p in on_path]).reshape(-1, 2),
    )


def evidence_of(shown: BothImages, pieces: list[Int64[np.ndarray, "k"]]) -> Evidence:
    """What both images say of these pieces of the left one."""
    ends = _ends(shown, pieces)

    def each(name: str) -> np.ndarray:
        return np.array([getattr(end, name) for end in ends])

    def change(name: str) -> Float64[np.ndarray, "e e"]:
        return each(name)[None] - each(name)[:, None]

    point_px, slope, way = each("point_px"), each("slope"), each("right_way")
    gap, bend = _bends(point_px, each("outward"), shown.width_px)
    right_gap, right_bend = _bends(each("right_px"), each("right_outward"), shown.width_px)
    ahead = change("right_index") * way[:, None] > 0
    percent, covered = shown.size_px[0] / 100, np.full(gap.shape, np.nan)
    hidden = np.zeros(len(ends), bool)
    if shown.occluders is not None:
        across = point_px[:, None] + GAP_SHARES[:, None, None, None] * (point_px[None] - point_px[:, None])
        covered = is_occluded(across, shown.occluders, shown.size_px[0]).mean(axis=0)
        lines = [shown.left.point_px[piece] for piece in pieces]
        hidden = np.concatenate([hidden_ends(line, shown.occluders, shown.size_px[0]) for line in lines])
    return Evidence(
        length=np.array([length_px(shown.left.point_px[piece]) for piece in pieces]) / percent,
        gap=gap / percent,
        touching=1.0 - _has_direction(gap, shown.width_px),
        bend=bend,
        right_gap=right_gap / percent,
        right_bend=right_bend,
        apart_px=change("disparity_px") - gap * (slope[:, None] - slope[None]) / 2,
        variance_px2=each("variance_px2")[:, None] + each("variance_px2")[None],
        both_right=np.isfinite(right_gap),
        goes_on=(change("right_piece") == 0) & (way[:, None] * way[None] != 0) & ahead & ahead.T,
        covered=covered,
        tip=each("tip"),
        hidden=hidden,
    )


def scores_of(seen: Evidence, w: dict[str, float]) -> Scores:
    """The scores of all paths."""
    covered = np.nan_to_num(seen.covered)
    most = (1 - covered) * w["most_bend"] + covered * w["most_bend_hidden"]
    most = (1 - seen.touching) * most + seen.touching * w["most_kink"]
    of_gap = np.where(np.isnan(seen.covered), w["gap_unknown"], (1 - covered) * w["gap"] + covered * w["gap_hidden"])

    def cost_of(
        bend: Float64[np.ndarray, "*n e e"], gap: Float64[np.ndarray, "*n e e"]
    ) -> Float64[np.ndarray, "*n e e"]:
        return _at_most(bend / (w["direction_rad"] ** 2 + (w["bend_of_gap"] * gap) ** 2), most)

    right = np.where(seen.both_right, cost_of(np.nan_to_num(seen.right_bend), np.nan_to_num(seen.right_gap)), 0.0)
    known = np.isfinite(seen.apart_px)
    step = np.nan_to_num(seen.apart_px) ** 2 / (
        w["disparity_px"] ** 2 + np.where(known, seen.variance_px2, 0.0) + (w["disparity_of_gap"] * seen.gap) ** 2
    )
    cost = w["join"] + cost_of(seen.bend, seen.gap) + of_gap * seen.gap
    cost += np.where(seen.goes_on, -w["goes_on"], w["right_bend"] * right)
    cost += np.where(known, _at_most(step, w["most_step"]), 0.0)
    piece = np.arange(cost.shape[-1]) // 2
    return Scores(
        np.where(piece[:, None] == piece, -np.inf, -cost),
        w["length"] * seen.length,
        w["tip"] * seen.tip - w["hidden_end"] * seen.hidden,
    )


@cache
def fitted_weights() -> dict[str, float]:
    """The project's own weights."""
    return json.loads(WEIGHTS.read_text())


def _at_most(x: Float64[np.ndarray, "*n"], most: Float64[np.ndarray, "*n"] | float) -> Float64[np.ndarray, "*n"]:
    """ρ: about the less of both."""
    return -np.logaddexp(-x, -most)


def _bends(
    point_px: Float64[np.ndarray, "e 2"], outward: Float64[np.ndarray, "e 2"], width_px: float
) -> tuple[Float64[np.ndarray, "e e"], Float64[np.ndarray, "e e"]]:
    """The gap from end to end, and a² − a b + b² of the way across it."""
    across = point_px[None] - point_px[:, None]
    gap = np.linalg.norm(across, axis=2)
    here, there = np.broadcast_to(outward[:, None], across.shape), np.broadcast_to(-outward[None], across.shape)
    # over less than some widths the way across has no direction of its own, and the ends share the turn
    own = _has_direction(gap, width_px)[..., None]
    middle = here + there
    middle = middle / np.maximum(np.linalg.norm(middle, axis=2, keepdims=True), 1e-9)
    way = own * across / np.maximum(gap, 1e-9)[..., None] + (1 - own) * middle
    a, b = _angle(here, way), _angle(way, there)
    return gap, a * a - a * b + b * b


def _has_direction(gap_px: Float64[np.ndarray, "e e"], width_px: float) -> Float64[np.ndarray, "e e"]:
    """How far the way across has a direction of its own: from 0 for ends in one place to 1."""
    return np.clip(gap_px / (2 * TANGENT_WIDTHS * width_px), 0.0, 1.0)


def _angle(a: Float64[np.ndarray, "*n 2"], b: Float64[np.ndarray, "*n 2"]) -> Float64[np.ndarray, "*n"]:
    return np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], (a * b).sum(axis=-1))


def _ends(shown: BothImages, pieces: list[Int64[np.ndarray, "k"]]) -> list[End]:
    """Both ends of each piece, 2p its first and 2p + 1 its last."""
    matched = [align(chain_of(shown.left, [piece]), shown.right, shown.reach) for piece in pieces]
    found: list[End] = []
    for number, (piece, aligned) in enumerate(zip(pieces, matched, strict=True)):
        others = [other.right_index for other in matched[:number] + matched[number + 1 :] if other is not None]
        taken = np.concatenate([np.empty(0), *others])
        for way in (piece, piece[::-1]):
            points = shown.left.point_px[way]
            end = End(points[0], direction_outward(points, TANGENT_WIDTHS * shown.width_px))
            if aligned is not None:
                turned = aligned if way is piece else reversed_along(aligned, length_px(points))
                end = _seen_by_right(end, shown, turned, taken)
            found.append(end)
    return found


def _seen_by_right(end: End, shown: BothImages, aligned: Alignment, taken: Float64[np.ndarray, "m"]) -> End:
    """The same end with what the right image says of it.

    Args:
        aligned: of the piece, from this end on.
        taken: places of the right image that other pieces are matched with.
    """
    right, width_px, index = shown.right, shown.width_px, aligned.right_index
    disparity, slope, variance = _disparity_at_end(aligned, max(LEAST_SLOPE_PX, SLOPE_WIDTHS * width_px))
    number = int(right.piece[int(index[0])])
    end = replace(end, disparity_px=disparity, slope=slope, variance_px2=variance)
    end = replace(end, right_piece=number, right_index=float(index[0]))
    same = index[right.piece[index.astype(int)] == number]
    if len(same) < 2:
        return end
    way = float(np.sign(same[0] - same[min(3, len(same) - 1)]))
    mine = right.point_px[np.flatnonzero(right.piece == number)[:: -1 if way > 0 else 1]]
    inside = all(min(p.min(), *(np.array(shown.size_px) - 1 - p)) > BORDER_PX for p in (end.point_px, mine[0]))
    beyond = taken[(right.piece[taken.astype(int)] == number) & ((taken - index[0]) * way > 0)]
    off_px = end.point_px - mine[0] - (disparity, 0.0)
    return replace(
        end,
        right_px=mine[0],
        right_outward=direction_outward(mine, TANGENT_WIDTHS * width_px),
        right_way=way,
        tip=_tip(off_px, end.outward, variance, APART_SHARE * shown.size_px[0]) if inside and not len(beyond) else 0.0,
    )


def _disparity_at_end(aligned: Alignment, reach_px: float) -> tuple[float, float, float]:
    """The disparity at the first end, its slope outward and its variance, by the line through the matches near it."""
    near = aligned.along_px <= aligned.along_px[0] + reach_px
    near[:3] = True
    x, weight = -aligned.along_px[near], 1.0 / (aligned.variance_px2[near] + LEAST_VARIANCE_PX2)
    A = np.column_stack((np.ones(len(x)), x))
    covariance = np.linalg.inv(A.T @ (weight[:, None] * A) + np.diag([1e-9, SLOPE_DEVIATION**-2]))
    disparity, slope = covariance @ (A.T @ (weight * aligned.disparity_px[near]))
    return float(disparity), float(slope), float(covariance[0, 0])


def _tip(off_px: Float64[np.ndarray, "2"], outward: Float64[np.ndarray, "2"], variance: float, apart: float) -> float:
    """T."""
    known = TIP_DEVIATION_PX**2
    S = np.array((known + variance, known))
    gain, seen = apart**2 * float((outward**2 / S).sum()), apart * float((outward * off_px / S).sum())
    return float(np.clip(0.5 * np.log1p(gain) - 0.5 * seen**2 / (1.0 + gain), -MOST_EVIDENCE, MOST_EVIDENCE))
