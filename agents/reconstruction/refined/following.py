"""The curve of a frame from that of the frame before: Gauss-Newton under the prior that `motion` makes of the last one.

    min  ½ Σ ρ(r_i) + ½ λ Σ_k w_k ‖Δ³P_k‖² + ½ (P − P')ᵀ Λ (P − P')

P' being the last curve and Λ the prior's precision. λ and w are the last frame's, and are chosen anew every few frames.
For linear residuals twice the prior's term and the squared residuals together are νᵀS⁻¹ν, the normalised innovation
squared; the prior's term alone has at most three times as many degrees of freedom as there are control points.

What the last frame says of the next: its posterior with process noise, a quadratic function of the control points.

Between frames a thread moves by a displacement u that is common to all of it (camera, hand) and one that changes along
it (bending). Both are taken as normal, so that control point i moves by u_i with

    E u_i u_jᵀ = (c² + d² k(|i − j|) + e² δ_ij) I,      k(r) = (1 + √3 r / l) exp(−√3 r / l)   (Matérn, 3/2),

and the prediction is normal with covariance Σ + Q, Σ being the last posterior's. What depends on one place of a curve
depends on four control points, so of Σ + Q only the blocks within four neighbours are kept, and the prior is the normal
distribution of greatest entropy that has them: with C_k the block of the control points k to k + 3, and S_k that of
k + 1 to k + 3, its precision is Σ_k C_k⁻¹ − Σ_k S_k⁻¹ (Lauritzen 1996, decomposable models; exact for those blocks).
It has the form of all other terms, and costs as little.

Thread does not stretch: at the middle of each span, ‖B'‖ is the known length but for a small share. What is hidden has
its length from this, and an end that is hidden its place.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from agents.reconstruction.refined.association import GATE_SHARE, Associated, associated
from agents.reconstruction.refined.normal_equations import (
    SIDE,
    Blocks,
    damping_blocks,
    data_blocks,
    factored,
    finite,
    gradient,
    linearised,
    roughness_blocks,
    solved,
)
from agents.reconstruction.refined.plausibility import implausible
from agents.reconstruction.refined.points import chosen_points
from agents.reconstruction.refined.projection import (
    DEGREE,
    LEVEL,
    Curve,
    at_constant_speed,
    basis_at,
    chords,
    kept,
    projected,
)
from agents.reconstruction.refined.refinement import FREE, LEAST_SCALE, LOOSER, Refined, weighted, with_row_doubt
from agents.reconstruction.refined.sightings import MOST_POINTS, Sightings, placed
from agents.reconstruction.refined.smoothing import FINE, chosen_smoothing, local_weights
from schemas.messages import Centrelines, RectifiedStereo, ThreadTrack

COMMON_SHARE, BENDING_SHARE, LOCAL_SHARE = 0.012, 0.003, 0.00003
"""Of the image's width, at the thread's depth: c, d and e of one thirtieth of a second."""
BENDING_REACH = 0.25
"""Of the thread: l."""
STRETCH = 0.03
"""Standard deviation of the length of one span, as a share of it."""
FRAME_S = 1.0 / 30.0

Band = Float64[np.ndarray, "m 4 3 3"]
Precision = Float64[np.ndarray, "spans 12 12"]


def band_of(covariance: Float64[np.ndarray, "spans 12 12"]) -> Band:
    """The blocks [i, j] of the control points i and i + j, from those of the control points of each span."""
    spans = len(covariance)
    blocks = covariance.reshape(spans, DEGREE + 1, 3, DEGREE + 1, 3)
    band = np.zeros((spans + DEGREE, DEGREE + 1, 3, 3))
    band[:spans] = blocks[:, 0].transpose(0, 2, 1, 3)
    for i in range(1, DEGREE + 1):
        band[spans + i - 1, : DEGREE + 1 - i] = blocks[-1, i, :, i:].transpose(1, 0, 2)
    return band


def process_noise(curve: Curve, camera: RectifiedStereo, elapsed_s: float) -> Float64[np.ndarray, "4"]:
    """Q for control points that lie 0 to 3 apart, the same in each direction."""
    unit = camera.image_width * float(np.median(curve.control_points[:, 2])) / camera.fx_px
    r = np.sqrt(3.0) * np.arange(DEGREE + 1) / (BENDING_REACH * curve.spans)
    one = (COMMON_SHARE * unit) ** 2 + (BENDING_SHARE * unit) ** 2 * (1.0 + r) * np.exp(-r)
    one[0] += (LOCAL_SHARE * unit) ** 2
    return one * max(elapsed_s / FRAME_S, 1.0)


def prior(band: Band, noise: Float64[np.ndarray, "4"]) -> Precision:
    """The precision of the prediction, in blocks of one knot span each.

    Raises:
        numpy.linalg.LinAlgError: where the covariance is none.
    """
    apart = np.abs(np.subtract.outer(np.arange(4), np.arange(4)))
    cliques = _cliques(band) + np.einsum("ij,ab->iajb", noise[apart], np.eye(3)).reshape(SIDE, SIDE)
    # each block but the last is the first control point's conditional on the other three
    first, both, rest = cliques[:-1, :3, :3], cliques[:-1, :3, 3:], cliques[:-1, 3:, 3:]
    follows = np.linalg.solve(rest, both.transpose(0, 2, 1))
    apart_from = np.concatenate((np.tile(np.eye(3), (len(follows), 1, 1)), -follows.transpose(0, 2, 1)), axis=2)
    precision = np.empty_like(cliques)
    precision[:-1] = apart_from.transpose(0, 2, 1) @ np.linalg.inv(first - both @ follows) @ apart_from
    precision[-1] = np.linalg.inv(cliques[-1])
    return 0.5 * (precision + precision.transpose(0, 2, 1))


def away_from(precision: Precision, curve: Curve, predicted: Curve) -> Blocks:
    """The prior as a function of the motion from `curve`."""
    away = curve.near - predicted.near
    return Blocks(precision, (precision @ away.reshape(-1, SIDE, 1))[:, :, 0])


def stretching(curve: Curve, length: float) -> Blocks:
    """½ Σ_k ((‖B'(s_k)‖ − length) / deviation)² about `curve`, s_k the middles of its spans."""
    slope = _middle_slopes(curve.spans)
    velocity = (slope[:, None] @ curve.near)[:, 0]
    speed = np.maximum(np.sqrt(np.einsum("ka,ka->k", velocity, velocity)), 1e-12)
    design = (slope[:, :, None] * (velocity / speed[:, None])[:, None, :]).reshape(curve.spans, SIDE) / (
        STRETCH * length
    )
    residual = (speed / length - 1.0) / STRETCH
    return Blocks(design[:, :, None] * design[:, None, :], design * residual[:, None])


@kept
def _middle_slopes(spans: int) -> Float64[np.ndarray, "spans 4"]:
    """The derivatives of the basis functions in the middle of each span."""
    return basis_at(spans, (np.arange(spans) + 0.5) / spans)[2]


def _cliques(band: Band) -> Float64[np.ndarray, "spans 12 12"]:
    return band.ravel().take(_clique_index(len(band) - DEGREE))


@kept
def _clique_index(spans: int) -> Int64[np.ndarray, "spans 12 12"]:
    """Where each number of each block lies in the band, of which the lower half is left out."""
    number = np.arange((spans + DEGREE) * (DEGREE + 1) * 9).reshape(-1, DEGREE + 1, 3, 3)
    k = np.arange(spans)
    blocks = np.empty((spans, 4, 3, 4, 3), np.int64)
    for a in range(4):
        for b in range(a, 4):
            blocks[:, a, :, b, :] = number[k + a, b - a]
            blocks[:, b, :, a, :] = number[k + a, b - a].transpose(0, 2, 1)
    return blocks.reshape(spans, SIDE, SIDE)


STEPS = 2
HIDDEN = 1e-3
"""Of the usual roughness: what counts of it past the last place that is seen."""
ROUNDS, NEAR_PX_SHARE = 3, 0.004
"""The curve is moved and places are found anew until it moves by less than this share of the width, or so often."""
BESIDE_PX_SHARE, FOUND = 0.0015, 0.9
"""Nor is that needed where so many points have found the curve and none of them lies farther beside it than that, as
where the thread stands still."""
CHOICE_FRAMES = 5
"""Smoothing is chosen anew once in so many frames."""
LEAST_SHARE = 0.5
"""Of the points and of the curve: a track of which both are less is lost."""
LEAST_SHOWN = 0.25
"""Of the curve, in either image: depth comes from both, and with one alone it would only be guessed, frame by frame."""
LEAST_HIDDEN = 0.1
"""Of the curve: less is no tool, but a gap in a centreline."""
BEYOND_SHARE, FARTHEST_BEYOND = 0.02, 0.1
"""Of the image's width: thread that goes on farther past the curve's end is to be part of it."""
LENGTH_TOLERANCE, END_PX_SHARE = 0.015, 0.005
"""Where the length is off by more, an end counts if it lies within this share of the width without it."""
MOST_INNOVATION = 3.0
LARGEST_RESIDUAL_SHARE = 0.0015
"""Of the image's width, in the median."""


class LostError(ValueError):
    """The thread is not where the last frame lets expect it, and the text says what speaks against it."""


@dataclass(frozen=True)
class Followed:
    """The fit, and how it stands to what was predicted.

    Fields:
        hidden_alike: whether something hides thread, in both images rather than in one.
    """

    fit: Refined
    innovation: float
    found_share: float
    hidden_alike: bool


def followed(
    last: ThreadTrack,
    lines: tuple[Centrelines, Centrelines],
    camera: RectifiedStereo,
    elapsed_s: float,
    of_calibration: Float64[np.ndarray, "8 8"],
) -> Followed:
    """The curve of this frame.

    Raises:
        LostError: where the innovation test fails.
    """
    curve = Curve(last.knots, last.control_points_camera)
    try:
        noise = process_noise(curve, camera, elapsed_s)
        prediction = _Prediction(last, curve, prior(last.covariance, noise), camera)
        near, seen = _brought_near(prediction, lines)
        _require_seen(seen, camera)
        fit = _fit(prediction, near, seen.sight)
        if _is_of_another_length(fit, prediction.length):
            fit = _without_false_ends(prediction, near, seen.sight)
    except np.linalg.LinAlgError as error:
        raise LostError(f"the curve could not be followed ({error})") from error
    innovation = _innovation(fit.curve, prediction)
    _require_fit(fit, innovation, camera)
    hidden_alike = seen.hidden_share > max(LEAST_HIDDEN, seen.alone_share)
    # the rows are as uncertain in each frame, so that no number of them makes depth certain
    return Followed(with_row_doubt(fit, camera, of_calibration), innovation, seen.found_share, hidden_alike)


@dataclass(frozen=True)
class _Prediction:
    """The last curve, with the precision to which it is known where this one is."""

    last: ThreadTrack
    curve: Curve
    precision: Precision
    camera: RectifiedStereo

    @property
    def length(self) -> float:
        """Of the thread between the curve's ends."""
        return self.last.length * float(np.diff(self.last.material_s)[0])

    def about(self, curve: Curve) -> Blocks:
        """What is known before the images are looked at, as a function of the motion from `curve`."""
        return self.remembered(curve) + stretching(curve, self.length)

    def remembered(self, curve: Curve) -> Blocks:
        """What the frames before have shown, without the length of each span."""
        return away_from(self.precision, curve, self.curve)


def _brought_near(prediction: _Prediction, lines: tuple[Centrelines, Centrelines]) -> tuple[Curve, Associated]:
    """A curve so near to the points that they have their places on it: the last one, where the thread hardly moves."""
    camera, row_offset = prediction.camera, row_offset_of(prediction.last)
    points = chosen_points(lines, camera, MOST_POINTS)
    near, seen = prediction.curve, associated(prediction.curve, points, camera, row_offset, votes=True)
    for _ in range(ROUNDS):
        if seen.found_share >= FOUND and seen.farthest_px < BESIDE_PX_SHARE * camera.image_width:
            break
        _require_seen(seen, camera, FARTHEST_BEYOND)
        then, near = near, _moved(prediction, near, seen.sight)
        if not (np.isfinite(near.control_points).all() and (near.control_points[:, 2] > 0).all()):
            raise LostError("the curve that was followed leaves the space before the cameras")
        seen = associated(near, points, camera, row_offset, votes=False)
        if _steps_px(near, then, camera) < NEAR_PX_SHARE * camera.image_width:
            break
    return near, seen


def _moved(prediction: _Prediction, curve: Curve, sight: Sightings) -> Curve:
    """The curve after the first step, which leads over the motion of a frame: beside it, every deviation is small."""
    last = prediction.last
    rows = linearised(curve, sight, prediction.camera, row_offset_of(last))
    scale = max(1.4826 * float(np.median(np.abs(rows.residual[: rows.sightings]))), LEAST_SCALE)
    data = data_blocks(rows, np.full(len(rows.residual), scale**-2), curve.spans) + damping_blocks(curve)
    total = data + prediction.about(curve)
    total += roughness_blocks(curve, last.smoothing * last.span_weight * _shown(sight, curve))
    motion = -solved(factored(total), gradient(total.g))
    return at_constant_speed(curve.moved(motion.reshape(-1, 3)), sight.s)[0]


def _fit(prediction: _Prediction, curve: Curve, sight: Sightings) -> Refined:
    last, camera = prediction.last, prediction.camera
    smoothing, weight, row_offset = last.smoothing, last.span_weight, row_offset_of(last)
    choose = last.frames % CHOICE_FRAMES == CHOICE_FRAMES - 1
    sight, damping, shown = (
        placed(sight, curve, camera, row_offset, rounds=2),
        damping_blocks(curve),
        _shown(sight, curve),
    )
    for step in range(STEPS):
        rows, robust, scale = weighted(curve, sight, camera, row_offset)
        data = data_blocks(rows, robust / scale**2, curve.spans) + damping
        data += prediction.about(curve)
        if choose and step == 1:
            smoothing = chosen_smoothing(curve, data, weight, smoothing * FINE)
            weight = local_weights(curve, data + roughness_blocks(curve, smoothing * weight), smoothing, weight)
        total = data + roughness_blocks(curve, smoothing * weight * shown)
        motion = finite(-solved(factored(total), gradient(total.g)))
        curve, s = at_constant_speed(curve.moved(motion.reshape(-1, 3)), sight.s)
        sight = placed(replace(sight, s=s), curve, camera, row_offset)
    rows, robust, scale = weighted(curve, sight, camera, row_offset)
    data = data_blocks(rows, robust / scale**2, curve.spans) + damping
    # lengths and smoothness help to find the curve, but where an eye is blind they tell nothing new in each frame: they
    # would soon make a guessed depth certain
    both = np.minimum(*(_shown_by(sight, curve, eye) for eye in (0, 1)))
    smooth, known = roughness_blocks(curve, smoothing * weight * both), data + prediction.remembered(curve)
    total, loose = known + smooth, known + smooth * (1.0 / LOOSER)
    alone, free = (data + roughness_blocks(curve, smoothing * weight / looser) for looser in (LOOSER, FREE))
    return Refined(
        curve, sight, rows, robust, scale, smoothing, weight, row_offset, total, loose, alone, free, follows=True
    )


def _shown(sight: Sightings, curve: Curve) -> Float64[np.ndarray, "spans"]:
    """1 for spans between those of which this frame shows something.

    Past the last of them roughness would straighten the thread a little more in every frame; there, the prior says
    already how smooth it is.
    """
    k = np.arange(curve.spans)
    first, last = np.clip(np.array((sight.s.min(), sight.s.max())) * curve.spans, 0, curve.spans - 1).astype(int)
    return np.where((k >= first) & (k <= last), 1.0, HIDDEN)


def _shown_by(sight: Sightings, curve: Curve, eye: int) -> Float64[np.ndarray, "spans"]:
    """1 for spans of which this eye shows something."""
    here = (sight.s[sight.eye == eye] * curve.spans).astype(int).clip(0, curve.spans - 1)
    return np.where(np.bincount(here, minlength=curve.spans) > 0, 1.0, HIDDEN)


def _steps_px(now: Curve, then: Curve, camera: RectifiedStereo) -> float:
    """How far control points have moved at most, in the left image's scale."""
    step = np.linalg.norm(now.control_points - then.control_points, axis=1)
    return float((step * camera.fx_px / np.maximum(now.control_points[:, 2], 1e-9)).max())


def _require_seen(seen: Associated, camera: RectifiedStereo, most_beyond: float = BEYOND_SHARE) -> None:
    within = f"within {GATE_SHARE * camera.image_width:.0f} px of where it was expected"
    left, right = seen.shown_shares
    if max(seen.found_share, 1.0 - seen.hidden_share) < LEAST_SHARE or min(left, right) < LEAST_SHOWN:
        raise LostError(
            f"only {seen.found_share:.0%} of the thread in both images lies {within}, and only {left:.0%} of the last "
            f"curve is seen there in the left image, {right:.0%} in the right one"
        )
    if seen.beyond_px > most_beyond * camera.image_width:
        raise LostError(f"both images show {seen.beyond_px:.0f} px of thread past the end of the last curve")


def _require_fit(fit: Refined, innovation: float, camera: RectifiedStereo) -> None:
    if reason := implausible(fit, camera):
        raise LostError(reason)
    if innovation > MOST_INNOVATION:
        raise LostError(f"the thread moved farther than it can: {innovation:.1f} predicted variances")
    off_px = np.median(np.abs(fit.rows.residual[: fit.rows.sightings]) * fit.sight.deviation_px)
    if off_px > LARGEST_RESIDUAL_SHARE * camera.image_width:
        raise LostError(f"the curve that was followed is {off_px:.1f} px from the thread")


def _innovation(curve: Curve, prediction: _Prediction) -> float:
    """The prior's share of the normalised innovation squared, per number of a control point."""
    moved = (curve.control_points - prediction.curve.control_points).ravel()
    return float(moved @ gradient(away_from(prediction.precision, curve, prediction.curve).g)) / len(moved)


def row_offset_of(track: ThreadTrack) -> Float64[np.ndarray, "4"]:
    """All terms of the rows' offset, see `rows`."""
    return np.append(track.row_offset_px, LEVEL[1:] if track.row_slopes_px is None else track.row_slopes_px)


def curve_length(curve: Curve) -> float:
    """The length of the curve, by chords so short that a thread's bends do not count."""
    return float(chords(curve.evenly(8)).sum())


def _is_of_another_length(fit: Refined, expected: float) -> bool:
    return bool(fit.sight.is_end.any()) and abs(curve_length(fit.curve) / expected - 1.0) > LENGTH_TOLERANCE


def _without_false_ends(prediction: _Prediction, curve: Curve, sight: Sightings) -> Refined:
    """The fit without the ends that the thread's length contradicts: where a tool begins, a piece ends too."""
    camera, row_offset = prediction.camera, row_offset_of(prediction.last)
    fit = _fit(prediction, curve, replace(sight, is_end=np.zeros(len(sight.s), bool)))
    view = projected(fit.curve, sight.s, sight.eye, camera, row_offset)
    off = np.linalg.norm(view.point_px - sight.point_px, axis=1)
    ends = sight.is_end & (off <= END_PX_SHARE * camera.image_width)
    return _fit(prediction, fit.curve, replace(sight, is_end=ends)) if ends.any() else fit
